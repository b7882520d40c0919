"""What drives move in times to come, with the state held: mechanisms that they take from rest have no speed that tells a step."""

from __future__ import annotations

import numpy as np

from ..rotations import Array
from ..system.layout import State
from ..system.system import System

NEARER = 0.618 ** np.arange(40.0)  # of a span, where drives are looked at


def opened(system: System, state: State, times: Array) -> Array:
    """By how much constraints of a state that is held open from now until each of some times (k,) (s), (k, n_lam); collective."""
    held = [np.tile(x, (len(times) + 1, 1)) for x in (state.q, state.v)]
    now, *later = system.batch(np.append(state.t, times), *held).constraint()
    return np.array(later) - now


def openings(system: System, state: State, times: Array) -> Array:
    """The largest of these, (k,) m."""
    largest: Array = np.abs(system.row_units * opened(system, state, times)).max(axis=1, initial=0.0)
    return largest


def time_for_way(system: System, state: State, span: float, way: float) -> float:
    """The time (s), of at most ``span``, until which drives have moved nothing by more than a way (m); collective."""
    if not system.prescribes:
        return span
    gone = np.maximum.accumulate(openings(system, state, state.t + span * NEARER)[::-1])[::-1]
    passed = np.flatnonzero(gone <= way)
    return float(span * NEARER[passed[0] if len(passed) else -1])
