"""First steps of mechanisms that a drive takes from rest, which have neither speed nor acceleration."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from tolerance_scenes import fe_crank

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.schemes.prescribed_ways import openings, time_for_way


def turned(law: Any) -> fmbd.Scene:
    """A link of 0.5 m on a pin that a drive turns."""
    link = fmbd.RigidBody("link", 1.0, 0.1, position=(0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, link, center=(0.0, 0.0))
    scene = fmbd.Scene("driven")
    scene.add(link, pin, fmbd.drive("drive", fmbd.angle(pin), law))
    return scene


def test_the_time_of_a_way_is_that_of_the_drive() -> None:
    """By at most a golden section less; a drive that comes back has gone its way."""
    system, state, _ = turned(lambda t: t**5).build()
    unit = float(openings(system, state, state.t + np.ones(1))[0])  # of one radian, m
    found = time_for_way(system, state, 2.0, 0.01 * unit)
    assert 0.6 * 0.01**0.2 < found <= 0.01**0.2
    assert time_for_way(system, state, 0.1, 0.01 * unit) == 0.1

    away, start, _ = turned(lambda t: np.sin(np.pi * t) ** 2).build()
    assert time_for_way(away, start, 1.0, 0.1 * unit) < 0.12
    later = time_for_way(away, replace(start, t=0.5), 1.0, 0.1 * unit)
    assert later < 0.12


@pytest.mark.parametrize("scheme", [fmbd.Radau(3, rtol=1e-4), fmbd.Radau(5, rtol=1e-6)], ids=["3", "5"])
def test_a_drive_at_rest_tells_the_first_step(scheme: Any) -> None:
    """The whole run was tried, then half of it, and a quarter: four and three steps were refused."""
    run = fmbd.solve(fe_crank(), t_end=0.05, scheme=scheme)
    assert run.counters["rejections"] <= 1
