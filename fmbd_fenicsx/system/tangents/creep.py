"""Whether Newton's iteration creeps: what has come loose moves on by slopes of what stuck, in increments that are far too small.

An increment has converged where it changes no effort N by slopes that the tangent does not have, or that it alone has:

    |k r . dq + c r . dv|  <=  1e-4 |N|        (k, c: the steeper of both where they differ by more than 3 %)

Compiled code does the same, ``compiled/driver/implicit/bends.c``; laws of a user's own are not judged.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...mechanics.forces.force_elements import ScalarLoads
from ...rotations import Array
from ..compiled.declarations import constants
from ..evaluation import Evaluation
from ..system import System
from .foretold_efforts import foretold_efforts

(SETTLED,) = constants("implicit/bends.c", "SETTLED")
(BENDS,) = constants("parts.h", "BENDS")


def laws_that_bend(system: System) -> list[ScalarLoads]:
    """Elements with efforts by formulas with a name."""
    return [f for f in system.forces if isinstance(f, ScalarLoads) and f.formulas()]


def creeps(system: System, tangent: Evaluation, points: Iterable[tuple[Evaluation, Array, Array]]) -> bool:
    """Whether increments of places and velocities, both like v, to these points are those of a tangent with other slopes."""
    bent = laws_that_bend(system)
    twists = foretold_efforts(system).twists
    for ev, dxi, dv in points:
        moved, faster = twists(ev, dxi), twists(ev, dv)
        for f in bent:
            known = np.concatenate([formula.which for formula in f.formulas()])
            k, c = (_steeper(*both) for both in zip(_slopes(f, known, tangent), _slopes(f, known, ev), strict=True))
            change = k * f.relative.along(ev.kin, moved)[known] + c * f.relative.along(ev.kin, faster)[known]
            efforts = np.abs(f.scalar(ev.kin, ev.t)[2])
            if (np.abs(change) > SETTLED * np.maximum(efforts[known], efforts.max())).any():
                return True
    return False


def _slopes(f: ScalarLoads, which: np.ndarray, ev: Evaluation) -> tuple[Array, Array]:
    """dN/ds and dN/ds' of some elements, (m,) each."""
    s, rate, _ = f.scalar(ev.kin, ev.t)
    return f.slopes(which, s[which], rate[which], ev.t)


def _steeper(one: Array, other: Array) -> Array:
    """The steeper of two slopes that differ, else 0."""
    steepest = np.where(np.abs(other) > np.abs(one), other, one)
    return np.where(np.abs(one - other) > BENDS * np.abs(steepest), steepest, 0.0)
