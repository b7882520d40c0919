"""Loads and drives that come and go: where they do, steps end.

Of a scene at rest any step is good, up to the whole run, and equal steps are what they are: a knock that comes and goes within
one is missed with any tolerance, so that runs with other ones agree, and state no error. With the state of the start held, loads
and what drives prescribe are functions of time, looked at where time goes on evenly and at instants that they name
(:mod:`.named_times`). Where they begin to change, and where they have changed most, a step has to end, and the error of that step
tells the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..rotations import Array
from ..schemes.declared import Declared
from ..system.compiled.choice import use_driver
from ..system.layout import State
from ..system.scene.scene import Scene
from ..system.system import System
from .accuracy.jumps_in_time import SEEN, HeldState, all_along, as_held, jumps_in_time, loads_vary
from .judges.energy_check import closed
from .named_times import named_times
from .schedule import StepSchedule, far_side, near_side

# even instants of a run; of elastic fields one costs as much as some iterations; and beside named ones that are what is asked
LOOKED_AT, OF_FIELDS, BESIDE_NAMED = 200, 50, 12
# change from one to the next, over the largest force, speed or acceleration, from which on something happens; and how many
# without one before that steps may have grown in
COMES, QUIET = 1e-3, 3
# times the largest rate of change between instants that are even, from which on nobody has seen it there; how often, at most:
# records of earthquakes do it all the time, and steps have to be small for them everywhere
STEEP, OFTEN = 2.0, 20
FEW_STEPS, PASSED = 8, 2  # equal ones: that a load which comes and goes is seen well by, and that may pass over one
GONE = 0.5  # of the largest change: what is left of a load that goes, at most
TOGETHER = 1e-6  # of the time between even instants: named ones that are nearer are one


@dataclass(frozen=True)
class Coming:
    """A load that changes between two instants, and those in between where it is seen first and has changed most (s); whether it
    ``goes``, back to nearly what it was.
    """

    begin: float
    marks: tuple[float, ...]
    end: float
    goes: bool

    @property
    def times(self) -> tuple[float, ...]:
        """All of them, ascending, s."""
        return tuple(sorted({self.begin, *self.marks, self.end}))


def seeing_loads(schedule: StepSchedule, scheme: Any, scene: Scene, system: System, state: State) -> StepSchedule:
    """A schedule whose steps, of a scheme's own choice, end where loads come; ``state``: the consistent start; collective.

    Schemes that look ahead themselves see what lasts: they are told of what comes and goes at named instants. What was found is
    kept with the system: runs with other tolerances begin in the same state.
    """
    if schedule.steps or closed(scene, system):
        return schedule
    told, known = Declared.by(scheme).looks_ahead, system.cache.get("loads to come")
    asked = told, schedule.stretches
    if known is None or known[0] is not state or known[1] != asked:
        known = system.cache["loads to come"] = state, asked, _marks(schedule, scheme, scene, system, state)
    return replace(schedule, marks=tuple(sorted({*schedule.marks, *known[2]})))


@as_held
def _marks(schedule: StepSchedule, scheme: Any, scene: Scene, system: System, state: State) -> tuple[float, ...]:
    """Where steps of a scheme's own choice end beside break points, s; see :func:`seeing_loads`."""
    said = Declared.by(scheme)
    if said.compiled:  # as its steps do
        use_driver(system)
    even = OF_FIELDS if system.fields else LOOKED_AT
    found = _all_comings(scene, HeldState(system, state), schedule, even, by_names=said.looks_ahead)
    return tuple(t for x in found if x.goes or not said.looks_ahead for t in x.marks)


@as_held
def loads_ahead(
    scene: Scene, scheme: Any, system: System, state: State, schedule: StepSchedule, within: float = FEW_STEPS
) -> tuple[float, ...]:
    """Instants (s) at which loads jump all along a run, and of equal steps those at which some have to end so that none passes
    over loads that come and go ``within`` so many, where both depend on time alone; collective.
    """
    if not loads_vary(scene, system):
        return ()
    held = HeldState(system, state, Declared.by(scheme).compiled)
    jumps = () if system.fields else jumps_in_time(held, all_along(schedule))  # of fields it costs as much as steps
    found = set(jumps)
    if schedule.steps:
        most = within * schedule.span / schedule.steps
        parts = max(round(LOOKED_AT / schedule.steps), 2)  # of steps, at whose ends jumps were looked for
        even = parts * schedule.steps
        for x in _all_comings(scene, held, schedule, even, by_names=bool(system.fields)):
            if x.goes and x.end - x.begin < most and not any(x.begin <= t <= x.end for t in jumps):
                found.update(jumps_in_time(held, [np.array(x.times)]) or x.times)
    return tuple(sorted(found))


def _all_comings(scene: Scene, held: HeldState, schedule: StepSchedule, even: int, *, by_names: bool) -> list[Coming]:
    """Loads that come in all stretches of a run, looked at so many ``even`` instants, and at those that they name; ``by_names``:
    at few even ones beside these, and none where loads name no instants.
    """
    named = named_times(scene, schedule.begin, schedule.t_end)
    if held.system.fields:
        named = held.system.comm.bcast(named)
    if by_names and not len(named):
        return []
    each = schedule.span / (BESIDE_NAMED if by_names else even)
    return [x for begin, end in schedule.stretches for x in comings(held, (begin, end), each, named)]


def comings(held: HeldState, within: tuple[float, float], each: float, named: Array) -> list[Coming]:
    """Loads that come between two times (s), looked at about ``each`` s and at ``named`` instants: where they begin to change
    after a while without, or far faster than even instants show, until they rest again; collective.
    """
    begin, end = within
    count = round((end - begin) / each)
    if count <= QUIET:  # steps do not grow much
        return []
    even = np.linspace(far_side(begin) if begin else 0.0, near_side(end), count + 1)
    times = _with(even, named, TOGETHER * each)
    rows = held.rows(times)
    scale = held.scale(rows)
    rate = held.change(rows[:-1], rows[1:], scale) / np.diff(times)
    seen = rows[np.searchsorted(times, even)]
    usual = float((held.change(seen[:-1], seen[1:], scale) / np.diff(even)).max())

    active = rate * np.maximum(np.diff(times), each) > COMES
    after_rest = _runs(active, times, (QUIET - 0.5) * each)
    steep = _runs(active & (rate > STEEP * usual), times)
    found = []
    for first, last in sorted({*after_rest, *(steep if len(steep) <= OFTEN else ())}):
        changed = held.change(np.tile(rows[first], (last - first, 1)), rows[first + 1 : last + 1], scale)
        most = first + 1 + int(changed.argmax())
        corners = _corners(held, times[first : last + 1], rows[first : last + 1], scale)
        marks = np.array([corners.get(0, times[first + 1]), corners.get(most - last - 1, times[most])])
        goes = bool(changed[-1] < GONE * changed.max())
        found.append(Coming(float(times[first]), tuple(marks[marks < times[-1]].tolist()), float(times[last]), goes))
    return found


def _corners(held: HeldState, times: Array, rows: Array, scale: Array) -> dict[int, float]:
    """Instants (s) at which a load that changes from the first to the last of some ``times`` begins to (0), or rests again (-1),
    with a corner: where the straight line through the two instants beside it meets the load at rest. What a corner within a step
    leaves is chance; a smooth change is seen by the error of the step. Collective.
    """
    found: dict[int, float] = {}
    for end, way in ((0, 1), (-1, -1)) if len(times) > QUIET else ():
        t, x = times[::way][:3], rows[::way][:3]
        slope, change = (x[2] - x[1]) / (t[2] - t[1]), x[1] - x[0]
        k = int(np.abs(change / scale).argmax())
        part = change[k] / (slope[k] * (t[1] - t[0])) if slope[k] else 0.0
        if not TOGETHER < part < 1.0 - TOGETHER:
            continue
        corner = t[1] - part * (t[1] - t[0])
        middle = 0.5 * (corner + t[1])
        straight = np.array((x[0], x[1] + slope * (middle - t[1])))
        if (held.change(held.rows(np.array((corner, middle))), straight, scale) <= SEEN).all():
            found[end] = float(corner)
    return found


def _with(even: Array, named: Array, least: float) -> Array:
    """Instants and those named between them, but for what is nearer to the one before than ``least`` (s)."""
    inside = named[(named > even[0]) & (named < even[-1])]
    inside = inside[np.diff(inside, prepend=-np.inf) > least]
    apart = np.abs(inside[:, None] - even[np.searchsorted(even, inside)[:, None] + [-1, 0]]).min(axis=1, initial=np.inf)
    return np.sort(np.concatenate((even, inside[apart > least])))


def _runs(active: np.ndarray, times: Array, rest: float = 0.0) -> list[tuple[int, int]]:
    """Numbers of the first instant, and of the last one, of runs of active intervals that come after a ``rest`` (s) at least."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], active, [False])))).reshape(-1, 2)
    rested = np.concatenate(([0], edges[:-1, 1]))[: len(edges)]
    return [(int(a), int(b)) for (a, b), since in zip(edges, rested, strict=True) if times[a] - times[since] >= rest]
