"""Constant steps in parts where a whole one fails: all schemes, recorded on the grid of whole steps, counted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import BalanceError, ConvergenceError, LinearSolveError
from fmbd_fenicsx.run.judges.energy_check import Watch
from fmbd_fenicsx.run.step_bisection import ConstantSteps
from fmbd_fenicsx.schemes import TimeStepper
from fmbd_fenicsx.system.layout import State
from fmbd_fenicsx.system.system import System

TOUCH = -0.5  # rad


def rod(stiffness: float, power: float, damping: float) -> tuple[fmbd.Scene, float]:
    """A rod falls on a stop, stiffness x^power, that switches on within a step; and the angle at which it comes to rest."""

    def stop(s: float) -> float:
        return -stiffness * max(-s, 0.0) ** power

    scene = fmbd.Scene("stop", gravity=(0, -9.81))
    body = fmbd.RigidBody("rod", 1.0, 1 / 12, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, body, center=(0, 0))
    scene.add(body, pin)
    scene.add(fmbd.joint_spring("stop", fmbd.angle(pin), free=TOUCH, law=lambda s, rate, t: stop(s) + damping * rate))
    scene.sensor("phi", fmbd.angle(pin))
    return scene, float(brentq(lambda phi: stop(phi - TOUCH) + 9.81 * 0.5 * np.cos(phi), -1.5, TOUCH))


CASES = [
    (fmbd.GeneralizedAlpha(0.8), (1e12, 3.0, 10.0), 0.02, 3.0, 1e-3),
    (fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()), (1.05e12, 3.0, 10.0), 0.02, 3.0, 1e-3),
    (fmbd.Radau(3, rtol=None), (1e9, 1.5, 5.0), 0.05, 2.0, 1e-9),
    (fmbd.BDF(2, rtol=None), (1e12, 3.0, 10.0), 0.04, 2.4, 1e-9),
]


@pytest.mark.parametrize(("scheme", "law", "dt", "end", "near"), CASES, ids=lambda x: getattr(x, "name", None))
def test_a_stiff_law_that_switches_on(
    scheme: Any, law: tuple[float, float, float], dt: float, end: float, near: float
) -> None:
    """h omega up to 1e4 at the stop: single steps fail, the motion ends at rest on it, on the grid of whole steps."""
    scene, rest = rod(*law)
    run = fmbd.solve(scene, t_end=end, dt=dt, scheme=scheme)
    assert 0 < run.counters["halved_steps"] < 30
    assert "halving" in run.report()
    assert run["phi"].min() > rest - 1e-3
    assert abs(run["phi"][-1, 0] - rest) < near
    steps = round(end / dt)
    assert run.counters["steps"] == steps
    assert run.times == pytest.approx(np.linspace(0.0, end, steps + 1), abs=1e-13)


class Brittle(TimeStepper):
    """Steps that fail when they are longer than ``longest``, or after ``end``; counts what it does."""

    local_error = 0.1

    def __init__(self, state: State, longest: float, end: float = np.inf) -> None:
        self.state, self.longest, self.end = state, longest, end
        self.made = 0

    @property
    def counters(self) -> dict[str, float]:
        return {"made": self.made}

    def restart(self, t: float) -> None:
        raise AssertionError("constant steps begin from a consistent state")

    def advance(self, h: float) -> State:
        if h > self.longest:
            raise ConvergenceError(f"h = {h}")
        if self.state.t + h > self.end:
            raise LinearSolveError(f"t = {self.state.t + h}")
        self.made += 1
        self.state = replace(self.state, t=self.state.t + h)
        return self.state


def body() -> tuple[System, State]:
    scene = fmbd.Scene("free")
    scene.add(fmbd.RigidBody("body", 2.0, 1.0, velocity=(1.0, 0.0)))
    return scene.build()[:2]


def test_parts_and_renewals() -> None:
    """A worker for each size; counters add up; times are those of whole steps."""
    system, state = body()
    renewed: list[float] = []

    def renew(s: State) -> Brittle:
        renewed.append(s.t)
        return Brittle(s, 0.3)

    stepper = ConstantSteps(Brittle(state, 0.3), system, renew, None)
    assert stepper.advance(1.0).t == 1.0 and stepper.counters == {"made": 4, "halved_steps": 3}
    assert renewed == [0.0, 0.0, 0.5, 0.5]  # to 1/2, to 1/4, back to 1/2, to 1/4
    assert stepper.advance(0.1).t == 1.1 and stepper.advance(0.1).t == 1.1 + 0.1
    assert renewed[4:] == [1.0] and stepper.counters == {"made": 6, "halved_steps": 3}
    assert stepper.local_error == 0.1


def test_steps_that_fail_one_after_another_begin_in_parts() -> None:
    """Failures of whole steps die out: 1, 2, 4, ... steps begin in halves before one is tried whole again."""
    failed = []

    class Told(Brittle):
        def advance(self, h: float) -> State:
            if h > self.longest:
                failed.append(self.state.t)
            return super().advance(h)

    system, state = body()
    stepper = ConstantSteps(Told(state, 0.3), system, None, None)
    for k in range(1, 201):
        assert stepper.advance(1.0).t == k
    assert failed[:3] == [0.0, 0.0, 0.5] and len(failed) < 40 and stepper.counters["made"] == 800
    assert stepper.counters["halved_steps"] == 600

    stepper.stepper.longest = 1.0  # type: ignore[attr-defined]
    for _ in range(500):
        stepper.advance(1.0)
    made = stepper.counters["made"]
    stepper.advance(1.0)
    assert stepper.counters["made"] == made + 1


def test_without_renewal_the_worker_goes_on() -> None:
    system, state = body()
    worker = Brittle(state, 0.3)
    stepper = ConstantSteps(worker, system, None, None)
    assert stepper.advance(1.0).t == 1.0 and stepper.stepper is worker and worker.made == 4


EXPONENTIAL = [
    (fmbd.GeneralizedAlpha(0.8), math.exp, 1e-4, 0.02),  # it bounces
    (fmbd.Radau(2, rtol=None), math.exp, 6e-4, 1e-6),
    (fmbd.Radau(2, rtol=None), np.exp, 6e-4, 1e-6),
    (fmbd.EnergyMomentum(), np.exp, 6e-4, 2e-4),
]


@pytest.mark.parametrize(("scheme", "exp", "scale", "near"), EXPONENTIAL)
def test_a_law_beyond_the_range_of_numbers(
    scheme: Any, exp: Callable[[float], float], scale: float, near: float
) -> None:
    """A stop whose force grows by e in each ``scale`` rad has none where iterates of a whole step lead: parts of it have."""

    def stop(s: float, rate: float, t: float) -> float:
        return 10.0 * rate + 1e-3 * (1.0 - float(exp(max(-s, 0.0) / scale)))

    scene, _ = rod(1.0, 1.0, 0.0)
    del scene.forces["stop"]
    scene.add(fmbd.joint_spring("stop", fmbd.angle(scene.joints["pin"]), free=TOUCH, law=stop))
    with np.errstate(over="ignore"):
        run = fmbd.solve(scene, t_end=2.0, dt=0.05, scheme=scheme)
    assert 0 < run.counters["halved_steps"] < 40
    rest = TOUCH - scale * np.log(1.0 + 1e3 * 9.81 * 0.5 * np.cos(TOUCH))
    assert abs(run["phi"][-1, 0] - rest) < near + 0.01 * scale


def test_forces_beyond_all_numbers_are_those_of_a_step_that_diverged() -> None:
    """An iterate that ran away has no forces: parts of its step may have."""

    class Wild(Brittle):
        def advance(self, h: float) -> State:
            if h > self.longest:
                raise BalanceError(f"h = {h}")
            return super().advance(h)

    system, state = body()
    stepper = ConstantSteps(Wild(state, 0.3), system, lambda s: Wild(s, 0.3), None)
    assert stepper.advance(1.0).t == 1.0 and stepper.counters["halved_steps"] == 3


def test_the_error_is_that_of_the_whole_step() -> None:
    system, state = body()
    stepper = ConstantSteps(Brittle(state, 0.01), system, lambda s: Brittle(s, 0.01), None)
    with pytest.raises(
        ConvergenceError, match=r"h = 1\.0 Parts of this step fail too, down to 1/64 of it\. A scheme that"
    ):
        stepper.advance(1.0)
    late = ConstantSteps(Brittle(state, 1.0, 0.7), system, lambda s: Brittle(s, 1.0, 0.7), None)
    with pytest.raises(LinearSolveError, match=r"t = 1\.0 Parts"):
        late.advance(1.0)


def test_depth_counts_from_the_parts_that_every_step_gets() -> None:
    """After energy was gained all steps are made in halves: a part that fails may still be cut into 64."""
    system, state = body()
    stepper = ConstantSteps(Brittle(state, 0.01), system, lambda s: Brittle(s, 0.01), None)
    stepper.whole = 1
    assert stepper.advance(1.0).t == 1.0 and stepper.counters == {"made": 128, "halved_steps": 126}
    short = ConstantSteps(Brittle(state, 0.005), system, lambda s: Brittle(s, 0.005), None)
    short.whole = 1
    with pytest.raises(ConvergenceError, match=r"h = 0\.5 Parts of this step fail too, down to 1/128"):
        short.advance(1.0)


def test_a_worker_that_can_restart_stays_on_the_grid_under_guard() -> None:
    """Radau and BDF restart; with constant steps a part of a step that gained energy is no step."""
    system, state = body()
    stepper = ConstantSteps(Brittle(state, 0.3), system, lambda s: Brittle(s, 0.3), Watch(system, state))
    assert stepper.advance(1.0).t == 1.0
    assert stepper.evaluation is not None and stepper.evaluation.t == 1.0
    assert stepper.counters["energy_rejections"] == 0


def test_iterates_that_go_around_leave_no_trace() -> None:
    """An angle belongs to its configuration: what a diverging iteration visits does not change it."""
    scene, _ = rod(1e3, 1.0, 0.0)
    system, state, _ = scene.build()
    spring: Any = system.forces[0]

    def at(phi: float) -> float:
        xi = np.zeros(system.n_v)
        xi[2] = phi
        return float(spring.relative.values(system.at(0.0, system.compose(state.q, xi)).kin)[0])

    for k in range(1, 7):
        assert at(-1.1 * k) == pytest.approx(-1.1 * k)
    assert at(-0.1) == pytest.approx(-0.1)


def asked(kind: str) -> fmbd.Scene:
    """An arm on a hinge with a function of the user's own."""
    arm = fmbd.RigidBody("arm", 1.0, 0.1, position=(0.5, 0))
    hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
    phi, none = fmbd.angle(hinge), np.zeros(1)
    scene = fmbd.Scene("arm")
    scene.add(arm, hinge)
    scene.add(
        {
            "spring": lambda: fmbd.joint_spring("own", phi, law=lambda s, rate, t: -3.0 * s),
            "cases": lambda: fmbd.joint_spring("own", phi, law=lambda s, rate, t: float(round(s))),
            "force": lambda: fmbd.own_force("own", arm, None, lambda t, a: (-a.v, none)),
            "controller": lambda: fmbd.controller("own", reads={"s": phi}, acts=phi, law=lambda t, y, z: -y["s"]),
            "joint": lambda: fmbd.own_joint("own", fmbd.ground, arm, lambda xa, Ra, xb, Rb, t: [math.exp(xb[0]) - 1.0]),
        }[kind]()
    )
    return scene


@pytest.mark.parametrize("kind", ["spring", "cases", "force", "controller", "joint"])
def test_a_function_is_not_to_blame_where_an_iteration_has_run_away(kind: str) -> None:
    """Of no numbers it may make what it likes: the step has failed, and smaller ones are tried."""
    system, state, *_ = asked(kind).build()
    ev = system.at(0.0, state.q * np.nan, state.v)
    with pytest.raises(BalanceError, match="not finite.*own"):
        ev.wrenches(), ev.constraint()
