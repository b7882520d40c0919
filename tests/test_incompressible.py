"""Large strain at nu = 1/2 with the pressure as an unknown: exact stretch, inflated ring, volume kept in motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import quad

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConstraintError, InputError
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.materials import neo_hookean_incompressible, neo_hookean_mixed
from fmbd_fenicsx.schemes.consistent import consistent

ROOT = Path(__file__).resolve().parents[1]
E, DENSITY = 3e6, 1000.0
MU = E / 3
QUIET = fmbd.Output(estimate_error=False)


def the_field(run: fmbd.Run) -> tuple[Any, Any]:
    """Field of the only elastic body, and its displacements at the end."""
    k, part = run.system.fields[0]
    return part.field, run.system.local_q(run.state.q, k)


def volume_gap(run: fmbd.Run) -> float:
    """Largest mean of J - 1 over a function of the pressure's space; collective."""
    import ufl
    from dolfinx import fem, la

    field, U = the_field(run)
    field.place(U)
    q, dx = ufl.TestFunction(field.pressure), ufl.Measure("dx", field.mesh.dolfinx)
    J = ufl.det(ufl.Identity(field.dim) + ufl.grad(field._w))
    moments = []
    for form in ((J - 1) * q * dx, q * dx):
        b = fem.assemble_vector(fem.form(form))
        b.scatter_reverse(la.InsertMode.add)
        moments.append(b.array[: field.n_pressure])
    return float(max(field.comm.allgather(np.abs(moments[0] / moments[1]).max(initial=0.0))))


def stretched(dim: int, stretch: float, nu: float = 0.5) -> fmbd.Run:
    """A block at rest under the dead traction of an incompressible stretch along x."""
    traction = MU * (stretch - stretch ** (-3 if dim == 2 else -2))
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5, 0.5)[:dim], counts=(3, 2, 2)[:dim])
    load = fmbd.traction("right", (traction, 0.0, 0.0)[:dim])
    energy = neo_hookean_incompressible(2 * MU * (1 + nu), nu)
    body = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=energy, loads=[load])
    scene = fmbd.Scene("stretch", settle=True)
    scene.add(body, fmbd.fixed("wall", body.surface("left"), fmbd.ground))
    scene.sensor("end", fmbd.position(body.surface("right")))
    return fmbd.solve(scene, t_end=2e-3, dt=1e-3, output=QUIET)


@pytest.mark.mpi
@pytest.mark.parametrize("dim, stretch", [(2, 1.5), (3, 1.2)])
def test_homogeneous_stretch(dim: int, stretch: float) -> None:
    """Displacement, pressure and volume of the patch are exact: p = mu (1 - s^2) for the stretch s across."""
    run = stretched(dim, stretch)
    field, U = the_field(run)
    across = stretch ** (-1 if dim == 2 else -0.5)
    np.testing.assert_allclose(run["end"][:, 0], stretch, atol=1e-10)
    np.testing.assert_allclose(field.pressure_values, MU * (1 - across**2), rtol=1e-9)
    x = field.X_world + U.reshape(-1, dim)
    height = field.X_world[:, 1] - 0.25
    np.testing.assert_allclose(x[:, 1], 0.25 + across * height, atol=1e-10)
    assert volume_gap(run) < 1e-11


def test_below_one_half() -> None:
    """At nu = 0.49 the pressure is lambda (J - 1) and the stretch that of the energy."""
    run = stretched(2, 1.3, 0.49)
    field, _ = the_field(run)
    p, lam = float(field.pressure_values.mean()), 2 * MU * 0.49 / 0.02
    np.testing.assert_allclose(field.pressure_values, p, rtol=1e-7)
    J = 1 + p / lam
    s = run["end"][-1, 0]
    for stretch, traction in ((s, MU * (1.3 - 1.3**-3)), (J / s, 0.0)):
        found = MU * (stretch - 1 / stretch) + p * J / stretch
        assert abs(found - traction) < 1e-8 * MU


def inflation(ratio: float, outer: float, inner: float) -> float:
    """Pressure (Pa) that widens an incompressible ring in plane strain to ``ratio`` of its inner radius."""
    c = inner**2 * (ratio**2 - 1)

    def slope(R: float) -> float:
        square = (R * R + c) / R**2
        return MU * (square - 1 / square) * R / (R * R + c)

    return float(quad(slope, inner, outer)[0])


@pytest.mark.serial
def test_inflated_ring() -> None:
    """The inner radius under a follower pressure converges with order 2 (the polygon) to that of the closed form."""
    inner, outer, ratio = 0.01, 0.03, 1.2
    pressure, errors = inflation(ratio, outer, inner), []
    for h in (0.008, 0.004):
        mesh = fmbd.read_gmsh(ROOT / "meshes/ring.py", radius=(inner + outer) / 2, width=outer - inner, h=h)
        body = fmbd.AbsoluteBody(
            "ring",
            mesh,
            density=DENSITY,
            energy=neo_hookean_incompressible(E),
            loads=[fmbd.pressure("inner", pressure)],
        )
        scene = fmbd.Scene("ring", settle=True)
        scene.add(body, fmbd.fixed("hold", body.surface("outer"), fmbd.ground))
        run = fmbd.solve(scene, t_end=1e-5, dt=1e-5, output=QUIET)
        field, U = the_field(run)
        at = np.hypot(*field.X_world.T) < inner * 1.0001
        r = np.hypot(*(field.X_world + U.reshape(-1, 2))[at].T)
        R = np.hypot(*field.X_world[at].T)
        corner = R > inner * 0.9999
        errors.append(abs(float(r[corner].mean()) / (inner * ratio) - 1))
        assert volume_gap(run) < 1e-10
    assert errors[1] < 0.35 * errors[0]
    assert errors[1] < 5e-3


def pendulum(mesh: Any, energy: Any, scheme: Any = None) -> fmbd.Run:
    """A soft rod that falls about a pin at its end, dt = 2.5 ms."""
    body = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=energy)
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: body.dim])
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return fmbd.solve(scene, t_end=0.1, dt=2.5e-3, scheme=scheme, output=QUIET)


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.mpi)])
def test_volume_in_motion(rod_mesh: Callable[..., Any], dim: int) -> None:
    """A falling soft rod keeps its volume to 1e-8, and moves as with a large lambda."""
    mesh = rod_mesh(dim=dim, h=0.1)
    run = pendulum(mesh, neo_hookean_incompressible(1e5))
    assert volume_gap(run) < 1e-8
    if dim == 2:
        near = pendulum(mesh, neo_hookean_mixed(1e5, 0.5))
        assert volume_gap(near) > 1e-7
        assert np.abs(near["tip"] - run["tip"]).max() < 1e-4
        again = fmbd.solve(run.scene, t_end=0.1, dt=2.5e-3, output=QUIET)
        np.testing.assert_allclose(again["tip"], run["tip"], rtol=0, atol=1e-12)


def test_refused(rod_mesh: Callable[..., Any]) -> None:
    """What does not move the pressure is refused: other schemes, the stabilised form, floating frames; a wrong start."""
    mesh, energy = rod_mesh(dim=2, h=0.25), neo_hookean_incompressible(1e5)
    for scheme in (fmbd.Rattle(), fmbd.BDF(form=fmbd.forms.Index1()), fmbd.GeneralizedAlpha(form=fmbd.GGL())):
        with pytest.raises(InputError, match="pressure that is an unknown"):
            pendulum(mesh, energy, scheme)
    for nu in (0.0, 0.51):
        with pytest.raises(InputError, match="must lie in"):
            neo_hookean_incompressible(1e5, nu)
    scene = fmbd.Scene("floating")
    scene.add(fmbd.FloatingBody("rod", mesh, density=DENSITY, energy=energy))
    with pytest.raises(InputError, match="needs an AbsoluteBody"):
        scene.build()
    squeezed = fmbd.Scene("squeezed")
    squeezed.add(fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=energy, displacement=lambda X: 0.1 * X))
    with pytest.raises(ConstraintError, match="keeps its volume"):
        fmbd.solve(squeezed, t_end=1e-3, dt=1e-3)


@pytest.mark.mpi
def test_contact_moves_the_pressure(rod_mesh: Callable[..., Any]) -> None:
    """A rod that a spring bends keeps its volume under the scheme with contact, and moves as without a floor far below."""
    found = []
    for scheme in (fmbd.GeneralizedAlpha(0.8), fmbd.ContactAlpha(0.8)):
        body = fmbd.AbsoluteBody(
            "rod", rod_mesh(dim=2, h=0.25), density=DENSITY, energy=neo_hookean_incompressible(1e6)
        )
        scene = fmbd.Scene("sprung", gravity=(0.0, -9.81))
        scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
        anchors = {"point_a": (1.0, 1.0), "point_b": (1.0, 0.0)}
        scene.add(fmbd.Spring("spring", fmbd.ground, body.surface("tip"), stiffness=2e3, **anchors))
        if isinstance(scheme, fmbd.ContactAlpha):
            floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, -2.0), (0.0, 1.0)))
            scene.add(fmbd.contact("floor", body.surface("tip"), floor, redistribute_mass=False))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        found.append(fmbd.solve(scene, t_end=0.04, dt=2e-3, scheme=scheme, output=QUIET))

    free, contact = found
    assert volume_gap(contact) < 1e-8
    way = free["tip"][-1] - free["tip"][0]
    assert np.linalg.norm(way) > 0.02
    assert np.linalg.norm(contact["tip"][-1] - free["tip"][-1]) < 0.01 * np.linalg.norm(way)

    pressures = []
    for run in found:
        field, _ = the_field(run)
        pressures.append(float(max(field.comm.allgather(np.abs(field.pressure_values).max(initial=0.0)))))
    assert abs(pressures[1] / pressures[0] - 1) < 0.03, pressures


@pytest.mark.mpi
def test_first_pressure_is_that_of_the_motion() -> None:
    """A ring set spinning: div grad p = -2 rho w^2 with p = 0 at both edges, and accelerations that keep the volume."""
    ri, ro, w = 0.5, 1.5, 3.0
    mesh = fmbd.read_gmsh(ROOT / "meshes/ring.py", radius=1.0, width=1.0, h=0.1)
    body = fmbd.AbsoluteBody("ring", mesh, density=DENSITY, energy=neo_hookean_incompressible(E), angular_velocity=w)
    scene = fmbd.Scene("ring")
    scene.add(body)
    system, given, _ = scene.build()
    start, _ = consistent(system, given, StepSolver(system))
    field: Any = system.fields[0][1].field
    r = np.hypot(*field.pressure.tabulate_dof_coordinates()[: field.n_pressure, :2].T)
    c = (ro**2 - ri**2) / np.log(ro / ri)
    exact = 0.5 * DENSITY * w**2 * (ri**2 - r**2 + c * np.log(r / ri))
    size = float(max(field.comm.allgather(np.abs(exact).max())))
    np.testing.assert_allclose(field.pressure_values, exact, atol=0.02 * size)
    rate, rest = field.volume_rate(start.a), field.volume_bias(start.q, start.v)
    assert np.abs(rate + rest).max(initial=0.0) < 1e-10 * float(
        max(field.comm.allgather(np.abs(rest).max(initial=0.0)))
    )
    assert np.abs(field.volume_rate(start.v)).max(initial=0.0) < 1e-12


def swinging(mesh: Any, nu: float = 0.5) -> fmbd.Scene:
    """A soft rod that swings about a pin at its end without a vibration that steps do not resolve."""
    rod = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, angular_velocity=2.0, velocity=(0.0, 1.0),
                            energy=neo_hookean_incompressible(2e4, nu))  # fmt: skip
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground))
    return scene


def states(scene: fmbd.Scene, scheme: Any, n: int, until: int | None = None) -> list[tuple[Any, ...]]:
    """q, v, lambda and pressures of n steps to 40 ms (of the first ``until``); fields on the first rank, in an order that does
    not depend on how many there are; collective.
    """
    system, given, _ = scene.build()
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    stepper = scheme.stepper(system, solver, fmbd.Newton(1e-10, 25), start)
    (k, part), found = system.fields[0], []
    field: Any = part.field
    for i in range((until or n) + 1):
        s = stepper.state if i == 0 else stepper.advance(0.04 / n)
        q, v = (field.numbering.collect(x) for x in (system.local_q(s.q, k), system.local_v(s.v, k)))
        found.append((q, v, s.lam, field.pressure_numbering.collect(field.pressure_values)))
    return found


def test_pressure_converges_from_the_first_step_on(rod_mesh: Callable[..., Any]) -> None:
    """The pressure of a swinging rod, largest error of all steps: second order, so the start is that of the motion."""
    scene = swinging(rod_mesh(dim=2, h=0.5, height=0.3))

    def history(n: int) -> Any:
        return np.array([p for *_, p in states(scene, fmbd.GeneralizedAlpha(0.8), n)])

    fine = history(256)
    errors = [np.abs(history(n) - fine[:: 256 // n]).max() for n in (16, 32, 64)]
    assert np.log2(errors[1] / errors[2]) > 1.8, errors


@pytest.mark.parametrize(
    "scheme, n, expected",
    [
        (fmbd.Radau(stages=2, rtol=None), 8, (3, 2, 1, 1)),
        (fmbd.Radau(rtol=None, form=fmbd.forms.Index2()), 8, (5, 3, 2, 2)),
        (fmbd.BDF(order=3, rtol=None), 16, (3, 3, 3, 3)),
    ],
)
def test_stages_have_the_orders_of_index_3(
    rod_mesh: Callable[..., Any], scheme: Any, n: int, expected: tuple[int, ...]
) -> None:
    """Of q, v, lambda and the pressure, in every form of the joints: volumes are held on the level of positions."""
    scene = swinging(rod_mesh(dim=2, h=0.5, height=0.3))
    exact = states(scene, fmbd.Radau(stages=5, rtol=None), 20)[-1]
    coarse, fine = (states(scene, scheme, n)[-1] for n in (n, 2 * n))
    for k, order in enumerate(expected):
        errors = [np.abs(found[k] - exact[k]).max() for found in (coarse, fine)]
        assert np.log2(errors[0] / errors[1]) > order - 0.3, (k, errors)


@pytest.mark.mpi
@pytest.mark.parametrize("scheme", [fmbd.Radau(stages=2, rtol=None), fmbd.BDF(order=2, rtol=None)])
def test_stages_of_any_factor(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Iterations with real factors, those of several ranks, find the stages and pressures that complex ones of one rank do."""

    def found(comm: Any) -> tuple[Any, ...]:
        mesh = fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=2, h=0.5, height=0.3, comm=comm)
        return states(swinging(mesh), scheme, 10, until=2)[-1]

    usual = found(MPI.COMM_SELF)
    monkeypatch.setattr("fmbd_fenicsx.linear.frequency_solvers.SETTLED", np.inf)
    for values, same in zip(found(MPI.COMM_WORLD), usual, strict=True):
        if values is not None:  # they are collected on the first rank
            np.testing.assert_allclose(values, same, rtol=0, atol=1e-6 * np.abs(same).max())


def test_steps_of_stages_that_find_their_size(rod_mesh: Callable[..., Any]) -> None:
    """Under error control the pressure is that of small steps, and the volume stays."""
    scene = swinging(rod_mesh(dim=2, h=0.5, height=0.3))
    *_, exact = states(scene, fmbd.Radau(stages=5, rtol=None), 20)[-1]
    for scheme in (fmbd.Radau(rtol=1e-6), fmbd.BDF(rtol=1e-7)):
        run = fmbd.solve(scene, t_end=0.04, scheme=scheme, output=QUIET)
        field, _ = the_field(run)
        pressure = field.pressure_numbering.collect(field.pressure_values)
        assert np.abs(pressure - exact).max() < 2e-3 * np.abs(exact).max()
        assert volume_gap(run) < 1e-9


def test_stiffness_damping(rod_mesh: Callable[..., Any]) -> None:
    """Rayleigh damping leaves a spinning body alone, damps a swinging one, and leaves its volume alone."""
    energy = neo_hookean_incompressible(1e5)
    body = fmbd.AbsoluteBody("rod", rod_mesh(dim=2, h=0.25), density=DENSITY, energy=energy, stiffness_damping=0.05)
    part = the_part(body)
    turn, x = 0.7, part.field.X
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    spun = (x @ R.T - x).ravel(), (x @ R.T @ np.array([[0.0, 1.0], [-1.0, 0.0]])).ravel()
    assert np.abs(part._turned_stiffness(*spun)).max() < 1e-9 * np.abs(part.field.stiffness(x.ravel())).max()
    damped, free = (pendulum_of(body.with_(stiffness_damping=beta)) for beta in (0.05, 0.0))
    lost, kept = (float(sum(run.energy.values())[-1]) for run in (damped, free))
    assert lost < kept - 0.05 * free.energy["kinetic"].max()
    assert volume_gap(damped) < 1e-8


def the_part(body: Any) -> Any:
    scene = fmbd.Scene("one")
    scene.add(body)
    return scene.build()[0].fields[0][1]


def pendulum_of(body: Any) -> fmbd.Run:
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    return fmbd.solve(scene, t_end=0.2, dt=2.5e-3, output=QUIET)


def test_a_path_by_arc_length_is_refused() -> None:
    """It went on for minutes without a point: pressures that bodies carry do not move along a path."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.5), counts=(2, 1))
    pull = fmbd.traction("right", (1e4, 0.0), time=lambda t: t)
    block = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=neo_hookean_incompressible(E), loads=[pull])
    scene = fmbd.Scene("pulled")
    scene.add(block, fmbd.fixed("wall", block.surface("left"), fmbd.ground))
    scene.sensor("end", fmbd.position(block.surface("right")))
    with pytest.raises(InputError, match='"block" carries its pressure.*LoadSteps'):
        fmbd.equilibrium(scene, path=fmbd.ArcLength(1.0))
    assert fmbd.equilibrium(scene, path=fmbd.LoadSteps((0.5, 1.0)))["end"][0] > 1.0


def test_a_block_falls_from_level_to_hanging() -> None:
    """Pressures of an iteration that failed are given back: with them blocks stay singular, and 3 111 factors were made."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.2, 0.1), counts=(4, 1, 1))
    block = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=neo_hookean_incompressible(1e7))
    scene = fmbd.Scene("level", gravity=(0.0, 0.0, -9.81))
    scene.add(block, fmbd.revolute("pin", fmbd.ground, block.surface("left"), axis=(0, 1, 0)))
    scene.sensor("end", fmbd.position(block.surface("right")))
    found = fmbd.equilibrium(scene)
    assert found["end"][2] == pytest.approx(0.05 - 1.0, abs=2e-3)
    assert found.counters["factorisations"] < 150


@pytest.mark.parametrize(("nu", "near"), [(0.49, 1e-6), (0.5, 2e-3)])
def test_modes_have_the_pressure_of_the_state(nu: float, near: float) -> None:
    """A hanging block swings and bends as one whose pressure is eliminated, about an equilibrium and the end of a run.

    With the pressure of no state it swung with 0 in place of 0.609 Hz, and with one that does not answer to volumes it bent as a
    soft body that has none.
    """
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(0.1, 1.0), counts=(1, 6))
    laws = (neo_hookean_incompressible(1e7, nu), neo_hookean_mixed(1e7, min(nu, 0.4995)))
    found = []
    for law in laws:
        block = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=law)
        scene = fmbd.Scene("hanging", gravity=(0.0, -9.81))
        scene.add(block, fmbd.revolute("pin", fmbd.ground, block.surface("top")))
        rest = fmbd.equilibrium(scene)
        found.append(fmbd.modes(scene, 3, at=rest).frequencies)
        scene.settle = True
        run = fmbd.solve(scene, t_end=1e-3, dt=1e-3, output=QUIET)
        assert fmbd.modes(scene, 3, at=run).frequencies == pytest.approx(found[-1], rel=1e-5)
    assert found[0] == pytest.approx(found[1], rel=near)
    assert 0.6 < found[0][0] < 0.62


def test_a_linear_model_keeps_volumes() -> None:
    """The response to a force that pulls is that at nu = 0.4995, which differs little: motions that open volumes made it 1.15 to
    1.5 times as large.
    """
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.1), counts=(8, 1))
    found = []
    for law in (neo_hookean_incompressible(1e6), neo_hookean_mixed(1e6, 0.4995)):
        block = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=law)
        scene = fmbd.Scene("pushed")
        scene.add(block, fmbd.fixed("root", fmbd.ground, block.surface("left")))
        scene.add(fmbd.force("push", block.surface("right"), lambda t: (0.0, 0.0 * t)))
        scene.sensor("tip", fmbd.position(block.surface("right")))
        found.append(np.abs(fmbd.frequency_response(scene, ["push y"], ["tip y"], [1.0, 3.0, 5.0])).ravel())
    assert found[0] == pytest.approx(found[1], rel=5e-3)


def test_a_cantilever_carries_a_weight_on_a_hinge_that_hangs_on_a_spring() -> None:
    """The step's matrix leaves out how spring and reactions turn: its increments alone went on for minutes, and ended nowhere."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 0.2, 0.1), counts=(6, 1, 1))
    block = fmbd.AbsoluteBody("block", mesh, density=DENSITY, energy=neo_hookean_incompressible(1e6, 0.49))
    load = fmbd.RigidBody("load", 1.0, (0.01, 0.01, 0.01), position=(1.1, 0.1, 0.05))
    scene = fmbd.Scene("carried", gravity=(0.0, 1.0, -1.5))
    wall = fmbd.fixed("wall", fmbd.ground, block.surface("left"))
    hinge = fmbd.revolute("hinge", block.surface("right"), load, axis=(0, 1, 0), center=(1.0, 0.1, 0.05))
    spring = fmbd.Spring("spring", fmbd.ground, load, (1.1, 0.1, 0.6), (1.1, 0.1, 0.05), stiffness=300.0, length=0.55)
    scene.add(block, load, wall, hinge, spring)
    scene.sensor("wall", fmbd.reaction_force(wall))
    scene.sensor("load", fmbd.position(load))
    found = fmbd.equilibrium(scene)

    arm = found["load"] - np.array([1.1, 0.1, 0.6])
    length = np.linalg.norm(arm)
    pulls = 300.0 * (length - 0.55) * arm / length  # on the ground
    np.testing.assert_allclose(found["wall"] + pulls, 21.0 * np.array(scene.gravity), atol=1e-5)
    assert found.counters["newton_iterations"] < 120
