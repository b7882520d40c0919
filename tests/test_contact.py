"""Contact in scenes: exact solutions, energy, patch tests, friction, bad input, and what scenes without
contact leave out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError, InputError
from fmbd_fenicsx.schemes.impacts.contact_midpoint import weightless

ROOT = Path(__file__).resolve().parents[1]
BLOCK = ROOT / "meshes/block.py"


def strip(n: int, body: str = "AbsoluteBody", **more: Any) -> Any:
    """A bar of one row of cells that moves to the left with 0.1 m/s."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.1), counts=(n, 1), quads=True)
    elastic = fmbd.materials.linear_elastic(1.0, 0.0)
    return getattr(fmbd, body)("bar", mesh, degree=1, density=1.0, elastic=elastic, velocity=(-0.1, 0.0), **more)


def impact(bar: Any, scheme: Any = None, n: int = 50, t_end: float = 2.2, **more: Any) -> Any:
    wall = fmbd.contact("wall", bar.surface("left"), fmbd.Obstacle("wall", fmbd.HalfSpace((0, 0), (1, 0))), **more)
    scene = fmbd.Scene("bar impact")
    scene.add(bar, wall)
    scene.sensor("force", fmbd.contact_force(wall))
    scene.sensor("impulse", fmbd.contact_impulse(wall))
    scene.sensor("gap", fmbd.contact_gap(wall))
    scene.sensor("work", fmbd.contact_work())
    return fmbd.solve(scene, t_end=t_end, dt=0.5 / n, scheme=scheme)


def plateau(run: Any) -> float:
    """RMS of p / p_exact - 1 in (0.1, 1.9)."""
    t = run.times[1:] - run.dt / 2
    on = (t > 0.1) & (t < 1.9)
    return float(np.sqrt(np.mean((run["force"][1:, 0][on] / 0.01 - 1) ** 2)))


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("body", ["AbsoluteBody", "FloatingBody"])
def test_bar_impact(body: str) -> None:
    run = impact(strip(50, body))
    force, energy = run["force"][1:, 0], sum(run.energy.values())
    t = run.times[1:]
    assert plateau(run) < 0.05
    assert (force[(t > 0.1) & (t < 1.9)] > 0).all()
    assert abs(t[force > 1e-9].max() - 2.0) <= 2 * run.dt
    assert energy.max() <= energy[0] * (1 + 1e-8)
    momentum, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    assert momentum[0] / run.system.mass == pytest.approx(0.1, rel=0.02)
    assert run["impulse"][-1, 0] == pytest.approx(0.02, rel=0.02)
    assert run["gap"].min() > -1e-12
    assert run.counters["complementarity_residual"] < 1e-12
    assert run.counters["contact_newton_iterations"] <= 6 * run.counters["contact_steps"]


def test_plateau_falls_with_refinement() -> None:
    coarse, fine = (plateau(impact(strip(n), n=n)) for n in (25, 50))
    assert fine < 0.7 * coarse


def test_consistent_mass_oscillates(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        run = impact(strip(50), redistribute_mass=False)
    assert "oscillate" in caplog.text
    assert plateau(run) > 0.2  # what the redistribution is for
    energy = sum(run.energy.values())
    assert energy.max() <= energy[0] * (1 + 1e-8)


@pytest.mark.parametrize(("scheme", "friction", "most"), [(None, 0.0, 100), (fmbd.ContactAlpha(0.8), 0.3, 100)])
def test_steps_in_contact_ask_python_for_little(scheme: Any, friction: float, most: int) -> None:
    """Calls of Python's functions a step, that of the sensors left out."""
    bar = strip(10)
    wall = fmbd.contact("wall", bar.surface("left"), fmbd.HalfSpace((0, 0), (1, 0)), friction=friction)
    scene = fmbd.Scene("bar impact")
    scene.add(bar, wall)

    def calls(steps: int) -> int:
        output = fmbd.Output(every=steps, progress=False)
        return calls_of(lambda: fmbd.solve(scene, t_end=0.05 * steps, dt=0.05, scheme=scheme, output=output))

    calls(20)
    assert calls(20) - calls(10) < 10 * most


def test_increments_are_confirmed_where_something_bends() -> None:
    """Steps of linear bodies on planes are linear, as some of them show; those on a sphere never are."""
    shapes = {fmbd.HalfSpace((0, 0), (1, 0)): (1.0, 1.2), fmbd.Sphere(5.0, center=(-5.0, 0.05)): (2.0, 3.0)}
    for shape, (least, most) in shapes.items():
        bar, scene = strip(20), fmbd.Scene("bar impact")
        scene.add(bar, fmbd.contact("wall", bar.surface("left"), shape))
        run = fmbd.solve(scene, t_end=1.5, dt=0.025)
        steps = run.counters["contact_steps"]
        assert steps > 50 and least * steps <= run.counters["contact_newton_iterations"] <= most * steps


def test_contact_alpha_damps_and_touches_alike() -> None:
    run = impact(strip(50), scheme=fmbd.ContactAlpha(0.8))
    energy = sum(run.energy.values())
    assert plateau(run) < 0.05
    assert energy.max() <= energy[0] * (1 + 1e-8) and energy[-1] > 0.98 * energy[0]


@pytest.mark.parametrize("rho", [0.4, 0.8])
def test_impacts_that_steps_do_not_resolve_give_back_less_than_they_took(rho: float) -> None:
    """A block of steel stops in a hundredth of a step, and all that it does after that is the scheme's."""
    law = fmbd.materials.linear_elastic(2e11, 0.3)
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), counts=(8, 4), quads=True, origin=(-0.5, 0.0))
    body = fmbd.AbsoluteBody("block", mesh, degree=1, density=1e3, elastic=law, velocity=(0.3, -1.0))
    for share, friction in ((0.1, 0.3), (0.1, 0.05), (0.6, 0.3)):  # of a step before the impact
        plane = fmbd.HalfSpace((0, -share * 2.5e-4), (0, 1))
        floor = fmbd.contact("floor", body.surface("bottom"), plane, friction=friction)
        scene = fmbd.Scene("impact")
        scene.add(body, floor)
        scene.sensor("impulse", fmbd.contact_impulse(floor))
        run = fmbd.solve(scene, t_end=8e-3, dt=2.5e-4, scheme=fmbd.ContactAlpha(rho))
        energy, end = run.total_energy, run.system.at(run.state.t, run.state.q, run.state.v).momenta()[0]
        assert energy.max() == energy[0] and energy[-1] > 0.1 * energy[0]
        assert run["impulse"][-1] == pytest.approx(end - (150.0, -500.0), abs=1e-6)
        assert any("three steps or less" in text for text in run.warnings)


@pytest.mark.parametrize("scheme", [fmbd.ContactMidpoint(), fmbd.ContactAlpha(0.8)], ids=lambda s: s.name)
def test_what_bounces_as_it_slides_has_all_of_its_friction(scheme: Any) -> None:
    """Each impulse of a contact, also those that stop what approaches at the end of a step."""
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), counts=(8, 4), quads=True)
    law = fmbd.materials.linear_elastic(1e8, 0.3)
    body = fmbd.AbsoluteBody("block", mesh, degree=1, density=1e3, elastic=law, velocity=(2.0, -0.05))
    floor = fmbd.contact("floor", body.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1)), friction=0.3)
    scene = fmbd.Scene("slide", gravity=(0, -9.81))
    scene.add(body, floor)
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    along, across = fmbd.solve(scene, t_end=0.1, dt=1e-3, scheme=scheme)["impulse"][-1]
    assert across > 400 and along == pytest.approx(-0.3 * across, rel=1e-9)


def test_ledger_balances() -> None:
    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), cells=4)
    body = fmbd.AbsoluteBody("body", mesh, degree=1, density=2.0, elastic=fmbd.materials.linear_elastic(50.0, 0.2))
    floor = fmbd.contact(
        "floor",
        body.surface("bottom"),
        fmbd.Obstacle("floor", fmbd.HalfSpace((0, -0.01), (0, 1))),
        friction=0.2,
    )
    scene = fmbd.Scene("ledger", gravity=(0, -1.0))
    scene.add(body, floor, fmbd.force("push", body.surface("top"), lambda t: (0.5, -0.3)))
    scene.sensor("work", fmbd.contact_work())
    run = fmbd.solve(scene, t_end=0.5, dt=0.01)
    energy = sum(run.energy.values())
    contact, friction, loads, joints, numerical = run["work"][-1]
    assert contact < 0 and friction < 0 and loads != 0 and joints == 0
    assert abs(numerical) < 1e-12  # a linear body under the midpoint rule loses nothing
    assert energy[-1] - energy[0] == pytest.approx(contact + friction + loads, abs=1e-12)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("scheme", [fmbd.ContactMidpoint(), fmbd.ContactAlpha(0.8)])
def test_second_order_away_from_impacts(scheme: Any, closed: bool) -> None:
    """In free flight, and in a contact that stays closed under a load that grows smoothly."""

    def far_end(dt: float) -> float:
        made = strip(8).__dict__
        if closed:
            made = {**made, "velocity": (0.0, 0.0)}
        else:
            made = {**made, "displacement": lambda x: np.stack((0.01 * x[0] ** 2, 0 * x[0]))}
        bar = fmbd.AbsoluteBody(**made)
        wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0.0 if closed else -1.0, 0), (1, 0)))
        scene = fmbd.Scene("bar")
        scene.add(bar, fmbd.contact("wall", bar.surface("left"), wall, search=0.1 if closed else None))
        if closed:
            scene.add(fmbd.force("press", bar.surface("right"), lambda t: (-0.01 * np.sin(t) ** 2, 0.0)))
        scene.sensor("x", fmbd.position(bar.surface("right")))
        run = fmbd.solve(scene, t_end=0.8 if not closed else 1.6, dt=dt, scheme=scheme)
        closed_steps = run.counters["contact_steps"] / run.counters["steps"]
        assert closed_steps > 0.4 if closed else closed_steps == 0.0
        return float(run["x"][-1, 0])

    x = [far_end(0.8 / n) for n in (32, 64, 128)]
    assert np.log2(abs((x[0] - x[1]) / (x[1] - x[2]))) > 1.9


@pytest.mark.parametrize("body", ["AbsoluteBody", "FloatingBody"])
def test_velocities_of_nodes_without_inertia(body: str) -> None:
    """Of second order in flight, and like those of the body behind many impacts: no balance holds them at the ends of steps."""

    def block(height: float, **more: Any) -> Any:
        mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 0.5), counts=(8, 4), quads=True, origin=(-0.5, height))
        return getattr(fmbd, body)("block", mesh, degree=1, density=1000.0, **more)

    def end(scene: fmbd.Scene, made: Any, t_end: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        scene.add(fmbd.contact("floor", made.surface("bottom"), fmbd.HalfSpace((0, 0), (0, 1)), friction=0.3))
        run = fmbd.solve(scene, t_end=t_end, dt=dt, output=fmbd.Output(every=10**6))
        return run.state.v, weightless(run.system)

    def flight(dt: float) -> np.ndarray:
        made = block(1.0, elastic=fmbd.materials.linear_elastic(1e3, 0.3), velocity=(0.1, 0.2), angular_velocity=0.05)
        scene = fmbd.Scene("flight")
        push = fmbd.force("push", made.surface("top"), lambda t: (10 * np.sin(3 * t) ** 3, 20 * np.sin(2 * t) ** 3))
        scene.add(made, push)
        v, massless = end(scene, made, 1.6, dt)
        return v[massless]

    v = [flight(1.6 / n) for n in (32, 64, 128)]
    assert np.log2(np.abs(v[0] - v[1]).max() / np.abs(v[1] - v[2]).max()) > 1.9

    made = block(0.01, elastic=fmbd.materials.linear_elastic(1e7, 0.3), velocity=(1.0, -1.0))
    scene = fmbd.Scene("drop", gravity=(0, -9.81))
    scene.add(made)
    assert np.abs(end(scene, made, 0.25, 1e-3)[0]).max() < 10.0


# -- two bodies ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("kind", "scheme"), [("rigid", fmbd.ContactAlpha(0.8)), ("elastic", fmbd.ContactMidpoint())])
def test_a_block_slides_on_a_body_that_it_drags_along(kind: str, scheme: Any) -> None:
    """125 kg at 1 m/s on 1000 kg at rest that may slide: u = 1 - mu g t and w = mu g t / 8 by Coulomb, equal at 0.302 s."""
    law, mu, g = fmbd.materials.linear_elastic(1e7, 0.3), 0.3, 9.81

    def block(
        name: str, size: tuple[float, float], counts: tuple[int, int], at: tuple[float, float], speed: float
    ) -> Any:
        mesh = fmbd.read_gmsh(BLOCK, size=size, counts=counts, quads=True, origin=at)
        return fmbd.AbsoluteBody(name, mesh, degree=1, density=1e3, elastic=law, velocity=(speed, 0.0))

    scene = fmbd.Scene("drag", gravity=(0, -g))
    upper = block("upper", (0.5, 0.25), (6, 3), (-0.25, 0.0), 1.0)
    if kind == "elastic":
        lower = block("lower", (4.0, 0.25), (20, 2), (-1.0, -0.25), 0.0)
        scene.add(lower, fmbd.contact("floor", lower.surface("bottom"), fmbd.HalfSpace((0, -0.25), (0, 1))))
        master, back = lower.surface("top"), lower.surface("left")
    else:
        back = cart = fmbd.RigidBody("cart", 1e3, 100.0)
        scene.add(cart, fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0)))
        master = fmbd.Obstacle("top", fmbd.HalfSpace((0, 0), (0, 1)), on=cart)
    rub = fmbd.contact("rub", upper.surface("bottom"), master, friction=mu)
    scene.add(upper, rub)
    scene.sensor("impulse", fmbd.contact_impulse(rub))
    for name, place in (("upper", upper.surface("top")), ("lower", back)):
        scene.sensor(name, fmbd.position(place))
    run = fmbd.solve(scene, t_end=0.36, dt=2e-3, scheme=scheme)

    t, (along, up) = 1 / (mu * g * 1.125), run["impulse"].T
    momentum = run.system.at(run.state.t, run.state.q, run.state.v).momenta()[0]
    assert momentum[0] == pytest.approx(125.0, rel=1e-9)
    assert along[-1] == pytest.approx(-125.0 * mu * g * t, rel=1e-2) and up[-1] == pytest.approx(
        125.0 * g * 0.36, rel=1e-2
    )
    if kind == "rigid":  # the plane stays as it is
        assert (np.abs(np.diff(along)) <= mu * np.diff(up) * (1 + 1e-9) + 1e-9).all()
    slip = (run["upper"] - run["lower"])[:, 0]
    assert slip[-1] - slip[0] == pytest.approx(0.5 * t, rel=1e-2)
    assert run.total_energy[-1] - run.total_energy[0] == pytest.approx(-62.5 / 1.125, rel=2e-2)


def patch(dim: int, cells: tuple[int, int], degree: int = 1) -> np.ndarray:
    """Pressure between two blocks with different meshes under a uniform pressure of 10."""
    return pressed(dim, cells, degree)["pressure"][-1]


def pressed(dim: int, cells: tuple[int, int], degree: int = 1) -> Any:
    """The run of :func:`patch`; the upper block is given as slave."""
    size, lift = ((1.0, 0.5), (0.0, 0.5)) if dim == 2 else ((1.0, 1.0, 0.5), (0.0, 0.0, 0.5))
    low_name, high_name = ("bottom", "top") if dim == 2 else ("back", "front")
    up = np.eye(dim)[-1]
    bodies = []
    for name, n, origin in (("low", cells[0], (0.0,) * dim), ("high", cells[1], lift)):
        mesh = fmbd.read_gmsh(BLOCK, size=size, cells=n, origin=origin)
        bodies.append(
            fmbd.AbsoluteBody(
                name, mesh, degree=degree, density=1.0, elastic=fmbd.materials.linear_elastic(1000.0, 0.3)
            )
        )
    low, high = bodies
    scene = fmbd.Scene("patch")
    pair = fmbd.contact("pair", high.surface(low_name), low.surface(high_name))
    scene.add(low, high, pair, fmbd.force("press", high.surface(high_name), lambda t: -10.0 * up))
    scene.add(fmbd.fixed("base", fmbd.ground, low.surface(low_name)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, high.surface(high_name), axis=up))
    scene.sensor("pressure", fmbd.contact_pressure(pair))
    scene.sensor("force", fmbd.contact_force(pair))
    scene.sensor("impulse", fmbd.contact_impulse(pair))
    return fmbd.solve(scene, t_end=6.0, dt=0.5, scheme=fmbd.ContactMidpoint(theta=1.0))


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("cells", [(6, 6), (4, 7), (7, 5)])
def test_patch_in_the_plane(cells: tuple[int, int]) -> None:
    assert patch(2, cells) == pytest.approx(10.0, rel=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_patch_in_space(degree: int) -> None:
    pressure = patch(3, (2, 3), degree)
    assert len(pressure) == 16  # a multiplier for each vertex of the finer side
    assert pressure == pytest.approx(10.0, rel=1e-10)


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
def test_blocks_that_hit_without_friction_do_not_sink_into_each_other(dt: float) -> None:
    """Nodes without inertia alternate from step to step: paired as they do, surfaces come through each other, the more steps the
    deeper."""
    law: dict[str, Any] = {"density": 1e3, "elastic": fmbd.materials.linear_elastic(1e5, 0.3)}
    mesh = fmbd.read_gmsh(BLOCK, size=(0.5, 0.4, 0.4), counts=(2, 3, 3), quads=True, origin=(-0.5, -0.1, 0.0))
    other = fmbd.read_gmsh(BLOCK, size=(0.4, 0.6, 0.5), counts=(2, 4, 4), quads=True, origin=(0.0, -0.2, -0.1))
    flying = fmbd.AbsoluteBody("flying", mesh, velocity=(1.0, 0.3, 0.2), **law)
    resting = fmbd.AbsoluteBody("resting", other, **law)
    pair = fmbd.contact("pair", flying.surface("right"), resting.surface("left"))
    scene = fmbd.Scene("frictionless")
    scene.add(flying, resting, pair)
    scene.sensor("gap", fmbd.contact_gap(pair))
    run = fmbd.solve(scene, t_end=0.1, dt=dt, scheme=fmbd.ContactMidpoint())
    assert run["gap"].min() > -2e-3


def test_finer_side_becomes_the_slave() -> None:
    assert len(patch(2, (7, 4))) == 8


@pytest.mark.parametrize("cells", [(4, 7), (7, 4)])
def test_forces_are_those_on_the_slave_that_was_given(cells: tuple[int, int]) -> None:
    """Whichever side has the smaller facets, the lower block pushes the upper one up."""
    run = pressed(2, cells)
    assert run["force"][-1] == pytest.approx((0.0, 10.0), rel=1e-9, abs=1e-9)
    assert run["impulse"][-1, 1] > 0.0


# -- obstacles that move -------------------------------------------------------------------------------------
def test_reaction_on_the_body_that_carries_the_obstacle() -> None:
    plate = fmbd.RigidBody("plate", 0.05, 0.01, position=(-0.05, 0.05))
    bar = strip(20)
    pair = fmbd.contact("pair", bar.surface("left"), fmbd.Obstacle("plate", fmbd.Box((0.1, 0.5)), on=plate))
    scene = fmbd.Scene("bar against plate")
    scene.add(bar, plate, pair)
    run = fmbd.solve(scene, t_end=1.5, dt=0.02)
    p, L = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    assert p[0] == pytest.approx(-0.01, rel=1e-9)  # the bar's momentum at the start
    assert run.state.v[0] < -0.05  # the plate moves
    assert L == pytest.approx(0.05 * 0.01, abs=1e-9)


def test_prescribed_obstacle_pushes() -> None:
    bar = strip(20).__class__(**{**strip(20).__dict__, "velocity": (0.0, 0.0)})
    obstacle = fmbd.Obstacle("ram", fmbd.HalfSpace((0, 0), (1, 0)), motion=lambda t: ((0.1 * t, 0.0), 0.0))
    pair = fmbd.contact("ram", bar.surface("left"), obstacle)
    scene = fmbd.Scene("ram")
    scene.add(bar, pair)
    scene.sensor("force", fmbd.contact_force(pair))
    run = fmbd.solve(scene, t_end=1.0, dt=0.025)
    force = run["force"][run.times > 0.3, 0] / 0.1
    assert force.mean() == pytest.approx(0.1, rel=0.03)  # rho c v


def test_nonlinear_body_bounces() -> None:
    from ufl import Identity, det, grad, inner, ln

    mu, lmbda = fmbd.materials.lame(50.0, 0.3)

    def neo_hookean(u: Any, dx: Any) -> Any:
        F = Identity(2) + grad(u)
        J = det(F)
        return (mu / 2 * (inner(F, F) - 2 - 2 * ln(J)) + lmbda / 2 * (J - 1) ** 2) * dx

    mesh = fmbd.read_gmsh(BLOCK, size=(1.0, 1.0), cells=4, origin=(0.0, 0.05))
    body = fmbd.AbsoluteBody(
        "block", mesh, degree=1, density=1.0, energy=neo_hookean, velocity=(0.0, -0.5), angular_velocity=0.3
    )
    floor = fmbd.contact("floor", body.surface("bottom"), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))))
    scene = fmbd.Scene("nonlinear")
    scene.add(body, floor)
    scene.sensor("gap", fmbd.contact_gap(floor))
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    run = fmbd.solve(scene, t_end=0.6, dt=0.01)
    energy = sum(run.energy.values())
    assert run["gap"].min() > -1e-9 and run["impulse"][-1, 1] > 0.5
    assert abs(energy[-1] / energy[0] - 1) < 0.05


# -- bad input -----------------------------------------------------------------------------------------------
def floor_at(y: float) -> Any:
    return fmbd.Obstacle("floor", fmbd.HalfSpace((0, y), (0, 1)))


def test_initial_penetration_names_pair_and_depth() -> None:
    bar = strip(4)
    scene = fmbd.Scene("overlap")
    scene.add(bar, fmbd.contact("to floor", bar.surface("bottom"), floor_at(0.02)))
    with pytest.raises(InputError, match=r'"to floor".*overlap.*0\.02 m'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_same_facets_are_refused() -> None:
    bar = strip(4)
    with pytest.raises(InputError, match="same facets"):
        fmbd.contact("self", bar.surface("left"), bar.surface("left"))


def test_rigid_contact_needs_an_impact_law() -> None:
    ball = fmbd.RigidBody("ball", 1.0, 1.0, position=(0, 1))
    scene = fmbd.Scene("ball")
    scene.add(ball, fmbd.contact("c", fmbd.ball(ball, 0.1), floor_at(0.0)))
    with pytest.raises(InputError, match="Moreau"):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.schemes.ContactMidpoint())


def test_schemes_without_contact_refuse_it() -> None:
    bar = strip(4)
    scene = fmbd.Scene("bar")
    scene.add(bar, fmbd.contact("c", bar.surface("left"), fmbd.Obstacle("w", fmbd.HalfSpace((-1, 0), (1, 0)))))
    with pytest.raises(InputError, match="does not treat contact"):
        fmbd.solve(scene, t_end=0.1, dt=0.01, scheme=fmbd.GeneralizedAlpha())


def test_tunnelling_is_refused_with_a_safe_step() -> None:
    bullet = fmbd.RigidBody("bullet", 1.0, 1.0, position=(-1.0, 0.0), velocity=(100.0, 0.0))

    def shot(dt: float) -> Any:
        scene = fmbd.Scene("shot")
        plate = fmbd.Obstacle("plate", fmbd.Box((0.1, 1.0)))
        scene.add(bullet, fmbd.contact("plate", fmbd.corners(bullet, [(0.0, 0.0)]), plate))
        return fmbd.solve(scene, t_end=0.1, dt=dt, scheme=fmbd.Moreau())

    with pytest.raises(ConvergenceError, match=r"could pass through. Use dt <= 0\.0005 s"):
        shot(0.1)
    assert shot(0.0005).state.q[0] < 0.05
    parts = shot(0.01)
    assert parts.counters["halved_steps"] > 0 and parts.state.q[0] < 0.05


def test_level_function_that_is_no_distance_is_normalised(caplog: pytest.LogCaptureFixture) -> None:
    shape = fmbd.SignedDistance(lambda x: 5.0 * (x[1] - 0.5))
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        d, n = shape.evaluate(np.array([[0.0, 2.5]]))
    assert d == pytest.approx([2.0]) and n == pytest.approx(np.array([[0.0, 1.0]]))
    assert "gradient" in caplog.text


# -- what is left out ----------------------------------------------------------------------------------------
@pytest.mark.serial
def test_scene_without_contact_loads_nothing_of_it() -> None:
    code = f"""
import sys
import fmbd_fenicsx as fmbd
mesh = fmbd.read_gmsh({str(BLOCK)!r}, size=(1.0, 0.1), cells=4)
bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.0))
scene = fmbd.Scene("bar")
scene.add(bar)
run = fmbd.solve(scene, t_end=0.02, dt=0.01)
assert run.system.contacts is None
assert "contact" in run.plan.left_out and not any("contact" in n for n, _ in run.plan.unknowns)
found = [m for m in sys.modules if m.startswith("fmbd_fenicsx") and ("contact" in m or "moreau" in m or "complementarity" in m)]
assert not found, found
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert done.returncode == 0, done.stderr


def test_plan_lists_contact() -> None:
    bar = strip(4)
    run = impact(bar, n=4, t_end=0.25)
    assert ('contact "wall"', 2) in run.plan.unknowns and "friction" in run.plan.left_out


@pytest.mark.parametrize("scheme", [fmbd.schemes.ContactMidpoint(), fmbd.schemes.ContactAlpha()], ids=lambda s: s.name)
def test_places_of_a_contact_surface_between_steps(scheme: Any) -> None:
    """Near the straight lines between the ends of steps, also where nodes without inertia go to and fro."""
    wall = fmbd.Obstacle("wall", fmbd.HalfSpace((0, 0), (1, 0)))

    def left(**settings: Any) -> fmbd.Run:
        bar, scene = strip(20), fmbd.Scene("bar impact")
        scene.add(bar, fmbd.contact("wall", bar.surface("left"), wall))
        scene.sensor("left", fmbd.position(bar.surface("left")))
        return fmbd.solve(scene, t_end=3.0, dt=0.01, scheme=scheme, **settings)

    ends, times = left(), np.sort(np.random.default_rng(3).uniform(0.1, 3.0, 200))
    lines = np.interp(times, ends.times, ends["left"][:, 0])
    found = left(output=fmbd.Output(times=tuple(times)))["left"][:, 0]
    print(np.abs(found - lines).max(), np.abs(np.diff(ends["left"][:, 0])).max())
    assert np.abs(found - lines).max() < 0.2 * np.abs(np.diff(ends["left"][:, 0])).max()


def test_contact_sensors_at_given_times() -> None:
    """Between the ends of a step the contact force is that of the step: it was refused there."""
    bar = strip(20)
    wall = fmbd.contact("wall", bar.surface("left"), fmbd.Obstacle("wall", fmbd.HalfSpace((0, 0), (1, 0))))
    scene = fmbd.Scene("bar impact")
    scene.add(bar, wall)
    scene.sensor("force", fmbd.contact_force(wall))
    whole = fmbd.solve(scene, t_end=0.5, dt=0.025)
    some = fmbd.solve(scene, t_end=0.5, dt=0.025, output=fmbd.Output(times=(0.11, 0.31, 0.5)))
    np.testing.assert_allclose(some["force"], whole["force"][[5, 13, 20]], rtol=1e-9)
