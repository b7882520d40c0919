"""States within a step from those at its ends: of one step, or of many with the step as the first axis.

Positions follow a cubic in the local coordinates of the step's start; accelerations and multipliers, and velocities where a
scheme does not know better, parabolas through both ends and the beginning of the step before. Straight lines are as far off as
the steps of most schemes, by where in a step an instant falls: what runs with other steps tell by chance.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from ..rotations import Array
from ..system.layout import State, States
from ..system.system import System

Pair = tuple[Array, Array]  # at the two ends of a step
Some = TypeVar("Some", State, States)


def cubic(x: Any, h: Any, ends: Pair, slopes: Pair) -> Array:
    """The value at the share x of a step of size h (s) of the cubic with these values and slopes at its ends."""
    (a, b), (at_a, at_b) = ends, slopes
    y = 1 - x
    found: Array = y * y * (1 + 2 * x) * a + x * x * (3 - 2 * x) * b + x * y * h * (y * at_a - x * at_b)
    return found


def place_within(system: System, before: Some, after: Some, t: Any, slopes: Pair) -> Array:
    """q at a time t (s) between two states; ``slopes``: velocities, (.., n_v) each, that positions have at the ends."""
    h = after.t - before.t
    moved = system.difference(before.q, after.q)
    local = slopes[0], system.rate(moved, slopes[1])
    return system.compose(before.q, cubic((t - before.t) / h, h, (0.0 * moved, moved), local))


def state_within(before: Some, after: Some, t: Any, q: Array, earlier: Some | None = None) -> Some:
    """The state at a time t (s) with this q; all else from the parabolas through its ends and the ``earlier`` one, from which the
    step before led to its beginning, or from straight lines where there is none, or nan.
    """
    h: Any = after.t - before.t
    x, y = (t - before.t) / h, (after.t - t) / h

    def bent(a: Array, b: Array, past: Array) -> Array:
        line: Array = y * a + x * b
        if earlier is None:
            return line
        slopes = (b - a) / h, (a - past) / (before.t - earlier.t)
        bend = x * y * h * h * (slopes[0] - slopes[1]) / (after.t - earlier.t)
        return line - np.where(np.isnan(earlier.t), 0.0, bend)

    begin = earlier or before
    v, a, lam = (
        bent(before.v, after.v, begin.v),
        bent(before.a, after.a, begin.a),
        bent(before.lam, after.lam, begin.lam),
    )
    return replace(after, t=t, q=q, v=v, a=a, lam=lam)


def within(system: System, before: Some, after: Some, t: Any, earlier: Some | None = None) -> Some:
    """The state at a time t (s) of a scheme that says nothing of its own."""
    q = place_within(system, before, after, t, (before.v, after.v))
    return state_within(before, after, t, q, earlier)
