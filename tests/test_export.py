"""Results for other programs: a table of the time histories, and fields that show the true motion."""

from __future__ import annotations

import csv
import resource
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ufl import Identity, dev, grad, inner, sqrt, sym, tr

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.plot import series_of

E, NU = 5e6, 0.3


def von_mises(u: Any) -> Any:
    """Of the linear stress, Pa."""
    mu, lmbda = fmbd.materials.lame(E, NU)
    eps = sym(grad(u))
    s = dev(2 * mu * eps + lmbda * tr(eps) * Identity(2))
    return sqrt(1.5 * inner(s, s))


@pytest.fixture(scope="module")
def pendulums(rod_mesh: Callable[..., Any]) -> fmbd.Run:
    """A full, a reduced and an absolute rod, each on a pin."""
    mesh = rod_mesh(dim=2, h=0.25, height=0.2)
    rod = fmbd.FloatingBody("full", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(E, NU))
    low, high = (mesh.placed((0.0, y)) for y in (-1.0, 1.0))
    energy = fmbd.materials.saint_venant_kirchhoff(E, NU)
    bodies = (
        rod,
        rod.with_(name="few", mesh=low).reduced(modes=4),
        fmbd.AbsoluteBody("free", high, degree=2, density=1e3, energy=energy),
    )
    scene = fmbd.Scene("three", gravity=(0, -9.81))
    for body, y in zip(bodies, (0.0, -1.0, 1.0), strict=True):
        scene.add(body, fmbd.revolute(f"pin of {body.name}", fmbd.ground, body.surface("pin"), center=(0.0, y)))
        scene.sensor(body.name, fmbd.position(body.surface("tip")))
    return fmbd.solve(scene, t_end=0.1, dt=5e-3, output=fmbd.Output(snapshots=3))


@pytest.mark.mpi
def test_time_histories_with_units(pendulums: fmbd.Run, shared_tmp: Path) -> None:
    file = shared_tmp / "run.csv"
    pendulums.save(file)
    if pendulums.system.comm.rank == 0:
        with file.open() as rows:
            head, *lines = csv.reader(rows)
        assert head[:3] == ["time (s)", "full x (m)", "full y (m)"] and "elastic energy (J)" in head
        values = np.array(lines, dtype=float)
        np.testing.assert_array_equal(values[:, 0], pendulums.times)
        np.testing.assert_array_equal(values[:, 1:3], pendulums["full"])
    with pytest.raises(fmbd.errors.InputError, match="cannot be written"):
        pendulums.save(shared_tmp / "nowhere" / "run.csv")
    with pytest.raises(fmbd.errors.InputError, match='must end in .csv, .txt or .dat, found ".xlsx"'):
        pendulums.save(shared_tmp / "run.xlsx")


def test_a_full_disk_costs_no_older_file(pendulums: fmbd.Run, tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    file.write_text("of an earlier run")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (400, limits[1]))  # bytes a file
    try:
        with pytest.raises(
            fmbd.errors.InputError, match='The time histories cannot be written to ".*run.csv": File too large'
        ):
            pendulums.save(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert file.read_text() == "of an earlier run" and list(tmp_path.iterdir()) == [file]


@pytest.mark.mpi
@pytest.mark.smoke
def test_fields_show_the_true_motion(pendulums: fmbd.Run, shared_tmp: Path) -> None:
    pv = pytest.importorskip("pyvista")
    files = pendulums.save_fields(shared_tmp / "fields", {"von Mises (Pa)": von_mises})
    assert [f.stem for f in files] == ["full", "few", "free", "scene"]
    pendulums.system.comm.barrier()
    for file in files[:-1]:
        reader = pv.get_reader(str(file))
        np.testing.assert_allclose(reader.time_values, [0.0, 0.05, 0.1])
        reader.set_active_time_value(reader.time_values[-1])
        cells = reader.read().combine(merge_points=True)
        tip = np.isclose(cells.points[:, 0], 1.0)
        x = (cells.points + cells["displacement"])[tip, :2]
        ends = [x[np.argmin(x[:, 1])], x[np.argmax(x[:, 1])]]  # P2 facets: the mean of a straight end is its middle
        np.testing.assert_allclose(np.mean(ends, axis=0), pendulums[file.stem][-1], atol=2e-4)
        assert cells["von Mises (Pa)"].max() > 1e2


def test_fields_without_snapshots_are_those_of_the_last_state(tmp_path: Path) -> None:
    mesh = fmbd.read_gmsh("meshes/rod.py", h=0.5)
    rod = fmbd.FloatingBody(
        "rod", mesh, density=1e3, elastic=fmbd.materials.linear_elastic(5e6, 0.3), velocity=(3.0, 0.0)
    )
    scene = fmbd.Scene("flight")
    scene.add(rod)
    fmbd.solve(scene, t_end=0.1, dt=0.05).save_fields(tmp_path)
    (file,) = tmp_path.glob("rod*.vtu")
    import pyvista

    assert pyvista.read(file)["displacement"][:, 0] == pytest.approx(0.3, abs=1e-9)


@pytest.mark.mpi
def test_one_file_opens_the_whole_scene(pendulums: fmbd.Run, shared_tmp: Path) -> None:
    pv = pytest.importorskip("pyvista")
    scene = pendulums.save_fields(shared_tmp / "whole")[-1]
    pendulums.system.comm.barrier()
    reader = pv.get_reader(str(scene))
    np.testing.assert_allclose(reader.time_values, [0.0, 0.05, 0.1])
    names = {d.attrib["name"] for d in ET.parse(scene).getroot().iter("DataSet")}
    assert {"full", "few", "free", "pin of full", "ground at pin of few"} <= names
    reader.set_active_time_value(reader.time_values[-1])
    assert all("displacement" in block.point_data for block in reader.read() if block is not None and block.n_points)


@pytest.mark.mpi
def test_names_that_meet_have_files_of_their_own(rod_mesh: Callable[..., Any], shared_tmp: Path) -> None:
    rod = fmbd.FloatingBody(
        "scene", rod_mesh(dim=2, h=0.5, height=0.2), density=1e3, elastic=fmbd.materials.linear_elastic(E, NU)
    )
    scene = fmbd.Scene("names")
    scene.add(rod, rod.with_(name="a/b"), rod.with_(name="a_b"), fmbd.RigidBody("scene_", 1.0, 1.0))
    run = fmbd.solve(scene, t_end=0.01, dt=0.01, output=fmbd.Output(snapshots=2))
    files = run.save_fields(shared_tmp / "names")
    assert [f.name for f in files] == ["scene_.pvd", "a_b.pvd", "a_b_.pvd", "scene.pvd"]
    run.system.comm.barrier()
    listed = [(d.attrib["name"], d.attrib["file"]) for d in ET.parse(files[-1]).getroot().iter("DataSet")]
    assert {name for name, _ in listed} >= {"scene", "a/b", "a_b", "scene_"}
    assert len({file for _, file in listed}) == len(listed)


def test_rigid_bodies_are_written_where_they_are(tmp_path: Path) -> None:
    pv = pytest.importorskip("pyvista")
    ball = fmbd.RigidBody("ball", 1.0, (0.1, 0.1, 0.1), (0.0, 0.0, 1.0), shape=fmbd.contacts.Sphere(0.1))
    scene = fmbd.Scene("falling", gravity=(0, 0, -9.81))
    scene.add(ball)
    scene.sensor("ball", fmbd.sensors.position(ball))
    run = fmbd.solve(scene, t_end=0.2, dt=0.01, output=fmbd.Output(snapshots=3))
    (file,) = run.save_fields(tmp_path)
    reader = pv.get_reader(str(file))
    reader.set_active_time_value(reader.time_values[-1])
    grid = reader.read().combine()
    where = (grid.points + grid["displacement"]).mean(0)
    np.testing.assert_allclose(where, run["ball"][-1], atol=1e-6)


def test_components_have_units_of_their_own(tmp_path: Path) -> None:
    """Forces and moments of a rod's section, in tables and on axes."""
    section = fmbd.RodSection.circle(youngs_modulus=2e11, poisson_ratio=0.3, density=7800.0, radius=0.01)
    scene = fmbd.Scene("cantilever", gravity=(0, 0, -9.81))
    rod = scene.add(fmbd.Rod("rod", [(0, 0, 0), (1, 0, 0)], section, elements=1))
    scene.add(fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.sensor("root", fmbd.sensors.section_forces(rod.surface("start")))
    scene.sensor("strain", fmbd.sensors.section_strains(rod.surface("start")))
    run = fmbd.solve(scene, t_end=1e-3, dt=1e-3)

    run.save(tmp_path / "run.csv")
    with (tmp_path / "run.csv").open() as file:
        names = next(csv.reader(file))
    assert {"root Q3 (N)", "root M2 (N m)", "strain gamma 1 (1)", "strain kappa 3 (1/m)"} <= set(names)
    assert series_of(run, "root M2")[2] == "N m" and series_of(run, "root N")[2] == "N"
