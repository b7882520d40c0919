"""Rigid contact in scenes: impacts, their accumulation, friction, and contacts that depend on each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.schemes.impacts.compiled import driver


def bouncing(dt: float | None, scheme: Any, t_end: float = 1.5, **more: Any) -> Any:
    """A ball with e = 1/2 dropped from 1 m."""
    ball = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 1.1))
    floor = fmbd.contact(
        "floor", fmbd.ball(ball, 0.1), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))), restitution=0.5
    )
    scene = fmbd.Scene("Zeno", gravity=(0, -9.81))
    scene.add(ball, floor)
    scene.sensor("x", fmbd.position(ball))
    scene.sensor("v", fmbd.velocity(ball))
    scene.sensor("force", fmbd.contact_force(floor))
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=scheme, **more)


def height(t: Any) -> Any:
    """Of its centre, in closed form: parabolas from one impact to the next."""
    flight = np.sqrt(2 / 9.81)
    ends, speed, y = flight, 9.81 * flight, 1.0 - 9.81 / 2 * t**2
    while flight > 1e-15:
        speed, flight = 0.5 * speed, speed / 9.81
        y = np.where(t >= ends, np.maximum(speed * (t - ends) - 9.81 / 2 * (t - ends) ** 2, 0.0), y)
        ends += flight
    return 0.1 + y


@pytest.mark.parametrize("dt", [1.5e-2, 7e-3, 3e-4])
def test_what_early_rest_leaves_out_is_stated(dt: float) -> None:
    """Runs with 2 h and 4 h leave out the same at the instants that they share; at small steps these are slow touches."""
    run = bouncing(dt, fmbd.Moreau(), output=fmbd.Output(estimate_error=True, progress=False))
    error = np.abs(run["x"][:, 1] - height(run.times)).max()
    assert error > 1e-8
    assert 0.5 < run.certificate["x"].total / error < 5.0


@pytest.mark.parametrize(("scheme", "largest"), [(None, 1e-8), (fmbd.Moreau(), 1e-6)])
def test_a_tolerance_is_kept_where_rebounds_end(scheme: Any, largest: float) -> None:
    """By all of them where nobody chose, else by smaller steps."""
    run = bouncing(None, scheme, tol={"x": 1e-6}, output=fmbd.Output(progress=False))
    assert np.abs(run["x"][:, 1] - height(run.times)).max() < largest


@pytest.mark.parametrize("dt", [1e-2, 1e-3])
def test_bouncing_ball_comes_to_rest_within_a_step(dt: float) -> None:
    """Infinitely many impacts end at sqrt(2 h / g) (1 + e) / (1 - e) = 1.35457 s."""
    run = bouncing(dt, fmbd.Moreau())
    rest = run.times[np.flatnonzero(np.abs(run["v"][:, 1]) > 1e-9)[-1] + 1]
    assert abs(rest - 3 * np.sqrt(2 / 9.81)) <= dt
    assert run["force"][-1, 1] == pytest.approx(9.81)
    assert run.counters["impacts"] >= 8
    energy = sum(run.energy.values())
    assert np.diff(energy).max() <= 1e-12 * energy[0]
    assert run["force"][1:, 1].sum() * dt == pytest.approx(run["impulse"][-1, 1], rel=1e-9)


def test_flights_between_impacts_are_exact() -> None:
    """Impacts happen at their own times; a parabola is exact for the midpoint rule, whatever the step."""
    run = bouncing(0.013, fmbd.Moreau(), 1.2)
    start, speed, late = 0.0, np.sqrt(2 * 9.81), run.times[-1]
    ends = np.sqrt(2 / 9.81) * np.array([1.0, 2.0, 2.5, 2.75])  # impacts
    k = int(np.searchsorted(ends, late)) - 1
    start, speed = ends[k], np.sqrt(2 * 9.81) * 0.5 ** (k + 1)
    t = late - start
    assert run["x"][-1, 1] == pytest.approx(0.1 + speed * t - 9.81 / 2 * t * t, abs=1e-6)
    classical = bouncing(0.013, fmbd.Moreau(impacts=0), 1.2)
    assert abs(classical["x"][-1, 1] - run["x"][-1, 1]) > 1e-4  # all impacts of a step as one: half a step late


@pytest.mark.parametrize("dt", [0.1, 0.02, 0.01])
@pytest.mark.parametrize("push", [0.01, 3.0])
def test_free_ball_keeps_its_restitution_under_a_force_in_time(dt: float, push: float) -> None:
    """The flight to the touch is not the parabola of the whole step: it ends at the touch all the same, and bounces there."""
    scene = fmbd.Scene("pushed ball", gravity=(0, -9.81))
    ball = fmbd.RigidBody("ball", 1.0, 0.1, position=(0.0, 1.1))
    floor = fmbd.contact(
        "floor", fmbd.ball(ball, 0.1), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))), restitution=1.0
    )
    w = 20.0
    scene.add(ball, floor, fmbd.force("push", ball, lambda t: (0.0, push * np.sin(w * t))))
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    run = fmbd.solve(scene, t_end=3.0, dt=dt, scheme=fmbd.Moreau())

    # x'' = -g + f sin(w t) from one impact to the next
    t, x, v, impulse = 0.0, 1.0, 0.0, 0.0
    impacts = 0
    while True:
        rest = v + push / w * np.cos(w * t)
        begin = x + push / w**2 * np.sin(w * t)
        ahead = np.linspace(1e-3, 3.0, 30001)
        s = t + ahead
        gap = begin + rest * ahead - 9.81 / 2 * ahead**2 - push / w**2 * np.sin(w * s)
        below = np.flatnonzero(gap < 0)[0]
        hit = ahead[below - 1] + 1e-4 * gap[below - 1] / (gap[below - 1] - gap[below])
        if t + hit > 3.0:
            break
        t, x = t + hit, 0.0
        v = 9.81 * hit + push / w * np.cos(w * t) - rest
        impulse, impacts = impulse + 2 * v, impacts + 1
    assert run.counters["impacts"] == impacts
    assert run["impulse"][-1, 1] == pytest.approx(impulse, rel=1e-6 + 0.5 * push * dt**2)


def plate(dim: int, friction: float, restitution: float) -> Any:
    """A plate dropped obliquely onto its four corners (plane: three collinear points)."""
    if dim == 3:
        body = fmbd.RigidBody(
            "plate", 1.0, (0.0842, 0.0842, 0.1667), position=(0, 0, 0.2), velocity=(0.5, 0.2, 0),
            angular_velocity=(0.3, 0.7, 1.0),
        )  # fmt: skip
        points = [(x, y, -0.05) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    else:
        body = fmbd.RigidBody("plate", 1.0, 0.0842, position=(0, 0.2), velocity=(0.5, 0), angular_velocity=0.3)
        points = [(x, -0.05) for x in (-0.5, 0.0, 0.5)]
    up = np.eye(dim)[-1]
    floor = fmbd.contact(
        "floor", fmbd.corners(body, points), fmbd.Obstacle("floor", fmbd.HalfSpace(np.zeros(dim), up)),
        friction=friction, restitution=restitution,
    )  # fmt: skip
    scene = fmbd.Scene("plate", gravity=tuple(-9.81 * up))
    scene.add(body, floor)
    scene.sensor("force", fmbd.contact_force(floor))
    scene.sensor("gap", fmbd.contact_gap(floor))
    return fmbd.solve(scene, t_end=1.0, dt=4e-3, scheme=fmbd.Moreau())


@pytest.mark.parametrize(
    ("dim", "friction", "restitution"), [(2, 0.3, 0.4), (2, 1.0, 0.4), (3, 0.3, 0.4), (3, 1.0, 0.0)]
)
def test_plate_rattles_to_rest_on_redundant_corners(dim: int, friction: float, restitution: float) -> None:
    run = plate(dim, friction, restitution)
    assert np.abs(run.state.v).max() < 1e-9
    assert run["force"][-1] == pytest.approx(9.81 * np.eye(dim)[-1], abs=1e-8)
    assert run["gap"].min() > -2e-3
    energy = sum(run.energy.values())
    assert np.diff(energy).max() <= 1e-4 * energy[0]
    assert run.counters["complementarity_residual"] <= 1e-12


@pytest.mark.parametrize("points", [1, 2])
@pytest.mark.parametrize("restitution", [0.9, 1.0])
def test_impact_whose_friction_turns_the_slip_about_adds_no_energy(restitution: float, points: int) -> None:
    """A rod that hits a floor with its tip, and sticks: by Newton's law it would leave with up to 10 % more energy.

    The tip's impulse P is that of U_1 = (0, -s e U_0n) by the compliance W of the tip, and P . (U_0 + U_1) = 0 tells s. How many
    ``points`` in the same place share it does not matter.
    """
    angle, v = np.pi / 4, np.array([1.0, -3.0])
    rod = fmbd.RigidBody("rod", 1.0, 1 / 12, (0.0, 0.6), angle, velocity=tuple(v))
    ground = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
    tips = fmbd.corners(rod, [(-0.5, 0.0), (0.5, 0.0)] * points)
    pair = fmbd.contact("floor", tips, ground, friction=0.8, restitution=restitution)
    scene = fmbd.Scene("rod")
    scene.add(rod, pair)
    scene.sensor("v", fmbd.velocity(rod))
    scene.sensor("work", fmbd.contact_work())
    run = fmbd.solve(scene, t_end=0.09, dt=3e-3, scheme=fmbd.Moreau())
    assert run.counters["impacts"] == points

    arm = 0.5 * np.array([np.sin(angle), -np.cos(angle)])  # of the turn: speed of the tip for a unit angular velocity
    W = np.eye(2) + 12.0 * np.outer(arm, arm)

    def impulse(share: float) -> Any:
        return np.linalg.solve(W, np.array([0.0, -share * restitution * v[1]]) - v)

    lower, upper = 0.0, 1.0
    for _ in range(60):
        share = 0.5 * (lower + upper)
        gained = impulse(share) @ (v + np.array([0.0, -share * restitution * v[1]])) > 0.0
        lower, upper = (lower, share) if gained else (share, upper)
    assert 0.5 < lower < 0.95
    found = impulse(lower)
    assert abs(found[0]) < 0.8 * found[1]
    assert run["v"][-1] == pytest.approx(v + found, abs=1e-6)
    energy = sum(run.energy.values())
    assert np.abs(energy - energy[0]).max() <= 1e-7 * energy[0]


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_corners_that_hit_at_nearly_one_time_stay_above_the_floor(size: float) -> None:
    """A plate that falls nearly flat, one corner right after the other: the second is not closed at its speed, for the rest of
    a step, far below the floor.
    """
    for angle in np.logspace(-7, -2, 11):
        body = fmbd.RigidBody("plate", 1.0, 0.02 * size**2, (0.0, 0.3 * size), float(angle), (0.3 * size, -8.0 * size))
        corners = fmbd.corners(body, [(x * size, -0.05 * size) for x in (-0.5, 0.5)])
        floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1)))
        pair = fmbd.contact("floor", corners, floor, friction=0.3, restitution=0.7)
        scene = fmbd.Scene("plate", gravity=(0.0, -9.81 * size))
        scene.add(body, pair)
        scene.sensor("gap", fmbd.contact_gap(pair))
        run = fmbd.solve(scene, t_end=0.5, dt=5e-3, scheme=fmbd.Moreau())
        assert run["gap"].min() > -1e-4 * size


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_rod_in_the_range_of_painleve_takes_the_impact(dt: float) -> None:
    """mu > 4/3: a rod that slides tip first admits no finite force; an impulse stops the tip, whatever the step."""
    theta = 1.0
    rod = fmbd.RigidBody(
        "rod", 1.0, 1.0 / 3, position=(np.cos(theta), np.sin(theta)), rotation=theta, velocity=(-2.0, 0.0)
    )
    tip = fmbd.corners(rod, [(-1.0, 0.0)])
    floor = fmbd.contact("floor", tip, fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))), friction=2.0)
    scene = fmbd.Scene("rod", gravity=(0, -9.81))
    scene.add(rod, floor)
    scene.sensor("impulse", fmbd.contact_impulse(floor))
    run = fmbd.solve(scene, t_end=3 * dt, dt=dt, scheme=fmbd.Moreau())
    # the impulse P = (N, T) at the tip that stops it: W P = (0, 2)
    c, s = np.cos(theta), np.sin(theta)
    W = np.array([[1 + 3 * c * c, -3 * s * c], [-3 * s * c, 1 + 3 * s * s]])
    normal, tangential = np.linalg.solve(W, [0.0, 2.0])
    assert run["impulse"][-1] == pytest.approx([tangential, normal], rel=60 * dt)


def test_elastic_and_plastic_impact_of_two_balls() -> None:
    for e in (1.0, 0.3, 0.0):
        a = fmbd.RigidBody("a", 2.0, (0.1, 0.1, 0.1), velocity=(1.0, 0.0, 0.0))
        b = fmbd.RigidBody("b", 1.0, (0.1, 0.1, 0.1), position=(1.0, 0.0, 0.0))
        scene = fmbd.Scene("two balls")
        scene.add(
            a,
            b,
            fmbd.contact("pair", fmbd.ball(a, 0.2), fmbd.Obstacle("b", fmbd.Sphere(0.2), on=b), restitution=e),
        )
        run = fmbd.solve(scene, t_end=1.0, dt=0.01, scheme=fmbd.Moreau())
        assert run.state.v[[0, 6]] == pytest.approx([(2 - e) / 3, 2 * (1 + e) / 3], abs=1e-9)


def test_disk_rolls_after_sliding() -> None:
    """Coulomb friction turns 2/3 of the speed of a disk into rolling."""
    disk = fmbd.RigidBody("disk", 1.0, 0.5 * 0.1**2, position=(0, 0.1), velocity=(1.0, 0.0))
    floor = fmbd.contact(
        "floor", fmbd.ball(disk, 0.1), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))), friction=0.3
    )
    scene = fmbd.Scene("disk", gravity=(0, -9.81))
    scene.add(disk, floor)
    run = fmbd.solve(scene, t_end=0.3, dt=1e-3, scheme=fmbd.Moreau())
    v, _, w = run.state.v
    assert v == pytest.approx(2 / 3, rel=2e-3)
    assert w == pytest.approx(-v / 0.1, rel=1e-6)


def test_cylinder_stands_on_its_end_in_space() -> None:
    can = fmbd.RigidBody("can", 1.0, (0.01, 0.01, 0.005), position=(0, 0, 0.12))
    end = fmbd.cylinder_end(can, 0.05, center=(0, 0, -0.1), axis=(0, 0, 1))
    floor = fmbd.contact("floor", end, fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0, 0), (0, 0, 1))), friction=0.5)
    scene = fmbd.Scene("can", gravity=(0, 0, -9.81))
    scene.add(can, floor)
    scene.sensor("force", fmbd.contact_force(floor))
    run = fmbd.solve(scene, t_end=0.2, dt=2e-3, scheme=fmbd.Moreau())
    assert run["force"][-1] == pytest.approx([0, 0, 9.81], abs=1e-8)
    assert run.state.q[2] == pytest.approx(0.1, abs=2e-3)
    assert np.abs(run.state.v).max() < 1e-9


def swinging(where: str, dt: float) -> tuple[float, float]:
    """Largest change of the energy, and range of the kinetic one.

    A pendulum over a floor far below, a ball in a smooth bowl, half a disc that rocks without slip, whose lever turns in a step.
    """
    friction, radius, center = 0.0, 0.1, (0.0, 0.0)
    scene = fmbd.Scene(where, gravity=(0, -9.81))
    if where == "pendulum":
        body = fmbd.RigidBody("body", 1.0, 0.05, (1.0, 0.0))
        shape: Any = fmbd.HalfSpace((0, -100), (0, 1))
        scene.add(fmbd.revolute("hinge", fmbd.ground, body, center=(0, 0)))
    elif where == "bowl":
        body, shape = fmbd.RigidBody("body", 1.0, 0.004, (0.9, 0.0)), fmbd.Sphere(1.0, inside=True)
    else:
        friction, radius, center, angle = 2.0, 1.0, (0.0, 0.5), 0.5
        place = (0.5 * np.sin(angle), 1.0 - 0.5 * np.cos(angle))
        body, shape = fmbd.RigidBody("body", 1.0, 0.2, place, angle), fmbd.HalfSpace((0, 0), (0, 1))
    points = fmbd.ball(body, radius, center=center)
    scene.add(body, fmbd.contact("floor", points, fmbd.Obstacle("floor", shape), friction=friction))
    run = fmbd.solve(scene, t_end=0.5, dt=dt, scheme=fmbd.Moreau(), output=fmbd.Output(progress=False))
    energy = sum(run.energy.values())
    return float(np.abs(energy - energy[0]).max()), float(np.ptp(run.energy["kinetic"]))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("where", ["pendulum", "bowl", "rocker"])
def test_smooth_motion_keeps_its_energy_to_second_order(
    where: str, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither joints nor curved obstacles take energy at first order, nor does rolling."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    (coarse, scale), (fine, _) = (swinging(where, dt) for dt in (2e-2, 1e-2))
    assert coarse < 1e-2 * scale
    assert 3.0 < coarse / fine < 5.0


@pytest.mark.parametrize(("impacts", "t_end"), [(20, 0.012), (0, 0.024)])
def test_elastic_block_between_planes_wins_no_energy(impacts: int, t_end: float) -> None:
    """Points that leave one plane are pressed back by the body's waves in the same step."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.1), origin=(0, -0.05), counts=(20, 2), quads=True)
    elastic = fmbd.materials.plane_stress(1e5, 0.0)
    block = fmbd.AbsoluteBody("block", mesh, degree=1, density=1e3, elastic=elastic, velocity=(0, 1.0))
    scene = fmbd.Scene("between planes")
    scene.add(block)
    for side, up in (("bottom", 1.0), ("top", -1.0)):
        plane = fmbd.Obstacle(side, fmbd.HalfSpace((0, -0.055 * up), (0, up)))
        scene.add(fmbd.contact(side, block.surface(side), plane, restitution=0.5, redistribute_mass=False))
    run = fmbd.solve(scene, t_end=t_end, dt=2e-3, scheme=fmbd.Moreau(impacts=impacts))
    energy = sum(run.energy.values())
    assert energy[-1] < 0.99 * energy[0]
    assert np.diff(energy).max() < 1e-12 * energy[0]


@pytest.mark.parametrize("compiled", [True, False])
def test_block_that_sticks_to_a_belt_has_its_speed(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A belt under even acceleration: a block on it was late by half a step, since slips began with a mean of the step."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    block = fmbd.RigidBody("block", 1.0, 0.1, position=(0.0, 0.1))
    feet = fmbd.corners(block, [(-0.2, -0.1), (0.2, -0.1)])
    belt = fmbd.Obstacle("belt", fmbd.HalfSpace((0, 0), (0, 1)), motion=lambda t: ((t * t, 0.0), 0.0))
    scene = fmbd.Scene("belt", gravity=(0, -9.81))
    scene.add(block, fmbd.contact("feet", feet, belt, friction=0.3))
    scene.sensor("x", fmbd.position(block))
    scene.sensor("v", fmbd.velocity(block))
    scene.sensor("force", fmbd.contact_force("feet"))
    run = fmbd.solve(scene, t_end=0.2, dt=1e-2)
    assert run["v"][:, 0] == pytest.approx(2.0 * run.times, abs=1e-9)
    assert run["x"][:, 0] == pytest.approx(run.times**2, abs=1e-9)
    assert run["force"][1:, 0] == pytest.approx(2.0, abs=1e-8)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("compiled", [True, False])
def test_slip_that_turns_about_within_a_step_is_of_second_order(
    compiled: bool, dim: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A block pushed up an incline stops and slides back: friction held it to the end of the step in which it stops, 5e-4 m/s."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    angle, mu, up, along = 0.3, 0.2, np.eye(dim)[-1], np.eye(dim)[0]
    rise, fall = (9.81 * (np.sin(angle) + sign * mu * np.cos(angle)) for sign in (1, -1))
    inertia = 0.1 if dim == 2 else (0.1, 0.1, 0.1)
    block = fmbd.RigidBody("block", 1.0, inertia, position=tuple(0.1 * up), velocity=tuple(-along))
    feet = np.array([(x, *y, -0.1) for x in (-0.2, 0.2) for y in ([()] if dim == 2 else [(-0.2,), (0.2,)])])
    slope = fmbd.HalfSpace((0,) * dim, tuple(up))
    scene = fmbd.Scene("incline", gravity=tuple(9.81 * (np.sin(angle) * along - np.cos(angle) * up)))
    scene.add(block, fmbd.contact("feet", fmbd.corners(block, feet), slope, friction=mu))
    scene.sensor("v", fmbd.velocity(block))
    scene.sensor("force", fmbd.contact_force("feet"))
    run = fmbd.solve(scene, t_end=0.4, dt=1e-2)
    assert (run.counters.get("compiled_steps", 0) > 0) is compiled
    t = run.times
    exact = np.where(t < 1 / rise, rise * t - 1, fall * (t - 1 / rise))
    assert run["v"][:, 0] == pytest.approx(exact, abs=1e-8)
    mean = np.diff(exact) / 1e-2 - 9.81 * np.sin(angle)
    assert run["force"][1:, 0] == pytest.approx(mean, abs=1e-6)


def stack(masses: tuple[float, ...], friction: float) -> fmbd.Scene:
    """Blocks of 0.2 m that rest on each other and, the first, on the ground."""
    scene, below = fmbd.Scene("stack", gravity=(0, -9.81)), None
    for i, mass in enumerate(masses):
        name, top = f"{i}", fmbd.HalfSpace((0, 0.1 if below else 0.0), (0, 1))
        block = fmbd.RigidBody(name, mass, 0.1 * mass, position=(0.0, 0.1 + 0.2 * i))
        feet = fmbd.corners(block, [(-0.1, -0.1), (0.1, -0.1)])
        obstacle = fmbd.Obstacle(f"top of {below.name}", top, on=below) if below else top
        scene.add(block, fmbd.contact(f"under {name}", feet, obstacle, friction=friction))
        scene.sensor(f"place of {name}", fmbd.position(block))
        scene.sensor(f"force under {name}", fmbd.contact_force(f"under {name}"))
        below = block
    return scene


@pytest.mark.parametrize("masses", [(1e9, 1e-9), (1e9, 1.0, 1e-9), (1e-3, 1e3)])
@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("compiled", [True, False])
def test_light_bodies_rest_on_heavy_ones(
    compiled: bool, friction: float, masses: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The largest force told that all contacts were found, and what was light sank by h^2 g in each step."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    run = fmbd.solve(stack(masses, friction), t_end=5e-3, dt=1e-3, scheme=fmbd.Moreau())
    assert (run.counters.get("compiled_steps", 0) > 0) is compiled
    for i in range(len(masses)):
        assert run[f"place of {i}"][-1] == pytest.approx((0.0, 0.1 + 0.2 * i), abs=1e-13)
        weight = 9.81 * sum(masses[i:])
        assert run[f"force under {i}"][-1] == pytest.approx((0.0, weight), rel=0.0, abs=1e-9 * weight)


@pytest.mark.parametrize("compiled", [True, False])
def test_heavy_body_on_a_light_one_does_not_sink_in_silence(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the heavy one gives way is lost in roundoff beside the light one's: it fell as if nothing was there."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    with pytest.raises(ConvergenceError):
        fmbd.solve(stack((1e9, 1e-9, 1e9), 0.0), t_end=5e-3, dt=1e-3, scheme=fmbd.Moreau())


@pytest.mark.parametrize("masses", [(1.0, 1e7), (1.0, 1e6, 1e6)])
def test_forces_between_heavy_bodies_and_the_ground_are_known_through_masses(masses: tuple[float, ...]) -> None:
    """The compliance hid what heavy ones give way: forces were 1e-10 off, or steps came in many parts.

    So they did where forces found were changed again by their roundoff, at which the light one's velocity does not converge.
    """
    run = fmbd.solve(stack(masses, 0.3), t_end=2e-2, dt=1e-3, scheme=fmbd.Moreau())
    assert run.counters["contact_steps"] == 20
    assert run.counters["active_set_iterations"] < 400
    for i in range(len(masses)):
        assert run[f"place of {i}"][-1, 1] == pytest.approx(0.1 + 0.2 * i, abs=1e-13)
        assert run[f"force under {i}"][-1, 1] == pytest.approx(9.81 * sum(masses[i:]), rel=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_error_of_a_heavy_body_on_a_light_one_says_so(friction: float) -> None:
    """It asked for a smaller step, or with friction for the scheme of the run."""
    with pytest.raises(ConvergenceError, match="differ by .e.1[1-4], as of heavy bodies on light ones"):
        fmbd.solve(stack((1e-6, 1e6), friction), t_end=1e-3, dt=1e-3, scheme=fmbd.Moreau())


@pytest.mark.parametrize("compiled", [True, False])
def test_of_several_touches_in_a_step_the_first_cuts_it(compiled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Balls that hit a floor 5, 6 and 9 ms behind the start of a step of 10 ms, whichever was added first."""
    if not compiled:
        monkeypatch.setattr(driver, "contact_driver", lambda *_, **__: None)
    heights = {"last": 9e-3, "first": 5.5e-3, "second": 6e-3}
    scene = fmbd.Scene("rain")
    for x, (name, height) in enumerate(heights.items()):
        ball = fmbd.RigidBody(name, 1.0, 0.1, position=(x, 0.1 + height), velocity=(0.0, -1.0))
        floor = fmbd.contact(f"{name} on floor", fmbd.ball(ball, 0.1), fmbd.HalfSpace((0, 0), (0, 1)), restitution=1.0)
        scene.add(ball, floor)
        scene.sensor(name, fmbd.position(ball))
    run = fmbd.solve(scene, t_end=0.02, dt=0.01, scheme=fmbd.Moreau())
    assert (run.counters.get("compiled_steps", 0) > 0) is compiled
    for name, height in heights.items():
        assert run[name][-1, 1] == pytest.approx(0.12 - height, abs=1e-9)


def test_balls_that_touch_take_one_impact() -> None:
    """A row of five equal balls, hit by the first: Newton's law for all of them at once, P = A^-1 (1 + e) v, and no cradle.

    Gaps make it one.
    """

    def speeds(gap: float) -> list[float]:
        scene, balls = fmbd.Scene("row"), []
        for i in range(5):
            x = i * (0.1 + gap) - (1e-3 if i == 0 else 0.0)
            balls.append(
                fmbd.RigidBody(f"ball {i}", 1.0, 1e-3, position=(x, 0.0), velocity=(float(i == 0), 0.0)),
            )
            scene.add(balls[-1])
            scene.sensor(f"v{i}", fmbd.velocity(balls[-1]))
        for i in range(4):
            face = fmbd.Obstacle(f"face {i}", fmbd.Sphere(0.05), on=balls[i + 1])
            scene.add(fmbd.contact(f"hit {i}", fmbd.ball(balls[i], 0.05), face, restitution=1.0))
        run = fmbd.solve(scene, t_end=0.01, dt=1e-3)
        return [float(run[f"v{i}"][-1, 0]) for i in range(5)]

    assert speeds(0.0) == pytest.approx([-0.6, 0.4, 0.4, 0.4, 0.4], abs=1e-12)
    assert speeds(1e-4) == pytest.approx([0.0, 0.0, 0.0, 0.0, 1.0], abs=1e-12)
