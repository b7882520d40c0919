"""The integral of a PID controller as compiled steps keep it, the structure PidMemory of ``tables.h``."""

from __future__ import annotations

import numpy as np

from ...mechanics.forces.formulas import MEMORY
from ...rotations import Array
from .control_memory import PAST, ControllerMemory
from .memory_points import PointMemories

HEAD = 7  # numbers before those of the past
STAGES = 7  # points at most


def integral_of(kept: ControllerMemory, points: PointMemories, reach: float, least: float) -> Array:
    """The numbers (1, MEMORY) of a memory, with what is known at points of the step under way; ``reach``: of its rate,
    ``least``: of its size.
    """
    out, count = np.zeros(MEMORY), len(kept.past)
    times, values, stages = out[HEAD:], out[HEAD + PAST :], out[HEAD + 2 * PAST :]
    out[:HEAD] = (*_numbers(kept.z, kept.rate), kept.t, max(kept.size[0], least), reach, count, kept.before[0])
    times[:count] = [t for t, _ in kept.past]
    values[:count] = [z[0] for _, z in kept.past]

    if points.kept is kept:
        known = len(points.t)
        stages[0] = known
        stages[1 : 1 + known] = points.t
        stages[1 + STAGES : 1 + STAGES + known] = points.z[:, 0]
    return out[None]


def memory_of(integral: Array, u: Array) -> ControllerMemory:
    """The memory of these numbers, with the efforts u."""
    z, rate, t, size, reach, count, before = (integral[0, i : i + 1].copy() for i in range(HEAD))
    times, values = np.split(integral[0, HEAD : HEAD + 2 * PAST], 2)
    past = tuple((float(at), values[i : i + 1].copy()) for i, at in enumerate(times[: int(count[0])]))
    return ControllerMemory(float(t[0]), z, rate, u, 0, past, before, size, reach)


def _numbers(*arrays: Array) -> list[float]:
    """Of arrays of one number."""
    return [float(x[0]) for x in arrays]
