"""The half-explicit Runge-Kutta method: order four, error control, no drift."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import chain
from dae_problems import march, observed, pendulum, spinning_top, state_errors
from tolerance_more import four_bar

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.consistent import arrived
from fmbd_fenicsx.schemes.marching import MarchingStepper
from fmbd_fenicsx.schemes.onestep import explicit_stepper
from fmbd_fenicsx.schemes.onestep.half_explicit import coefficients


def test_order_conditions() -> None:
    c, a, difference = coefficients()
    b = a[5]
    assert np.abs(a[:5].sum(1) - c[:5]).max() < 1e-14
    for p in range(1, 5):
        assert b @ c[:5] ** (p - 1) == pytest.approx(1 / p)
    assert b @ a[:5] @ c[:5] == pytest.approx(1 / 6)
    assert b @ a[:5] @ c[:5] ** 2 == pytest.approx(1 / 12)
    assert b @ (c[:5] * (a[:5] @ c[:5])) == pytest.approx(1 / 8)
    assert (
        np.abs([difference.sum(), difference @ c[:5], difference @ c[:5] ** 2, difference @ a[:5] @ c[:5]]).max()
        < 1e-14
    )


def test_order_four() -> None:
    found = observed(fmbd.HalfExplicit(None), (40, 80, 160))
    assert (found > 3.85).all(), found


def test_order_four_in_space() -> None:
    scene = spinning_top()
    reference = march(scene, fmbd.Radau(3, fmbd.StateSpace(), None), 0.25, 80)[-1]
    errors = [state_errors(scene, march(scene, fmbd.HalfExplicit(None), 0.25, n)[-1], reference) for n in (20, 40)]
    assert (np.log2(errors[0] / errors[1]) > 3.85).all()


def test_work_grows_like_order_three_at_least() -> None:
    steps = [fmbd.solve(pendulum(), t_end=1.0, scheme=fmbd.HalfExplicit(r)).counters["steps"] for r in (1e-5, 1e-8)]
    assert steps[1] / steps[0] < 1000 ** (1 / 3)


def test_a_driven_turn() -> None:
    """A bead slides on an arm that a drive turns: x = cosh(t) / 2, to the order of the scheme."""

    def error(steps: int) -> float:
        scene = fmbd.Scene("bead")
        arm = fmbd.RigidBody("arm", 1.0, 1.0, (0.0, 0.0), angular_velocity=1.0)
        bead = fmbd.RigidBody("bead", 1.0, 0.1, (0.5, 0.0), velocity=(0.0, 0.5), angular_velocity=1.0)
        scene.add(arm, bead, fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0)))
        scene.add(fmbd.prismatic("wire", arm, bead, axis=(1, 0), center=(0, 0)))
        scene.add(fmbd.drive_rotation("motor", fmbd.ground, arm, lambda t: (t, 1.0, 0.0)))
        scene.sensor("place", fmbd.position(bead))
        run = fmbd.solve(scene, t_end=1.0, dt=1.0 / steps, scheme=fmbd.HalfExplicit(rtol=None))
        return float(np.abs(run["place"][-1] - 0.5 * np.cosh(1.0) * np.array([np.cos(1.0), np.sin(1.0)])).max())

    assert np.log2(error(5) / error(10)) > 3.5


@pytest.mark.parametrize("rtol", [None, 1e-6])
def test_a_step_is_one_compiled_call(rtol: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a drive of time and bodies in space; states agree to roundoff with stages that are made in parts."""
    scene, before = fmbd.Scene("arm", gravity=(0.0, 0.0, -9.81)), fmbd.ground
    for i, axis in enumerate(((0, 0, 1), (0, 1, 0), (0, 1, 0.3))):
        link = fmbd.RigidBody(f"link {i}", 1.0, (0.02, 0.1, 0.1), (0.5 + i, 0.0, 0.0))
        hinge = fmbd.revolute(f"hinge {i}", before, link, center=(float(i), 0.0, 0.0), axis=axis)
        scene.add(link, hinge, fmbd.joint_spring(f"spring {i}", fmbd.angle(hinge), stiffness=5.0, damping=0.2))
        before = link
    turn = lambda t: (1 - np.cos(3 * t), 3 * np.sin(3 * t), 9 * np.cos(3 * t))
    scene.add(fmbd.drive("base", fmbd.angle(scene.joints["hinge 0"]), turn))
    steps = {"t_end": 0.1, "dt": 5e-3 if rtol is None else None, "scheme": fmbd.HalfExplicit(rtol)}
    made, calls = MarchingStepper._made, []
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: (found := made(*given), calls.append(found))[0])
    run = fmbd.solve(scene, **steps)
    assert all(calls) and sum(calls) == run.counters["steps"]

    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    slow = fmbd.solve(scene, **steps)
    assert slow.counters["steps"] == run.counters["steps"]
    assert run.state.q == pytest.approx(slow.state.q, rel=1e-11, abs=1e-11)
    assert run.state.v == pytest.approx(slow.state.v, rel=1e-10, abs=1e-10)


def test_a_step_too_long_for_its_stages_is_halved_in_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """A four-bar linkage at rest, turned by a torque that rises: the step that is proposed there is far too long."""
    run = lambda: fmbd.solve(four_bar(), t_end=1.5, scheme=fmbd.HalfExplicit(1e-3))  # noqa: E731
    with monkeypatch.context() as patch:
        patch.setattr(MarchingStepper, "_made", lambda *given: 0)
        slow = run()
    assert slow.counters["rejected: constraints not closed"] > 0
    monkeypatch.setattr(explicit_stepper.ExplicitStepper, "_controlled", lambda *given: pytest.fail("made by Python"))
    fast = run()
    for name in ("steps", "rejections", "rejected: constraints not closed"):
        assert fast.counters[name] == slow.counters[name]
    assert fast.state.q == pytest.approx(slow.state.q, rel=1e-9, abs=1e-9)


def test_laws_of_time_are_asked_once_at_each_end_of_a_stage() -> None:
    """However many iterations a stage takes: of five stages and one end of a step that is eleven times."""
    asked: list[float] = []

    def turned(t: float) -> float:
        asked.append(t)
        return 3.0 * np.sin(5.0 * t)

    scene, last = chain(2, "twisted")
    scene.add(fmbd.torque("twist", last, turned))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=fmbd.HalfExplicit(None), output=fmbd.Output(every=50))
    assert run.counters["solves"] > 5 * 4 * 50
    assert len(asked) < 12 * 50


def test_laws_of_the_state_are_asked_twice_a_stage() -> None:
    """Increments of a balance that is linear in accelerations and multipliers leave nothing of it, up to the last one."""
    asked: list[float] = []

    def law(s: float, rate: float, t: float) -> float:
        asked.append(t)
        return 2.0 * s + 0.1 * rate

    scene, _ = chain(2, "sprung")
    scene.add(fmbd.joint_spring("spring", fmbd.angle(next(iter(scene.joints.values()))), law=law))
    run = fmbd.solve(scene, t_end=0.5, dt=0.01, scheme=fmbd.HalfExplicit(None), output=fmbd.Output(every=50))
    assert run.counters["solves"] > 5 * 4 * 50
    assert len(asked) < 13 * 50


@pytest.mark.parametrize("rtol", [None, 1e-6])
def test_a_body_that_is_held_has_roundoff_for_accelerations(rtol: float | None) -> None:
    """Its springs and its weight are carried, with steps of any length."""
    scene = fmbd.Scene("held", gravity=(0.0, -9.81, 0.0))
    body = fmbd.RigidBody("body", 1.0, (0.1, 0.2, 0.15), position=(0.3, 0.2, 0.1))
    scene.add(body, fmbd.fixed("weld", fmbd.ground, body, center=(0.1, 0.0, 0.3)))
    ends = {"point_a": (1.0, 1.0, 0.0), "point_b": (0.4, 0.2, 0.1)}
    scene.add(fmbd.Spring("spring", fmbd.ground, body, stiffness=1e4, length=0.1, **ends))
    scene.sensor("force", fmbd.reaction_force("weld"))
    run = fmbd.solve(scene, t_end=20.0, dt=2.0 if rtol is None else None, scheme=fmbd.HalfExplicit(rtol))
    pull = 1e4 * (1.0 - 0.1 / np.sqrt(1.01)) * np.array([0.6, 0.8, -0.1])
    assert run["force"][-1] == pytest.approx(pull + (0.0, -9.81, 0.0), rel=1e-9)


def swinging() -> fmbd.Scene:
    arm = fmbd.RigidBody("arm", 1.0, 1 / 12, (0.5, 0.0))
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
    scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0.0, 0.0)))
    scene.sensor("speed", fmbd.angular_velocity(arm))
    return scene


def test_an_end_that_cannot_be_closed_refuses_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """As at singular positions. The motion goes on: half w^2 / 3 is what the weight gave, 9.81 / 2 sin phi."""
    calls = []

    def closes(*x: Any, **y: Any) -> Any:
        calls.append(x)
        if len(calls) == 5:
            raise fmbd.errors.LinearSolveError("relative residual inf")
        return arrived(*x, **y)

    scene = swinging()
    scene.sensor("angle", fmbd.angle("pin"))
    monkeypatch.setattr(explicit_stepper, "arrived", closes)
    monkeypatch.setattr(MarchingStepper, "_made", lambda *given: 0)
    run = fmbd.solve(scene, t_end=0.5, scheme=fmbd.HalfExplicit(1e-8))
    assert run.counters["rejected: constraints not closed"] == 1
    assert run["speed"][-1, 0] ** 2 == pytest.approx(-3.0 * 9.81 * np.sin(run["angle"][-1, 0]), rel=1e-6)


def test_a_solve_that_fails_at_last_names_scene_and_step(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*x: Any, **y: Any) -> Any:
        raise fmbd.errors.LinearSolveError("relative residual inf")

    monkeypatch.setattr(explicit_stepper, "arrived", never)
    monkeypatch.setattr(MarchingStepper, "_step_in_one_call", lambda *x: False)
    monkeypatch.setattr(MarchingStepper, "stride", lambda *x: 0.0)
    with pytest.raises(fmbd.errors.FmbdError, match='Scene "pendulum", step 1 of 5: .*relative residual inf'):
        fmbd.solve(swinging(), t_end=0.05, dt=0.01, scheme=fmbd.HalfExplicit(None))
