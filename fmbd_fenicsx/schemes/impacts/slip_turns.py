"""Slips that turn about in a flight of the Moreau scheme: friction acts against what a contact wins behind its stop, too.

A slip s that the law at the end of a flight, (4) of :mod:`.moreau`, brings to rest may stay there, or begin anew the other way.
In the first case the impulse of friction is right; in the second it holds the contact still until the end, an error of its
velocity of first order. Which of them it is tells the same problem of forces with other slips b s at the start,

    U(b) = U + (b - 1) s + W (f(b) - f),   f(b) by the law;    the contact turns about where U(0) != 0                  (1)

With a slip so large that it goes on, it is braked by U(b) - b s. So it is at rest at the share r of the flight, and wins the rest
of U(0) behind it,

    r = - s . s / s . (U(b) - b s),       U_1 = (1 - r) U(0)                                                            (2)

so the flight is solved once more with that end in place of rest. The times of several stops are found apart from each other, and
only where up to ``COUPLED`` contacts move each other: in heaps slips turn in each step, and none tells what the heap does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array
from ...system.compiled.declarations import constants, enumeration

if TYPE_CHECKING:
    from .moreau_step import MoreauStep

# of a slip: what is left where it has stopped; of what a contact wins from rest: a slip that is rest; slips that go on, in slips
STOPPED, RESTS, ON = constants("impacts/turns.c", "STOPPED", "RESTS", "ON")
COUPLED = enumeration("COUPLED", "impacts/turns.c")["COUPLED"]


def won_behind_stops(step: MoreauStep, slow: float) -> Array | None:
    """(1 - r) U(0) of (2) for the closed contacts (m, d - 1) of a solved flight, zero where slips do not turn about.

    None where none does. ``slow``: speed (m/s) that is none.
    """
    if not step.flies or step.rows is None or step.rows.components == 1:
        return None
    opening, slips = step.openings, step.slips
    size = np.einsum("mk,mk->m", slips, slips)
    left = np.einsum("mk,mk->m", slips, opening[:, 1:])
    stops = (step.rows.friction > 0.0) & ~step.bouncing[step.closed] & (size > 0.0) & (left <= STOPPED * size)
    if stops.any():
        stops &= step.contact.sizes_of_groups() <= COUPLED
    if not stops.any():
        return None

    def ends(factor: float) -> Array:
        """Slips (m, d - 1) at the end of the flight, of those that stop with so many times their slip at its start."""
        at = opening.copy()
        at[stops, 1:] += (factor - 1.0) * slips[stops]
        return step.contact.opened(at)[:, 1:]

    try:
        won, slope = ends(0.0), ends(ON) - ON * slips
    except ConvergenceError:
        return None
    most, braked = np.einsum("mk,mk->m", won, won), -np.einsum("mk,mk->m", slips, slope)
    turns = stops & (most > slow**2) & (size > RESTS**2 * most) & (braked > size)
    if not turns.any():
        return None
    share = np.divide(size, braked, out=np.ones_like(size), where=turns)
    return (1.0 - share)[:, None] * won
