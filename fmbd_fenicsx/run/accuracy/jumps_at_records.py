"""Records of velocities beside impacts: which side of one they are on is known no better than its instant."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...rotations import Array
from ..recording.recorder import Recorder

WIDER = 1.0 + 1e-6  # impacts in the middle of steps are off by half of one, up to its ends
BESIDE = 2  # records that an impact is thought to be on the wrong side of at most: of more, differences of runs tell


def instants_off(given: Recorder, other: Recorder, share: float) -> tuple[Array, Array]:
    """Instants of the impacts of a run, and what they are off (s): a ``share`` of the way to the nearest one of another run."""
    at, there = given.struck, other.struck
    if not (len(at) and len(there)):
        return np.zeros(0), np.zeros(0)
    behind = np.searchsorted(there, at)
    near = np.minimum(*(np.abs(at - there[k.clip(0, len(there) - 1)]) for k in (behind, behind - 1)))
    return at, WIDER * share * near


def jumps_at_records(
    sensors: Iterable[str], made: Recorder, struck: tuple[Array, Array]
) -> dict[str, tuple[float, float]]:
    """Sensor of velocities, or of what follows from them -> the record (s) that is nearer to an impact than its instant is known
    and jumps most there, and by how much: by what the value on the other side is off the line that its own side leads on.
    """
    times, found = made.times, dict[str, tuple[float, float]]()
    at, off = struck
    first, end = np.searchsorted(times, at - off, "right"), np.searchsorted(times, at + off)
    for k in np.flatnonzero((first < end) & (end - first <= BESIDE)):
        for row in range(max(first[k], 1), min(end[k], len(times) - 1)):
            side = 1 if times[row] <= at[k] else -1
            for name in sensors:
                if made.scene.sensors[name].derivative:
                    x = made.series[name]
                    jump = float(np.abs(x[row + side] - 2.0 * x[row] + x[row - side]).max(initial=0.0))
                    found[name] = max(found.get(name, (0.0, 0.0)), (float(times[row]), jump), key=lambda one: one[1])
    return found
