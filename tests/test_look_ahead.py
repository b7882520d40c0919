"""What loads and drives do within a step that is not made yet: large steps are not tried in vain."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dae_problems import pendulum as point_pendulum
from test_variable_alpha import driven_crank, driven_pendulum, knocked, stepper_of

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.blocks.field_blocks import Weights
from fmbd_fenicsx.schemes.onestep.alpha.look_ahead import LookAhead


@pytest.mark.parametrize("make", [driven_crank, lambda: driven_pendulum(1.0), lambda: driven_pendulum(1e-3)])
def test_errors_of_prescribed_motions_are_foretold(make: Any) -> None:
    """The step that a drive allows has an error near the tolerance, far below that of the whole run."""
    stepper = stepper_of(make(), fmbd.Index3())
    norm, s = stepper.norm, stepper.state
    norm.look_ahead(s, 0.8)
    norm.update(s, 0.8)
    allowed = stepper.look.farthest(s, 0.8)
    assert allowed < 0.3
    assert stepper._attempt(0.8, 0)[0] > 20.0
    assert 0.05 < stepper._attempt(allowed, 0)[0] < 3.0


def test_a_drive_that_rests_at_first_allows_large_steps() -> None:
    """Up to where it begins, and what nothing drives any step."""
    scene = fmbd.Scene("late")
    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    axle = fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0))

    def late(t: float) -> tuple[float, float, float]:
        x = max(t - 1.0, 0.0)
        return x**4, 4 * x**3, 12 * x**2

    scene.add(arm, axle, fmbd.drive("drive", fmbd.angle(axle), late))
    look = stepper_of(scene, fmbd.Index3()).look
    start = stepper_of(scene, fmbd.Index3()).state
    look.norm.update(start, 2.0)
    assert 0.9 < look.farthest(start, 2.0) <= 1.05
    assert look.farthest(start, 0.9) == 0.9

    # steps that nothing moves in, of those that are looked at together: one that ends where it begins is none
    assert [look.still(start, 0.25, n) for n in (2, 4, 7)] == [2, 4, 4]
    assert look.still(start, 0.27, 7) == 3

    free = stepper_of(point_pendulum(), fmbd.Index3())
    assert free.look.farthest(free.state, 100.0) == 100.0


@pytest.mark.parametrize(("make", "t_end"), [(driven_crank, 1.2), (lambda: driven_pendulum(1.0), 1.0)])
def test_a_mechanism_from_rest_refuses_no_step(make: Any, t_end: float) -> None:
    """The first step is right at once, without trials of the whole run."""
    run = fmbd.solve(make(), t_end=t_end, scheme=fmbd.GeneralizedAlpha(rtol=1e-4))
    assert run.counters["rejections"] == 0


def test_a_look_at_loads_makes_no_factor(rod_mesh: Any) -> None:
    """The matrix at hand is softer: where it hardly moves, that of a larger step does so less. Where it moves, that is asked."""
    stepper = stepper_of(knocked(rod_mesh(dim=2, h=0.5, height=0.1)), fmbd.Index3())
    solver, s = stepper.solver, stepper.state
    before = solver.elastic.factorisations
    assert stepper.look.loads(s, 0.3) < 1e-6
    assert solver.elastic.factorisations == before and solver.weights == Weights(1.0, 0.0, 0.0)

    # with the knock of 0.002 s in the middle
    h = 2 * 0.801
    moved = stepper.look._moved(s, _knock(stepper, h), Weights(1.0, 0.0, 0.0))
    softer = stepper.norm(h, moved, np.zeros_like(moved))
    seen = stepper.look.loads(s, h)
    assert 1.0 < seen < softer
    assert solver.weights == stepper.look.weights(h)


def test_loads_that_stay_as_they_are_are_not_solved_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even for their roundoff between the ends of a step."""
    monkeypatch.setattr(LookAhead, "_moved", lambda *_: pytest.fail("a solution for nothing"))
    for scene in (point_pendulum(), driven_crank()):
        stepper = stepper_of(scene, fmbd.Index3())
        assert stepper.look.loads(stepper.state, 0.1, 8) == 0.0


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_moments_are_compared_with_forces_by_the_length_of_the_model(size: float) -> None:
    """In any unit of length the same one of both is the largest."""
    scene = fmbd.Scene("arm")
    arm = fmbd.RigidBody("arm", 1.0, 0.1 * size**2, (size, 0.0))
    scene.add(arm, fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0)))
    look = stepper_of(scene, fmbd.Index3()).look
    force, moment = np.array([0.0, 2.0, 0.0]), np.array([0.0, 0.0, look.system.length])
    np.testing.assert_array_equal(look._farthest(np.array([moment, force])), force)
    np.testing.assert_array_equal(look._farthest(np.array([3.0 * moment, force])), 3.0 * moment)


def ramps(t: float) -> float:
    return 100.0 * max(t - 1.2, 0.0)


def rises(t: float) -> float:
    return 30.0 * float(np.sin(5.0 * (t - 1.7))) if t > 1.7 else 0.0


@pytest.mark.parametrize(("stiffness", "load", "rtol"), [(4e4, ramps, 1e-4), (900.0, rises, 1e-3)])
def test_a_load_that_begins_late_on_a_stiff_spring_is_seen(stiffness: float, load: Any, rtol: float) -> None:
    """The step that its ends differ by took what it does within for a vibration: one for all of 2 s, off by 0.35 and 0.74."""
    scene, mass = fmbd.Scene("late"), fmbd.RigidBody("mass", 1.0, 1.0, (0.0, 0.0))
    rail = fmbd.prismatic("rail", fmbd.ground, mass, axis=(1, 0))
    way = fmbd.displacement(rail)
    scene.add(mass, rail, fmbd.joint_spring("spring", way, stiffness=stiffness, damping=20.0))
    scene.add(fmbd.force("load", mass, lambda t: (load(t), 0.0)))
    scene.sensor("place", way)
    output = fmbd.Output(times=tuple(np.linspace(0.0, 2.0, 81)))
    exact = fmbd.solve(scene, t_end=2.0, scheme=fmbd.Radau(3, rtol=1e-8), output=output)["place"]
    run = fmbd.solve(scene, t_end=2.0, scheme=fmbd.GeneralizedAlpha(rtol=rtol), output=output)
    assert np.abs(run["place"] - exact).max() < 20 * rtol * np.ptp(exact)


def test_only_what_may_push_in_time_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """A state that is held has the same forces at all times, unless a load, a law, gravity or a row that turns says otherwise."""

    def scene(*parts: Any, **given: Any) -> Any:
        made = fmbd.Scene("pushed", **given)
        made.add(arm, axle, *parts)
        return made.build()[0]

    arm = fmbd.RigidBody("arm", 1.0, 0.1, (0.5, 0.0))
    axle = fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0))
    steady, turns = fmbd.drive("drive", fmbd.angle(axle), lambda t: (t**4, 4 * t**3, 12 * t**2)), (0.0, -9.81)
    rows = fmbd.constraint("in time", fmbd.ground, arm, lambda a, b, t: np.cos(t) * b.x[0] - np.sin(t) * b.x[1])
    assert not scene(steady).pushes_in_time and not scene(gravity=turns).pushes_in_time
    for system in (
        scene(gravity=turns, gravity_ramp=0.1), scene(rows), scene(fmbd.force("push", arm, lambda t: (0.0, t)))
    ):  # fmt: skip
        assert system.pushes_in_time

    monkeypatch.setattr(LookAhead, "_at_most", lambda *_: pytest.fail("a look for nothing"))
    stepper = stepper_of(driven_crank(), fmbd.Index3())
    assert not stepper.system.pushes_in_time and stepper.look.loads(stepper.state, 0.1) == 0.0


def _knock(stepper: Any, h: float) -> np.ndarray:
    """h^2 / 6 times the force in the middle of a step, with the sign of a residual."""
    system, s = stepper.system, stepper.state
    rest, pushed = (system.at(t, s.q, s.v).balance(s.a, s.lam) for t in (s.t, s.t + 0.5 * h))
    return np.asarray(h * h / 6.0 * (pushed - rest))
