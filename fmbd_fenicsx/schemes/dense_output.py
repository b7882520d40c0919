"""States within a step from those at its ends.

Positions follow a cubic in the local coordinates of the step's start, accelerations and multipliers the straight lines between
their ends, and velocities too where a scheme does not know better.
"""

from __future__ import annotations

from dataclasses import replace

from ..rotations import Array
from ..system.layout import State
from ..system.system import System

Pair = tuple[Array, Array]  # at the two ends of a step


def cubic(x: float, h: float, ends: Pair, slopes: Pair) -> Array:
    """The value at the share x of a step of size h (s) of the cubic with these values and slopes at its ends."""
    (a, b), (at_a, at_b) = ends, slopes
    y = 1 - x
    return y * y * (1 + 2 * x) * a + x * x * (3 - 2 * x) * b + x * y * h * (y * at_a - x * at_b)


def place_within(system: System, before: State, after: State, t: float, slopes: Pair) -> Array:
    """q at a time t (s) between two states; ``slopes``: velocities, (n_v,) each, that positions have at the ends."""
    h = after.t - before.t
    moved = system.difference(before.q, after.q)
    local = slopes[0], system.rate(moved, slopes[1])
    return system.compose(before.q, cubic((t - before.t) / h, h, (0.0 * moved, moved), local))


def state_within(before: State, after: State, t: float, q: Array) -> State:
    """The state at a time t (s) with this q; all else from the straight lines between its ends."""
    x = (t - before.t) / (after.t - before.t)

    def line(a: Array, b: Array) -> Array:
        return (1 - x) * a + x * b

    v, a, lam = line(before.v, after.v), line(before.a, after.a), line(before.lam, after.lam)
    return replace(after, t=t, q=q, v=v, a=a, lam=lam)
