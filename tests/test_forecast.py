"""A run that will need very many steps says so after the first hundred, with the fastest period and its body."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.run.forecast import Forecast, fastest


def light_and_heavy(stiffness: float) -> fmbd.Scene:
    a = fmbd.RigidBody("light", 1e-3, 1e-7, position=(0.0, -1.0))
    b = fmbd.RigidBody("heavy", 1e3, 1e2, position=(0.0, -2.0))
    scene = fmbd.Scene("stiff", gravity=(0.0, -9.81))
    scene.add(a, b, fmbd.distance("rod", fmbd.ground, a, point_a=(0.0, 0.0), point_b=(0.0, -1.0), length=1.0))
    scene.add(fmbd.Spring("spring", a, b, (0.0, -1.0), (0.0, -2.0), stiffness=stiffness, length=1.0))
    return scene


def test_the_fastest_period_and_its_body() -> None:
    system, state, _ = light_and_heavy(1e10).build()
    solver = StepSolver(system)
    assert f'{2 * np.pi * np.sqrt(1e-3 / 1e10):.2g} s, of body "light"' in fastest(solver, state)
    solver.destroy()


@pytest.mark.parametrize("planned", [0, 100])
def test_said_once_where_it_is_many(planned: int, caplog: Any) -> None:
    """At 1e-7 s a step a second needs 1e7; at 1e-3 s nothing is said."""
    from dataclasses import replace

    system, state, _ = light_and_heavy(1e10).build()
    solver = StepSolver(system)
    with caplog.at_level(logging.WARNING, logger="fmbd_fenicsx"):
        calm = Forecast(solver, 0.0, 1.0, planned)
        for k in range(1, 301):
            calm.note(replace(state, t=1e-3 * k))
        assert not caplog.records
        slow = Forecast(solver, 0.0, 1.0, planned)
        for k in range(1, 301):
            slow.note(replace(state, t=1e-7 * k))
    assert len(caplog.records) == 1 and "about 1.0e+07" in caplog.text and "light" in caplog.text
    solver.destroy()


def test_small_steps_that_were_asked_for_are_no_news(caplog: Any) -> None:
    from dataclasses import replace

    system, state, _ = light_and_heavy(1e4).build()
    solver = StepSolver(system)
    with caplog.at_level(logging.WARNING, logger="fmbd_fenicsx"):
        asked = Forecast(solver, 0.0, 1.0, 1_000_000)
        for k in range(1, 301):
            asked.note(replace(state, t=1e-6 * k))
    assert not caplog.records
    solver.destroy()
