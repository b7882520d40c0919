"""Meshes of CAD files and of other programs: sizes, named surfaces, what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import MeshError


def area(mesh: Any, name: str) -> float:
    """Area of a named surface; collective."""
    import ufl
    from dolfinx import fem

    ds = ufl.Measure("ds", domain=mesh.dolfinx, subdomain_data=mesh.facet_tags)
    one = fem.Constant(mesh.dolfinx, 1.0)
    return float(mesh.dolfinx.comm.allreduce(fem.assemble_scalar(fem.form(one * ds(mesh.surface_tag(name))))))


@pytest.fixture
def part(shared_tmp: Path) -> Path:
    """A STEP file: a plate of 40 x 20 x 5 mm with a bore of radius 4 mm about (10, 10)."""
    from fmbd_fenicsx.ranks import world_rank

    file = shared_tmp / "plate.step"
    if world_rank() == 0:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        plate, drill = gmsh.model.occ.addBox(0, 0, 0, 40, 20, 5), gmsh.model.occ.addCylinder(10, 10, -1, 0, 0, 9, 4)
        gmsh.model.occ.cut([(3, plate)], [(3, drill)])
        gmsh.model.occ.synchronize()
        gmsh.write(str(file))
        gmsh.finalize()
    from mpi4py import MPI

    MPI.COMM_WORLD.barrier()
    return file


@pytest.mark.mpi
def test_step_file_with_a_size_and_named_surfaces(part: Path) -> None:
    mesh = fmbd.read_cad(
        part,
        h=2e-3,
        scale=1e-3,
        surfaces={
            "bore": (0.014, 0.01, 0.0025),
            "end": lambda x: x[0] > 0.04 - 1e-9,
            "ends": lambda x: np.abs(x[0] - 0.02) > 0.02 - 1e-9,
        },
    )
    assert mesh.surface_names == ["bore", "end", "ends"]
    assert area(mesh, "ends") == pytest.approx(2 * area(mesh, "end"), rel=1e-9)
    assert area(mesh, "end") == pytest.approx(0.02 * 0.005, rel=1e-9)
    assert area(mesh, "bore") == pytest.approx(2 * np.pi * 0.004 * 0.005, rel=0.03)  # flat facets around
    body = fmbd.FloatingBody("plate", mesh, density=7800.0, elastic=fmbd.materials.linear_elastic(2e11, 0.3), degree=1)
    scene = fmbd.Scene("plate")
    scene.add(body)
    system, _, _ = scene.build()
    exact = 7800.0 * (0.04 * 0.02 - np.pi * 0.004**2) * 0.005
    assert system.mass == pytest.approx(exact, rel=0.01)
    with pytest.raises(MeshError, match='no face belongs to surface "top".*7 faces'):
        fmbd.read_cad(part, h=4e-3, scale=1e-3, surfaces={"top": lambda x: x[2] > 1.0})
    with pytest.raises(MeshError, match=r'surface "side": its point \(1.0, 0.0, 0.0\) is 0.96 m from the nearest'):
        fmbd.read_cad(part, h=4e-3, scale=1e-3, surfaces={"side": (1, 0, 0)})
    with pytest.raises(MeshError, match="does not exist"):
        fmbd.read_cad("missing.step", h=1.0, surfaces={})


@pytest.mark.serial
def test_a_point_takes_the_face_that_it_lies_on_and_not_another_in_its_plane(tmp_path: Path) -> None:
    """A bridge on two feet: their soles lie in one plane."""
    import gmsh

    file = tmp_path / "bridge.step"
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    feet = [(3, occ.addBox(x, 0, 0, 2, 3, 2)) for x in (0, 8)]
    occ.fuse([(3, occ.addBox(0, 0, 2, 10, 3, 1))], feet)
    occ.synchronize()
    gmsh.write(str(file))
    gmsh.finalize()

    points = {"left": (1.0, 1.5, -0.1), "right": (9.0, 1.5, 0.0), "inner": (8.0, 1.0, 1.0)}
    for name, place in points.items():
        mesh = fmbd.read_cad(file, h=1.0, scale=1.0, surfaces={name: place})
        center, size = middle(mesh, name)
        assert size == pytest.approx(6.0, rel=1e-9)
        assert center == pytest.approx(
            {"left": (1, 1.5, 0), "right": (9, 1.5, 0), "inner": (8, 1.5, 1)}[name], abs=1e-9
        )


def middle(mesh: Any, surface: str) -> tuple[Any, float]:
    """Centre and area of a surface."""
    body = fmbd.FloatingBody("b", mesh, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3), degree=1)
    scene = fmbd.Scene("s")
    scene.add(body, fmbd.fixed("c", fmbd.ground, body.surface(surface)))
    scene.sensor("x", fmbd.position(body.surface(surface)))
    return fmbd.solve(scene, t_end=1e-3, dt=1e-3)["x"][0], area(mesh, surface)


def two_tetrahedra(**sets: Any) -> Any:
    """A pyramid of two tetrahedra over the unit square, one of them turned inside out, and two triangles of its floor."""
    import meshio

    points = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1.0)], dtype=float)
    cells = [("tetra", np.array([(0, 1, 2, 4), (0, 3, 2, 4)])), ("triangle", np.array([(0, 1, 2), (0, 2, 3)]))]
    return meshio.Mesh(points, cells, **sets)


@pytest.mark.serial
def test_abaqus_sets_become_surfaces(tmp_path: Path) -> None:
    file = tmp_path / "pyramid.inp"
    two_tetrahedra(point_sets={"floor": np.array([0, 1, 2, 3]), "top": np.array([4])}).write(file)
    mesh = fmbd.read_mesh(
        file,
        scale=1e-3,
        surfaces={"side": lambda x: x[1] < 0.51e-3 * (x[2] > 0.9e-3) + 1e-9, "all": lambda x: x[2] > -1},
    )
    assert mesh.surface_names == ["all", "floor", "side"], "a node alone is no surface"
    assert area(mesh, "all") == pytest.approx(1e-6 * (1 + np.sqrt(5)))
    assert area(mesh, "floor") == pytest.approx(1e-6) and area(mesh, "side") == pytest.approx(0.5e-6 * np.sqrt(1.25))


@pytest.mark.serial
def test_nastran_properties_become_surfaces(tmp_path: Path) -> None:
    file = tmp_path / "pyramid.bdf"
    refs = [np.array([1, 1]), np.array([7, 8])]
    two_tetrahedra(cell_data={"nastran:ref": refs}).write(file)
    mesh = fmbd.read_mesh(file)
    assert mesh.surface_names == ["property 7", "property 8"] and area(mesh, "property 7") == pytest.approx(0.5)


@pytest.mark.serial
def test_mesh_without_named_sets_says_what_is_there(tmp_path: Path) -> None:
    file = tmp_path / "bare.vtu"
    two_tetrahedra().write(file)
    with pytest.raises(MeshError, match="2 cells of kind tetra, 2 cells of kind triangle; named sets: none"):
        fmbd.read_mesh(file)
    with pytest.raises(MeshError, match='no set of cells "arm"'):
        fmbd.read_mesh(file, volume="arm")
    with pytest.raises(MeshError, match="true at no facet"):
        fmbd.read_mesh(file, surfaces={"far": lambda x: x[0] > 9})
    (tmp_path / "notes.xyzw").write_text("nothing")
    with pytest.raises(MeshError, match="cannot be read"):
        fmbd.read_mesh(tmp_path / "notes.xyzw")
