"""Force laws: work, tangents, closed solutions, errors that name the force."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from motion import Motion, first, plane_scene, space_scene
from profiled import calls_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, InputError
from fmbd_fenicsx.mechanics.forces.roads import Roads
from fmbd_fenicsx.system.tangents.force_tangent import force_tangent


def loaded(dim: int, what: str) -> fmbd.Scene:
    """Two bodies, a joint with a coordinate, and one kind of force."""
    scene, one, two = plane_scene(None) if dim == 2 else space_scene(None)
    hinge = fmbd.revolute(
        "hinge", one, two, center=(0.8, 0.2, 0.1)[:dim], axis=(0, 0, 1) if dim == 2 else (0.3, -0.5, 0.8)
    )
    scene.add(hinge)
    points = ((0.3, 0.1, 0.2)[:dim], (1.4, 0.2, 0.1)[:dim])
    if what == "spring":
        scene.add(fmbd.Spring("s", one, two, *points, 40.0, 0.0, 0.9))
    elif what == "damped spring":
        scene.add(fmbd.Spring("s", one, two, *points, 40.0, 3.0, 0.9))
    elif what == "own spring":
        scene.add(fmbd.Spring("s", one, two, *points, law=lambda s, v, t: 30 * s + 50 * s**3 + 2 * v))
    elif what == "hardening spring":
        scene.add(fmbd.Spring("s", one, two, *points, law=lambda s, v, t: 30 * s + 50 * s**3))
    elif what == "joint spring":
        scene.add(fmbd.joint_spring("s", fmbd.angle(hinge), stiffness=20.0, damping=0.5, free=0.2))
    elif what == "sum":
        strand = fmbd.segment("strand", one, two, point_a=points[0], point_b=points[1])
        scene.add(strand)
        sum_of = fmbd.displacement(strand) - 0.4 * fmbd.angle(hinge) + 0.1
        scene.add(fmbd.joint_spring("s", sum_of, stiffness=20.0, damping=0.0, free=0.2))
    elif what == "own force":
        scene.add(
            fmbd.own_force("s", one, two, lambda t, a, b: (7.0 * (a.x - b.x) - 0.5 * b.v, 0.3 * b.w), points=points)
        )
    elif what == "tyre":
        road = lambda x, t: 0.2 * np.sin(2 * x[0] - t)  # noqa: E731
        scene.add(
            fmbd.Tyre("s", one, point_a=points[0], road=road, radius=0.8, stiffness=50.0, damping=2.0, up=(0, 1, 0))
        )
    return scene


KINDS = ["spring", "damped spring", "hardening spring", "own spring", "joint spring", "sum", "own force", "tyre"]


@pytest.mark.parametrize("what", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_against_differences(dim: int, what: str) -> None:
    """The damping part against differences in v exactly; the stiffness part but for rotations of the force's own lever."""
    motion = Motion(loaded(dim, what), size=0.1)
    s, dv = motion.system, motion.direction()
    ev = s.at(motion.t, motion.q, motion.v)
    force = lambda v: -ev.spread(s.at(motion.t, motion.q, v).wrenches())  # noqa: E731
    D = np.asarray(force_tangent(ev, 1.0, 0.0).core)
    rate = first(lambda e: force(motion.v + e * dv))
    assert np.abs(D @ dv - rate).max() < 1e-5 * max(1.0, np.abs(rate).max())
    dq = np.zeros_like(dv).reshape(-1, s.motions.n_twist)
    dq[:, : s.motions.dim] = dv.reshape(dq.shape)[:, : s.motions.dim]
    moved = first(lambda e: -s.at(motion.t, s.compose(motion.q, e * dq.ravel()), motion.v).wrenches().ravel())
    found = np.zeros_like(moved.reshape(-1, s.motions.dim + s.motions.n_rot))
    if what in ("damped spring", "own spring", "tyre"):
        return  # the change of direction of the damper is left out of the tangent
    tangent = s.forces[0].tangent(ev.kin, motion.t)
    n = found.shape[1]
    dx = (ev.kin.jac_frame @ np.concatenate((dq, np.zeros((1, dq.shape[1]))))[s.markers.frame][..., None])[..., 0]
    every = np.concatenate([dx[m] for m in tangent.markers], axis=1)
    pushed = (tangent.K @ every[..., None])[..., 0]
    for k, m in enumerate(dict.fromkeys(map(tuple, tangent.markers))):
        np.add.at(found, list(m), pushed[:, k * n : (k + 1) * n])
    assert np.abs(found.ravel() - moved).max() < 2e-5 * max(1.0, np.abs(moved).max())


@pytest.mark.parametrize("what", ["spring", "joint spring", "sum"])
@pytest.mark.parametrize("dim", [2, 3])
def test_power_is_minus_the_rate_of_energy(dim: int, what: str) -> None:
    motion = Motion(loaded(dim, what), size=0.1)
    if what == "joint spring":
        motion.system.forces[0].c[:] = 0.0
    ev = motion.at(0.0)
    power = float(ev.spread(ev.wrenches()) @ motion.v)
    rate = first(lambda s: motion.at(s).energies()["springs"])
    assert abs(power + rate) < 1e-7 * max(1.0, abs(power))


@pytest.mark.parametrize("what", ["spring", "damped spring", "own spring", "joint spring", "sum", "own force"])
@pytest.mark.parametrize("dim", [2, 3])
def test_internal_forces_have_no_resultant(dim: int, what: str) -> None:
    motion = Motion(loaded(dim, what), size=0.1)
    ev = motion.at(0.0)
    w, d = ev.wrenches(), dim
    assert np.abs(w[:, :d].sum(0)).max() < 1e-12 * np.abs(w).max()
    moment = w[:, d:].sum(0) + motion.system.motions.moment(ev.kin.x, w[:, :d]).sum(0)
    assert np.abs(moment).max() < 1e-12 * np.abs(w).max()


def test_torsional_oscillator() -> None:
    """J phi'' + k phi = 0 released from 0.4 rad over several turns of the frame: frequency and energy."""
    wheel = fmbd.RigidBody("wheel", 1.0, (0.3, 0.3, 0.5), angular_velocity=(0, 0, 20.0))
    scene = fmbd.Scene("torsion")
    scene.add(wheel)
    hinge = fmbd.revolute("hinge", fmbd.ground, wheel, center=(0, 0, 0))
    scene.add(hinge, fmbd.joint_spring("spring", fmbd.angle(hinge), stiffness=2.0))
    scene.sensor("phi", fmbd.angle(hinge))
    run = fmbd.solve(scene, t_end=2.0, dt=1e-3)
    w = math.sqrt(2.0 / 0.5)
    assert np.abs(run["phi"][:, 0] - 20.0 / w * np.sin(w * run.times)).max() < 1e-4  # amplitude 10 rad
    assert run["phi"].max() > 3 * math.pi


def test_effort_accelerates_its_coordinate() -> None:
    cart = fmbd.RigidBody("cart", 4.0, 1.0)
    scene = fmbd.Scene("cart")
    scene.add(cart)
    rail = fmbd.prismatic("rail", fmbd.ground, cart, axis=(1, 0), center=(0, 0))
    s = fmbd.displacement(rail)
    scene.add(rail, fmbd.effort("motor", s, lambda t: 8.0))
    scene.sensor("s", s)
    run = fmbd.solve(scene, t_end=1.0, dt=0.01)
    assert abs(run["s"][-1, 0] - 1.0) < 1e-12


def test_stiff_spring_needs_its_tangent() -> None:
    """A spring of 1e8 N/m on 1 kg with steps far above its period converges in few iterations."""
    mass = fmbd.RigidBody("mass", 1.0, 1.0, position=(1.0, 0.0))
    scene = fmbd.Scene("stiff", gravity=(9.81, 0.0))
    scene.add(mass, fmbd.Spring("s", fmbd.ground, mass, (0, 0), None, 1e8, 0.0, 1.0))
    scene.sensor("x", fmbd.position(mass))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=fmbd.GeneralizedAlpha(0.0))
    assert run.counters["newton_iterations"] <= 4 * run.counters["steps"]
    assert abs(run["x"][-1, 0] - 1.0 - 9.81e-8) < 1e-10


def test_wheel_rests_on_the_road() -> None:
    wheel = fmbd.RigidBody("wheel", 10.0, 1.0, position=(0.0, 0.3))
    scene = fmbd.Scene("wheel", gravity=(0, -9.81))
    scene.add(wheel, fmbd.Tyre("tyre", wheel, road=lambda x, t: 0.0, radius=0.3, stiffness=1e5, damping=1e3))
    scene.sensor("y", fmbd.position(wheel))
    run = fmbd.solve(scene, t_end=1.0, dt=1e-3)
    assert abs(run["y"][-1, 1] - (0.3 - 98.1 / 1e5)) < 1e-8


def test_wheel_in_the_air_feels_nothing() -> None:
    wheel = fmbd.RigidBody("wheel", 10.0, 1.0, position=(0.0, 2.3))
    scene = fmbd.Scene("wheel", gravity=(0, -10.0))
    scene.add(wheel, fmbd.Tyre("tyre", wheel, road=lambda x, t: 0.0, radius=0.3, stiffness=1e5))
    scene.sensor("y", fmbd.position(wheel))
    run = fmbd.solve(scene, t_end=0.3, dt=0.01)
    assert abs(run["y"][-1, 1] - (2.3 - 0.45)) < 1e-10


@pytest.mark.parametrize("law", [lambda s, v, t: float("nan"), lambda s, v, t: [1.0, 2.0]])
def test_bad_law_is_named(law: Any) -> None:
    mass = fmbd.RigidBody("mass", 1.0, 1.0, position=(1.0, 0.0))
    scene = fmbd.Scene("bad")
    scene.add(mass, fmbd.Spring("my spring", fmbd.ground, mass, (0, 0), law=law))
    with pytest.raises(CallbackError, match='"my spring".*t = 0'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


def test_forces_refuse_wrong_input() -> None:
    mass = fmbd.RigidBody("mass", 1.0, 1.0)
    with pytest.raises(InputError, match='"s".*damping'):
        fmbd.Spring("s", fmbd.ground, mass, damping=-1.0)
    with pytest.raises(InputError, match='"s".*stiffness'):
        fmbd.Spring("s", fmbd.ground, mass, stiffness=float("inf"))
    with pytest.raises(InputError, match='"s".*must be fmbd.angle'):
        fmbd.joint_spring("s", mass)  # type: ignore[arg-type]
    with pytest.raises(InputError, match='"t".*unit vector'):
        fmbd.Tyre("t", mass, road=lambda x, t: 0.0, stiffness=1.0, up=(0, 2, 0))
    with pytest.raises(InputError, match='"t": up = None must be given in space'):
        fmbd.Tyre("t", fmbd.RigidBody("wheel", 1.0, (1.0, 1.0, 1.0)), road=lambda x, t: 0.0, stiffness=1.0)
    scene = fmbd.Scene("together")
    scene.add(mass, fmbd.Spring("s", fmbd.ground, mass, (0, 0), stiffness=1.0))
    with pytest.raises(InputError, match='"s".*coincide'):
        fmbd.solve(scene, t_end=0.1, dt=0.01)


@pytest.mark.parametrize("dim", [2, 3])
def test_tyre_damps_the_rate_of_its_compression(dim: int) -> None:
    """c' of a wheel on a slope that moves: against differences along the motion."""
    motion = Motion(loaded(dim, "tyre"), size=0.1)
    tyre = motion.system.forces[0]
    rate = first(lambda s: tyre._compression(motion.at(s).kin, motion.t + s)[0])
    assert np.abs(tyre._compression(motion.at(0.0).kin, motion.t)[1] - rate).max() < 1e-6 * np.abs(rate).max()


def test_a_road_is_asked_twice_for_a_force_and_may_take_numbers_only() -> None:
    """A call gives height and rate, and one more sees whether parts were dropped; another road gives the same by differences, of
    five heights.
    """
    asked: list[Any] = []

    def road(x: Any, t: Any, sine: Any = np.sin) -> Any:
        asked.append(t)
        return 0.1 * sine(3 * x[0] + t) if x[0] > 0 else 0.0

    found = []
    for sine in (np.sin, lambda y: math.sin(float(y))):
        wheel = fmbd.RigidBody("wheel", 1.0, (0.1, 0.1, 0.1), position=(0.2, 0, 0.3), velocity=(1, 0.5, -0.2))
        scene = fmbd.Scene("road", gravity=(0, 0, -9.81))
        way = lambda x, t, sine=sine: road(x, t, sine)
        scene.add(wheel, fmbd.Tyre("tyre", wheel, road=way, radius=0.3, stiffness=2e3, damping=50.0, up=(0, 0, 1)))
        scene.sensor("wheel", fmbd.position(wheel))
        asked.clear()
        run = fmbd.solve(scene, t_end=0.2, dt=1e-3)
        found.append((run["wheel"], len(asked) / run.counters["newton_iterations"]))
    assert np.abs(found[1][0] - found[0][0]).max() < 1e-9
    assert found[0][1] < 3.5 < found[1][1] < 8.0


def rolled(road: Any, scheme: Any = None, height: float = 0.3, damping: float = 50.0, *, t_end: float = 0.1) -> Any:
    """A run of one wheel over a road."""
    wheel = fmbd.RigidBody("wheel", 1.0, 0.1, position=(0.2, height), velocity=(1, -0.2))
    scene = fmbd.Scene("road", gravity=(0, -9.81))
    scene.add(wheel, fmbd.Tyre("tyre", wheel, road=road, radius=0.3, stiffness=2e3, damping=damping))
    scene.sensor("wheel", fmbd.position(wheel))
    return fmbd.solve(scene, t_end=t_end, dt=1e-3, scheme=scheme or fmbd.GeneralizedAlpha())


def test_a_road_may_drop_imaginary_parts_on_the_way() -> None:
    """Behind a place that the wheel passes later its rate is that of the same road by numbers that carry rates."""
    kinked = rolled(lambda x, t: np.where(x[0] < 0.25, 0.0, np.abs(x[0] - 0.25)))
    plain = rolled(lambda x, t: max(x[0] - 0.25, 0.0))
    assert np.abs(kinked["wheel"] - plain["wheel"]).max() < 1e-9


def test_a_tyre_is_asked_in_few_calls() -> None:
    """Of a run of BDF for each height that the road gives: 16.6, and 19.3 where sums are methods of arrays."""
    asked: list[float] = []

    def road(x: Any, t: Any) -> Any:
        asked.append(0.0)
        return 0.01 * np.sin(3 * x[0])

    rolled(road, fmbd.BDF(2, rtol=None), height=0.295)
    counts, heights = [], []
    for t_end in (0.1, 0.3):
        asked.clear()
        counts.append(calls_of(lambda t=t_end: rolled(road, fmbd.BDF(2, rtol=None), height=0.295, t_end=t)))
        heights.append(len(asked))
    assert counts[1] - counts[0] < 18 * (heights[1] - heights[0])


@pytest.mark.parametrize("damping", [0.0, 50.0])
def test_a_road_is_asked_once_for_equal_arguments(damping: float) -> None:
    asked: list[str] = []

    def road(x: Any, t: Any) -> Any:
        asked.append(repr((x.tolist(), t)))
        return 0.1 * np.sin(3 * x[0] + t)

    rolled(road, fmbd.HalfExplicit(), damping=damping)
    assert len(asked) <= 1.2 * len(set(asked))
    assert sum("Jet" in arguments for arguments in asked) <= 2


def test_slopes_of_a_road_under_a_lifted_tyre_are_not_asked_for() -> None:
    asked = 0

    def road(x: Any, t: Any) -> Any:
        nonlocal asked
        asked += 1
        return 0.0

    run = rolled(road, height=2.0, damping=0.0)
    ev = run.system.at(0.0, run.state.q, run.state.v)
    run.system.forces[0].wrenches(ev.kin, 0.0)
    asked = 0
    run.system.forces[0].tangent(ev.kin, 0.0)
    assert not asked


def test_a_road_is_asked_for_its_rate_by_dampers_only() -> None:
    """Of a tyre without damping for numbers alone, in all schemes."""
    asked: set[type] = set()

    def road(x: Any, t: Any) -> Any:
        asked.add(type(t))
        return 0.1 * np.sin(3 * x[0] + t)

    wheel = fmbd.RigidBody("wheel", 1.0, 0.1, position=(0.2, 0.35), velocity=(1, 0.5))
    scene = fmbd.Scene("road", gravity=(0, -9.81))
    scene.add(wheel, fmbd.Tyre("tyre", wheel, road=road, stiffness=2e3))
    for scheme in (fmbd.GeneralizedAlpha(), fmbd.Radau(2, rtol=None), fmbd.HalfExplicit()):
        fmbd.solve(scene, t_end=0.02, dt=1e-3, scheme=scheme)
    assert asked == {float}


def test_a_spring_without_length_names_what_takes_its_place() -> None:
    body = fmbd.RigidBody("body", 1.0, 1.0)
    scene = fmbd.Scene("spring")
    scene.add(body, fmbd.Spring("s", fmbd.ground, body, stiffness=1.0))
    with pytest.raises(InputError, match='Spring "s": its two points coincide.*force_element'):
        fmbd.solve(scene, t_end=0.1, dt=0.1)


def test_a_road_of_a_part_of_the_time_is_known_on_one_side() -> None:
    """Where it begins and ends, and where it jumps: rates are those of the side that is known, or ahead."""

    def road(x: Any, t: Any) -> float:
        if not 0.0 <= float(t) <= 0.1:
            raise ValueError("no such time")
        return 0.02 * math.sin(40.0 * float(t)) + 0.1 * (float(t) >= 0.05)

    heights = Roads([fmbd.Tyre("tyre", fmbd.RigidBody("wheel", 1.0, 0.1), road=road, radius=0.3, stiffness=1.0)])
    for t in (0.0, 0.02, 0.05, 0.1):
        assert heights.moving(np.zeros((1, 2)), np.zeros((1, 2)), t)[0, 1] == pytest.approx(
            0.8 * math.cos(40 * t), abs=1e-6
        )
