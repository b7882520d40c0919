"""Sensors at material points: exact for fields that the space holds, rates are rates, one value on all ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.material_points import distance_to
from fmbd_fenicsx.materials import linear_elastic, neo_hookean
from fmbd_fenicsx.rotations import Array
from fmbd_fenicsx.system.layout import State

LAW = linear_elastic(1e6, 0.3)


def curved(x: Array) -> Array:
    """A small displacement of second degree, which P2 holds exactly."""
    out = 1e-3 * np.stack([x[0] * x[1] - 0.5 * x[0] ** 2, x[0] + 2 * x[1] ** 2])
    return out if len(x) == 2 else np.concatenate((out, 1e-3 * (x[2] * x[0])[None]))


def gradient(x: Array) -> Array:
    """Its gradient at one point."""
    H = np.zeros((len(x), len(x)))
    H[:2, :2] = [[x[1] - x[0], x[0]], [1.0, 4 * x[1]]]
    if len(x) == 3:
        H[2] = x[2], 0.0, x[0]
    return 1e-3 * H


def body(mesh: Any, kind: Any, **more: Any) -> Any:
    spin = 0.7 if mesh.dim == 2 else (0.3, -0.5, 0.7)
    law = {"elastic": LAW} if "energy" not in more else {}
    return kind("rod", mesh, density=100.0, displacement=curved, angular_velocity=spin, **law, **more)


def read(scene: fmbd.Scene, state: State | None = None) -> dict[str, Array]:
    """All sensors of a scene in a state (that of the start)."""
    system, start, markers = scene.build()
    state = start if state is None else state
    ev = system.at(state.t, state.q, state.v)
    return {name: s.read(ev, state, markers[name]) for name, s in scene.sensors.items()}


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", [fmbd.FloatingBody, fmbd.AbsoluteBody])
def test_start_is_read_exactly(rod_mesh: Callable[..., Any], dim: int, kind: Any) -> None:
    """Position, strain and a UFL quantity of a field of second degree, inside, on the boundary and at a corner."""
    from ufl import grad, sym

    mesh = rod_mesh(dim=dim, h=0.3, height=0.2)
    rod = body(mesh, kind)
    points = [np.array(p)[:dim] for p in ((0.43, 0.031, 0.02), (0.77, 0.1, 0.0), (1.0, 0.1, 0.1))]
    scene = fmbd.Scene("points")
    scene.add(rod)
    for i, X in enumerate(points):
        scene.sensor(f"x {i}", fmbd.position(rod, point=X))
        scene.sensor(f"strain {i}", fmbd.sensors.strain(rod, point=X))
    scene.sensor("tensor", fmbd.sensors.point_value(rod, lambda u: sym(grad(u)), point=points[0], unit="-"))
    found = read(scene)

    pairs = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}[dim]
    for i, X in enumerate(points):
        assert np.allclose(found[f"x {i}"], X + curved(X), atol=1e-13)
        H = gradient(X)
        exact = [0.5 * (H[i, j] + H[j, i]) for i, j in pairs]
        # a floating frame turns with the mean rotation, of 1e-3: strains differ by its product with them
        assert np.allclose(found[f"strain {i}"], exact, atol=1e-13 if kind is fmbd.AbsoluteBody else 2e-6)
    tensor = found["tensor"].reshape(dim, dim)
    assert np.allclose([tensor[i, j] for i, j in pairs], found["strain 0"], atol=1e-14)


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", ["floating", "reduced", "no modes", "absolute"])
def test_velocities_and_accelerations_are_rates(rod_mesh: Callable[..., Any], dim: int, kind: str) -> None:
    """At any state x' is the derivative of x along the motion, and x'' that of x'."""
    rod = body(rod_mesh(dim=dim, h=0.3, height=0.2), fmbd.AbsoluteBody if kind == "absolute" else fmbd.FloatingBody)
    modes = {"reduced": 4, "no modes": 0}
    rod = rod.reduced(modes=modes[kind]) if kind in modes else rod
    scene = fmbd.Scene("rates")
    scene.add(rod)
    X = (0.43, 0.031, 0.02)[:dim]
    for name, make in (("x", fmbd.position), ("v", fmbd.velocity), ("a", fmbd.acceleration)):
        scene.sensor(name, make(rod, point=X))

    system, start, _ = scene.build()
    n = system.n_frames * system.motions.n_twist
    rng = np.random.default_rng(3)
    v, a = rng.standard_normal((2, n))
    v, a = (np.concatenate((x, 0.1 * np.sin(np.arange(system.n_v - n) + k))) for k, x in enumerate((v, a)))

    def at(t: float) -> dict[str, Array]:
        """On the motion with the given velocity and acceleration at t = 0."""
        q = system.compose(start.q, t * v + 0.5 * t * t * a)
        return read(scene, State(0.0, q, v + t * a, a, start.lam))

    h = 1e-5
    before, now, after = at(-h), at(0.0), at(h)
    assert np.allclose((after["x"] - before["x"]) / (2 * h), now["v"], rtol=1e-8, atol=1e-8)
    assert np.allclose((after["v"] - before["v"]) / (2 * h), now["a"], rtol=1e-7, atol=1e-7)
    assert np.linalg.norm(now["a"]) > 0.01


@pytest.mark.mpi
def test_reduced_body_reads_what_its_field_shows(rod_mesh: Callable[..., Any]) -> None:
    """The sensor of a reduced body agrees with that of the full one where the modes hold the displacement."""
    mesh = rod_mesh(dim=2, h=0.3, height=0.2)
    rod = body(mesh, fmbd.FloatingBody)
    found = {}
    for name, one in (("full", rod), ("reduced", rod.reduced(modes=83))):
        scene = fmbd.Scene(name)
        scene.add(one)
        scene.sensor("u", fmbd.sensors.elastic_displacement(one, point=(0.43, 0.031)))
        scene.sensor("strain", fmbd.sensors.strain(one, point=(0.43, 0.031)))
        found[name] = read(scene)
    for key, value in found["full"].items():
        assert np.allclose(found["reduced"][key], value, atol=3e-5 * np.abs(value).max())


@pytest.mark.mpi
def test_large_strain_is_that_of_green_and_lagrange(rod_mesh: Callable[..., Any]) -> None:
    """A stretch of 20 per cent in x, uniform: E_xx = (1.2^2 - 1) / 2."""
    mesh = rod_mesh(dim=2, h=0.3, height=0.2)
    rod = fmbd.AbsoluteBody(
        "rod", mesh, density=1.0, energy=neo_hookean(1e6, 0.3), displacement=lambda x: np.stack([0.2 * x[0], 0 * x[1]])
    )
    scene = fmbd.Scene("stretch")
    scene.add(rod)
    scene.sensor("E", fmbd.sensors.strain(rod, point=(0.5, 0.0)))
    assert np.allclose(read(scene)["E"], (0.22, 0.0, 0.0), atol=1e-13)


def test_run_records_points_with_units_and_labels(rod_mesh: Callable[..., Any], tmp_path: Any) -> None:
    rod = body(rod_mesh(dim=2, h=0.3, height=0.2), fmbd.FloatingBody)
    scene = fmbd.Scene("recorded")
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.sensor("strain", fmbd.sensors.strain(rod, point=(0.5, 0.0)))
    run = fmbd.solve(scene, t_end=2e-3, dt=1e-3)
    run.save(tmp_path / "run.csv")
    head = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert run["strain"].shape == (3, 3) and '"strain xy (1)"' in head


@pytest.mark.mpi
def test_points_outside_and_bodies_without_a_mesh_are_refused(rod_mesh: Callable[..., Any]) -> None:
    rod = body(rod_mesh(dim=2, h=0.3, height=0.2), fmbd.FloatingBody)
    with pytest.raises(
        InputError, match=r"strain: the point \(0.5, 0.3\) lies 0.2 m outside of .*rod.py.*from \[0.0, -0.1\]"
    ):
        fmbd.sensors.strain(rod, point=(0.5, 0.3))
    with pytest.raises(InputError, match="position: point"):
        fmbd.position(rod, point=(0.5, 0.0, 0.1))
    with pytest.raises(InputError, match="material point of an elastic body"):
        fmbd.sensors.strain(fmbd.RigidBody("r", 1.0, 1.0), point=(0.5, 0.0))
    with pytest.raises(InputError, match="attach to a surface"):
        fmbd.position(rod)


@pytest.mark.mpi
def test_a_point_of_several_cells_is_in_the_first_of_the_mesh(rod_mesh: Callable[..., Any]) -> None:
    """On any number of ranks: strains jump at the sides of cells."""
    msh = rod_mesh(dim=2, h=0.05).dolfinx
    places = msh.topology.original_cell_index
    cells = msh.geometry.dofmap[: msh.topology.index_map(2).size_local]
    parts = msh.comm.allgather([(places[c], *msh.geometry.x[n, :2]) for c, nodes in enumerate(cells) for n in nodes])
    first: dict[tuple[float, ...], int] = {}
    for place, *x in sorted(sum(parts, [])):
        first.setdefault(tuple(np.round(x, 12)), int(place))

    for x, expected in list(first.items())[::7]:
        distance, owner, cell = distance_to(msh, np.array(x))
        found = msh.comm.bcast(int(places[cell]), root=owner)
        assert distance < 1e-9 and found == expected


@pytest.mark.mpi
@pytest.mark.parametrize("kind", ["field", "modes", "absolute"])
def test_integrals_and_means_of_materials(kind: str) -> None:
    """A bar of two materials side by side under a force: their energies are its work, their mean stresses carry it."""
    from ufl import FacetNormal, dot, grad, inner, sym

    thick, moduli, force = {"steel": 0.1, "rubber": 0.3}, {"steel": 2e8, "rubber": 5e7}, 1e3
    mesh = fmbd.read_gmsh("meshes/layers.py", volume=tuple(thick), layers=thick, h=0.2)

    def elastic(u: Any, v: Any, dx: Any) -> Any:
        return sum(E * inner(sym(grad(u)), sym(grad(v))) * dx(mesh.volume_tag(name)) for name, E in moduli.items())

    sort = fmbd.AbsoluteBody if kind == "absolute" else fmbd.FloatingBody
    bar = sort("bar", mesh, density=1e3, elastic=elastic)
    if kind == "modes":
        bar = bar.reduced(basis=fmbd.CraigBampton(("left", "right"), 2))
    scene = fmbd.Scene("bar")
    scene.add(bar, fmbd.fixed("clamp", fmbd.ground, bar.surface("left")))
    scene.add(fmbd.prismatic("rail", fmbd.ground, bar.surface("right"), axis=(1, 0)))
    scene.add(fmbd.force("pull", bar.surface("right"), lambda t: (force, 0.0)))
    for name, E in moduli.items():
        scene.sensor(name, fmbd.sensors.mean(bar, lambda u, E=E: E * sym(grad(u)), over=name))
        energy = fmbd.sensors.integral(
            bar, lambda u, E=E: 0.5 * E * inner(sym(grad(u)), sym(grad(u))), over=name, unit="J"
        )
        scene.sensor(f"energy of {name}", energy)
    scene.sensor("area", fmbd.sensors.integral(bar, lambda u: 1.0, unit="m^2"))
    out = fmbd.sensors.mean(bar, lambda u: dot(u, FacetNormal(mesh.dolfinx)), over="right", unit="m")
    scene.sensor("out", out)
    scene.sensor("left", fmbd.sensors.mean(bar, lambda u: u[0], over="left", unit="m"))
    scene.sensor("end", fmbd.position(bar.surface("right")))

    rest = fmbd.equilibrium(scene)
    carried = sum(rest[name][0] * thick[name] for name in moduli)
    assert carried == pytest.approx(force, rel=1e-8)
    assert abs(rest["steel"]).max() == rest["steel"][0] > 3.0 * rest["rubber"][0]
    stored = sum(rest[f"energy of {name}"][0] for name in moduli)
    assert stored == pytest.approx(0.5 * force * (rest["end"][0] - 1.0), rel=1e-8)
    assert rest["area"] == pytest.approx(0.4, rel=1e-12)
    assert rest["out"] - rest["left"] == pytest.approx(rest["end"][0] - 1.0, rel=1e-8)

    # many records at once are what each state tells
    run = fmbd.solve(scene, t_end=2e-3, dt=1e-3)
    assert run["steel"].shape == (3, 4)
    system, start, markers = scene.build()
    assert scene.sensors["steel"].read(system.at(0.0, start.q, start.v), start, markers["steel"]) == pytest.approx(0.0)
    wrong: tuple[tuple[Any, str], ...] = (
        (fmbd.sensors.mean(bar, lambda u: 1 / 0), "mean: quantity.*failed: ZeroDivisionError"),
        (fmbd.sensors.mean(bar, lambda u: "none"), "mean: quantity.*failed: .*can not be converted"),
        (fmbd.largest(bar, lambda u: grad(u)), r"largest: quantity\(u\) has the shape \(2, 2\)"),
    )
    for sensor, why in wrong:
        scene.sensor("wrong", sensor)
        with pytest.raises(InputError, match=why):
            fmbd.solve(scene, t_end=1e-3, dt=1e-3)
        del scene.sensors["wrong"]
    with pytest.raises(InputError, match='no surface "stel".* Volumes: rubber, steel'):
        fmbd.sensors.mean(bar, lambda u: u, over="stel")


@pytest.mark.mpi
def test_the_largest_of_a_body_smaller_than_the_ranks() -> None:
    """Ranks that hold nothing of it take part: two cells, read with the body by itself and in absolute coordinates."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 1.0), counts=(1, 1))
    for kind in (fmbd.FloatingBody, fmbd.AbsoluteBody):
        block = kind(
            "block", mesh, density=100.0, elastic=LAW, displacement=lambda x: 1e-3 * np.stack((x[0], 0 * x[0]))
        )
        scene = fmbd.Scene("block")
        scene.add(block)
        scene.sensor("strain", fmbd.largest(block, lambda u: u[0].dx(0), unit="1"))
        scene.sensor("mean", fmbd.sensors.mean(block, lambda u: u[0].dx(0), unit="1"))
        run = fmbd.solve(scene, t_end=1e-6, dt=1e-6)
        assert run["strain"][0] == pytest.approx(1e-3, rel=1e-9) == run["mean"][0]
