"""Where in a flight of the Moreau scheme slips turn about: friction turns there, and the flight ends.

A slip s that comes to rest in a flight of length h, by the law at its end, may stay at rest or begin anew the other way. In the
first case one impulse of friction is right; in the second it would hold the contact still until the end of the flight, an error
of its velocity of first order. Which of them it is tells the same problem of forces with that slip left out at the start,

    U' = U - s,   under forces f' of the law:    the contact turns about where it slides, |U'| > 0                      (1)

A slip that still goes on at a share r of the flight, with a part l of it left, ends at r / (1 - l) along a straight line, which
slips follow while friction does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array
from ...system.compiled.declarations import constants, enumeration

if TYPE_CHECKING:
    from .moreau_step import MoreauStep

# of a slip: what is left where it has stopped; of what a contact wins from rest: a slip that is rest, and by how much of its time
# a flight ends behind the stop; attempts to end a flight there
STOPPED, RESTS = constants("impacts/turns.c", "STOPPED", "RESTS")
TRIALS = enumeration("TRIALS", "impacts/turns.c")["TRIALS"]


def turned(step: MoreauStep, slow: float, solved: Callable[[float], MoreauStep]) -> MoreauStep:
    """A solved flight, or a shorter one that ends where the first of its slips turns about.

    ``slow``: speed (m/s) that is none; ``solved``: the flight of a length (s) with the same contacts.
    """
    if not step.flies or step.rows is None or step.rows.components == 1:
        return step
    turns, share = _turning(step, slow)
    whole, stopped, foretold = step.h, 1.0, False

    for trial in range(TRIALS + 1):
        if share >= 1.0:
            break
        step = solved(share * whole)
        left = float(_slips_left(step)[turns].min())
        if trial == TRIALS or (foretold and left <= STOPPED):
            break
        foretold = left > STOPPED
        if foretold:
            share = min(stopped, (1.0 + RESTS) * share / (1.0 - left)) if left < 1.0 else stopped
        else:
            stopped, share = share, 0.5 * share
    return step


def _turning(step: MoreauStep, slow: float) -> tuple[np.ndarray, float]:
    """Which closed contacts (m,) turn about by (1), and a share of the flight at which the first has stopped for sure, at most 1/2
    (1: none turns).
    """
    assert step.rows is not None
    stops = (step.rows.friction > 0.0) & ~step.bouncing[step.closed] & (_slips_left(step) <= STOPPED)
    if not stops.any():
        return stops, 1.0

    start = np.where(stops[:, None], step.slips, 0.0)
    opening = step.openings
    opening[:, 1:] -= start
    try:
        won = np.linalg.norm(step.contact.opened(opening)[:, 1:], axis=1)
    except ConvergenceError:
        return np.zeros_like(stops), 1.0
    slip = np.linalg.norm(start, axis=1)
    turns = stops & (won > slow) & (slip > RESTS * won)
    return turns, float(np.minimum(0.5, slip[turns] / won[turns]).min(initial=1.0))


def _slips_left(step: MoreauStep) -> Array:
    """What is left of the slips (m,) of closed contacts at the end of a flight, along those at its start and as shares of them."""
    size = np.einsum("mk,mk->m", step.slips, step.slips)
    ends = np.einsum("mk,mk->m", step.slips, step.openings[:, 1:])
    return np.divide(ends, size, out=np.ones_like(ends), where=size > 0.0)
