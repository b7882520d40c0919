"""Scenes of laws in Python, as functions of a system of units: see unit_scenes.py."""

from __future__ import annotations

from typing import Any

import numpy as np
from unit_scenes import ANGLE, LENGTH, MOMENT, Drawn, Units, arm, drawn

import fmbd_fenicsx as fmbd


def atoms(u: Units) -> Drawn:
    """Three atoms: a bond by its potential, another by a law of its length."""
    depth, size = u.of(2.0, *MOMENT), u.metres(1.0)

    def attraction(p: Any, q: Any, t: float) -> Any:
        square = (q.x - p.x) @ (q.x - p.x) / size**2
        return depth * (1 / square**3 - 2 / square**1.5)

    def morse(s: Any, rate: Any, t: float) -> Any:
        e = np.exp(-3 * (s / size - 1.0))
        return depth / size * 6 * (e - e * e)

    one = fmbd.PointMass(
        "one", u.of(1.0, 0, 1, 0), u.metres(0.0, 0.0, 0.0), velocity=tuple(u.of((0.0, 0.3, 0.0), 1, 0, -1))
    )
    two = fmbd.PointMass("two", u.of(2.0, 0, 1, 0), u.metres(1.2, 0.0, 0.0))
    three = fmbd.PointMass("three", u.of(0.5, 0, 1, 0), u.metres(1.2, 1.1, 0.3))
    bonds = fmbd.force_element("bond", one, two, attraction), fmbd.Spring("other", two, three, law=morse)
    made = drawn(u, "atoms", one, two, three, *bonds, gravity=None)
    made.sensor("one", fmbd.position(one), LENGTH)
    made.sensor("three", fmbd.position(three), LENGTH)
    return made


def own_law(u: Units) -> Drawn:
    """An arm under a controller that reads a place and a speed, and keeps an integral: stiffer with the way, bounded in speed."""
    one, pin = arm(u)
    metre, fast, torque = u.metres(1.0), u.of(1.0, 1, 0, -1), u.of(1.0, *MOMENT)

    def law(t: float, y: Any, z: Any) -> Any:
        x, w = y["place"][1] / metre, y["speed"][1] / fast
        return -torque * (300 * x + 100 * x**3 + 20 * np.tanh(w) + 40 * z[0] / u.of(1.0, 1, 0, 1)), (y["place"][1],)

    reads = {"place": fmbd.position(one), "speed": fmbd.velocity(one)}
    made = drawn(u, "own law", one, pin)
    made.scene.add(fmbd.controller("own", reads=reads, acts=fmbd.angle(pin), law=law, memory=(0.0,)))
    made.sensor("turn", fmbd.angle(pin), ANGLE)
    return made
