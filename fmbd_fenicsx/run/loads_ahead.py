"""Loads and drives that come while nothing happens: steps of a scheme's own choice end there.

Of a scene at rest any step is good, up to the whole run: a knock that comes and goes within one is missed with any tolerance,
so that runs with other ones agree, and state no error. With the state of the start held, loads and what drives prescribe are
functions of time. Where they begin to change, and where they have changed most, a step has to end, and the error of that step
tells the rest.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..log import log
from ..schemes.declared import Declared
from ..system.layout import State
from ..system.scene.scene import Scene
from ..system.system import System
from .accuracy.companion_runs import UNFIT
from .accuracy.jumps_in_time import HeldState
from .judges.energy_check import closed
from .schedule import StepSchedule, far_side, near_side

LOOKED_AT, OF_FIELDS = 200, 50  # instants of a run; of elastic fields one costs as much as some iterations
# change from one to the next, over the largest force, speed or acceleration, from which on something happens; and how many
# without one before that steps may have grown in
COMES, QUIET = 1e-3, 3


def seeing_loads(schedule: StepSchedule, scheme: Any, scene: Scene, system: System, state: State) -> StepSchedule:
    """A schedule whose steps, of a scheme's own choice, end where loads come; ``state``: the consistent start; collective.

    Not of schemes that look ahead themselves.
    """
    if schedule.steps or Declared.by(scheme).looks_ahead or closed(scene, system):
        return schedule
    held, each = HeldState(system, state), schedule.span / (OF_FIELDS if system.fields else LOOKED_AT)
    try:
        found = [t for stretch in schedule.stretches for t in comings(held, *stretch, each)]
    except UNFIT as error:
        log.info("loads to come are not looked for: %s", error)
        return schedule
    return replace(schedule, marks=tuple(sorted({*schedule.marks, *found})))


def comings(held: HeldState, begin: float, end: float, each: float) -> list[float]:
    """When loads come between two times (s), looked at about ``each`` s: where they begin to change after a while without, and
    where they have changed most until they rest again; collective.
    """
    count = round((end - begin) / each)
    if count <= QUIET:  # steps do not grow much
        return []
    times = np.linspace(far_side(begin) if begin else 0.0, near_side(end), count + 1)
    rows = held.rows(times)
    scale = held.scale(rows)
    active = held.change(rows[:-1], rows[1:], scale) > COMES

    found = []
    for first, last in _episodes(active):
        changed = held.change(np.tile(rows[first], (last - first, 1)), rows[first + 1 : last + 1], scale)
        found += [times[first + 1], times[first + 1 + int(changed.argmax())]]
    return [float(t) for t in found if t < times[-1]]


def _episodes(active: np.ndarray) -> list[tuple[int, int]]:
    """Numbers of the first instant, and of the one behind the last, of stretches of active intervals after quiet ones."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], active, [False])))).reshape(-1, 2)
    rested = np.concatenate(([0], edges[:-1, 1]))[: len(edges)]
    return [(int(a), int(b)) for (a, b), since in zip(edges, rested, strict=True) if a - since >= QUIET]
