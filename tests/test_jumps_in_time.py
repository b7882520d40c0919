"""Instants at which loads jump are found among those at which they are even, and little is asked of loads that are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.run.accuracy.search import jumps_in_time as looks
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
    found = looks.jumps_in_time(under(force), StepSchedule(1.0, STEPS))
    assert len(found) == len(when)
    np.testing.assert_allclose(found, when, rtol=0, atol=1e-14)


@pytest.mark.parametrize("force", [lambda t: t**3, lambda t: np.sin(9.0 * t), lambda t: np.exp(-t)])
def test_little_is_asked_of_even_loads(force: Callable[[float], float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the ends of steps one interval in eight, and those whose neighbours do not tell them."""
    asked, rows = [], looks.HeldState.rows
    monkeypatch.setattr(looks.HeldState, "rows", lambda held, t: (asked.append(len(t)), rows(held, t))[1])
    assert not looks.jumps_in_time(under(force), StepSchedule(1.0, STEPS))
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
