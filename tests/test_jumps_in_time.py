"""Instants at which loads jump are found among those at which they are even, and little is asked of loads that are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tolerance_more import bar

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import plane_stress
from fmbd_fenicsx.run import single_run, time_loop
from fmbd_fenicsx.run.accuracy import companion_runs
from fmbd_fenicsx.run.accuracy import jumps_in_time as looks
from fmbd_fenicsx.run.schedule import StepSchedule

STEPS = 48


def under(force: Callable[[float], float]) -> looks.HeldState:
    """A mass on a spring under a force in time."""
    scene = fmbd.Scene("mass", gravity=(0.0, 0.0))
    mass = fmbd.RigidBody("mass", 1.0, 0.1, (1.0, 0.0))
    scene.add(mass, fmbd.Spring("spring", fmbd.ground, mass, stiffness=20.0, length=0.7))
    scene.add(fmbd.force("push", mass, lambda t: (force(t), 0.0)))
    system, state, _ = scene.build()
    return looks.HeldState(system, state)


JUMPING = {
    "one": (lambda t: np.sin(3.0 * t) + (t > 0.237), (0.237,)),
    "with a value at the instant": (lambda t: np.sign(t - 0.237), (0.237,)),
    "in the middle of an interval": (lambda t: np.sign(t - 12.5 / STEPS), (12.5 / STEPS,)),
    "in the first interval": (lambda t: t + (t > 0.003), (0.003,)),
    "a pulse": (lambda t: float(0.31 < t < 0.33), (0.31, 0.33)),
    "a staircase": (lambda t: np.floor((t - 0.013) / 0.035), tuple(0.013 + 0.035 * np.arange(29))),
    "a stair in every interval": (
        lambda t: np.floor(STEPS * t - 0.3),
        tuple((0.3 + np.arange(STEPS)) / STEPS),
    ),
}


@pytest.mark.parametrize("name", JUMPING)
def test_jumps_are_found_to_roundoff(name: str) -> None:
    """Alone, beside each other, and where each interval has one, so that all change alike."""
    force, when = JUMPING[name]
    found = looks.jumps_in_time(under(force), looks.all_along(StepSchedule(1.0, STEPS)))
    assert len(found) == len(when)
    np.testing.assert_allclose(found, when, rtol=0, atol=1e-14)


@pytest.mark.parametrize("force", [lambda t: t**3, lambda t: np.sin(9.0 * t), lambda t: np.exp(-t)])
def test_little_is_asked_of_even_loads(force: Callable[[float], float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the ends of steps one interval in eight, and those whose neighbours do not tell them."""
    asked, rows = [], looks.HeldState.rows
    monkeypatch.setattr(looks.HeldState, "rows", lambda held, t: (asked.append(len(t)), rows(held, t))[1])
    assert not looks.jumps_in_time(under(force), looks.all_along(StepSchedule(1.0, STEPS)))
    assert asked[0] == STEPS + 1 and sum(asked[1:]) < STEPS // 2


def test_nothing_is_asked_where_nothing_depends_on_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mass on a spring alone."""
    monkeypatch.setattr(looks, "jumps_in_time", lambda *given: pytest.fail("it is looked at"))
    scene = fmbd.Scene("mass", gravity=(0.0, -9.81))
    mass = fmbd.RigidBody("mass", 1.0, 0.1, (0.0, -1.0))
    scene.add(mass, fmbd.Spring("spring", fmbd.ground, mass, stiffness=50.0, length=1.0))
    scene.sensor("x", fmbd.position(mass))
    run = fmbd.solve(scene, t_end=0.5, tol={"x": 1e-2}, output=fmbd.Output(progress=False))
    assert run.history[-1].then == "done"


@pytest.mark.parametrize("scheme", [None, fmbd.BDF()], ids=["equal steps", "own steps"])
def test_steps_of_the_first_run_end_where_loads_jump(scheme: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are looked for before anything is run: what other steps tell says nothing of the jump, of own ones a quarter."""
    steps, march = [], time_loop.march

    def noted(problem: Any, solver: Any, schedule: StepSchedule, *rest: Any) -> Any:
        steps.append(schedule.steps)
        return march(problem, solver, schedule, *rest)

    for module in (companion_runs, single_run):
        monkeypatch.setattr(module, "march", noted)
    scene = fmbd.Scene("mass", gravity=(0.0, 0.0))
    mass = fmbd.RigidBody("mass", 1.0, 0.1, (1.0, 0.0))
    scene.add(mass, fmbd.Spring("spring", fmbd.ground, mass, stiffness=20.0, length=0.7))
    scene.add(fmbd.force("push", mass, lambda t: (3.0 * (t > 0.237), 0.0)))
    scene.sensor("x", fmbd.position(mass))
    run = fmbd.solve(scene, t_end=0.52, scheme=scheme, tol={"x": 1e-4}, output=fmbd.Output(progress=False))
    assert run.scene.breakpoints == pytest.approx((0.237,), abs=1e-15) and run.history[-1].then == "done"
    assert not run.history[0].errors and "no errors stated" in str(run.history[0])
    assert steps[0] == 0 if scheme else 200 <= steps[0] <= 210
    since, w = np.maximum(run.times - 0.237, 0.0), np.sqrt(20.0)
    true = np.abs(run["x"][:, 0] - 0.7 - 0.15 * (1.0 - np.cos(w * since)) - 0.3 * np.cos(w * run.times)).max()
    assert 0.5 * true <= run.certificate["x"].total <= 5.0 * true


def test_jumps_in_elastic_bodies_are_looked_for_about_the_kinks_that_they_leave(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each instant of a field costs as much as a step: some before and behind the kink, and those that halve the interval."""
    asked, rows = [], looks.HeldState.rows
    monkeypatch.setattr(looks.HeldState, "rows", lambda held, t: (asked.append(len(t)), rows(held, t))[1])
    arm = bar("arm", h=0.25, height=0.08, law=plane_stress(3e8, 0.3), density=1000.0, stiffness_damping=2e-3)
    scene = fmbd.Scene("arm")
    scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("push", arm.surface("tip"), lambda t: (0.0, 25.0 if t < 0.1713 else -10.0)))
    scene.sensor("tip", fmbd.position(arm.surface("tip")))
    run = fmbd.solve(scene, t_end=0.4, tol={"tip": 5e-5}, output=fmbd.Output(progress=False))
    assert run.scene.breakpoints == pytest.approx((0.1713,), abs=1e-15) and run.history[-1].then == "done"
    assert sum(asked) < 100 < run.counters["steps"]


@pytest.mark.parametrize("scheme", [fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum()], ids=lambda s: s.name)
def test_a_certificate_states_what_a_jump_within_a_step_leaves(scheme: Any) -> None:
    """Runs with 2 h and 4 h agreed by chance to a thirtieth of it."""
    scene = fmbd.Scene("mass", gravity=(0.0, 0.0))
    mass = fmbd.RigidBody("mass", 1.0, 0.1, (1.0, 0.0))
    scene.add(mass, fmbd.Spring("spring", fmbd.ground, mass, stiffness=20.0, length=1.0))
    scene.add(fmbd.force("push", mass, lambda t: (3.0 * (t > 0.2371), 0.0)))
    scene.sensor("x", fmbd.position(mass))
    run = fmbd.solve(scene, t_end=0.6, dt=0.01, scheme=scheme, output=fmbd.Output(estimate_error=True, progress=False))

    since, w = np.maximum(run.times - 0.2371, 0.0), np.sqrt(20.0)
    true = np.abs(run["x"][:, 0] - 1.0 - 0.15 * (1.0 - np.cos(w * since))).max()
    assert true < run.error_estimate["x"] < 2.0 * true
    assert run.jumps == pytest.approx((0.2371,), abs=1e-15)
    assert "x" not in run.certificate.uncertain and any("t = 0.2371 s" in said for said in run.warnings)


def test_loads_of_slender_bodies_are_asked_all_along_their_first_run() -> None:
    """A small load that jumps leaves no kink in large steps; rods are asked by compiled code, once there is a run."""
    section = fmbd.RodSection((2e5, 8e4, 8e4, 15.0, 25.0, 25.0), 0.9, (1e-3, 6e-4, 6e-4))
    rod = fmbd.Rod("rod", [(0, 0, 0), (0.8, 0, 0)], section, elements=3, degree=2)
    scene = fmbd.Scene("rod")
    scene.add(rod, fmbd.fixed("hold", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.force("load", rod.surface("end"), lambda t: (0.0, 0.0, 0.02 if t >= 0.437 else 0.01)))
    scene.sensor("end", fmbd.position(rod.surface("end")))
    run = fmbd.solve(scene, t_end=1.0, tol={"end": fmbd.relative(0.1)}, output=fmbd.Output(progress=False))
    assert run.scene.breakpoints == pytest.approx((0.437,), abs=1e-15) and run.history[-1].then == "done"
