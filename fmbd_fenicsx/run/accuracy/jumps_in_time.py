"""Instants at which loads and drives jump that no break point names: equal steps that end there keep their order.

A jump within a step leaves an error of first order, so that a tolerance of 1e-4 takes thousands of steps. Where it depends on
time alone it is found to roundoff: with a state held, forces and what drives prescribe are functions of time, and of the two
halves of an interval with a jump one holds nearly all of the change, however often it is halved; of smooth change it holds half.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import ParamSpec, Protocol

import numpy as np

from ...log import log
from ...rotations import Array
from ...schemes.declared import Declared
from ...system.compiled.choice import use_driver
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.system import System
from ..judges.energy_check import closed
from ..result import Run
from ..schedule import SIDE, StepSchedule, far_side, near_side
from .certificate import about_kinks, struck_or_sampled
from .companion_runs import UNFIT

MOST, USUAL = 1000, 100  # intervals of a run that are looked at, at most, and where steps are not known
HALVINGS = 64  # to roundoff of any time, from any interval
HALF = 0.4871  # of an interval: its middle may be the very instant of a jump, where sign(0) is far from either side
JUMPS = 0.6  # share of the change in an interval that its half with a jump has
SEEN = 1e-7  # change over the largest force, speed or acceleration below which it is none
UNEVEN = 0.3  # share of the change in an interval that its neighbours do not tell, from which on it may hold a jump
SAMPLED = 8  # one in so many of the others is looked at, too
AT_ONCE = 2e6  # numbers of an evaluation at many instants

Given = ParamSpec("Given")


def as_held(find: Callable[Given, tuple[float, ...]]) -> Callable[Given, tuple[float, ...]]:
    """What finds instants (s) with a state held: none where loads and drives have no value in it."""

    @wraps(find)
    def found(*given: Given.args, **more: Given.kwargs) -> tuple[float, ...]:
        try:
            return find(*given, **more)
        except UNFIT as error:
            log.info("where loads jump, or come and go, is not looked for: %s", error)
            return ()

    return found


class TimeRows(Protocol):
    """What is looked at for jumps: functions of time, their scale, and how much they change by it, as :class:`HeldState`."""

    def rows(self, times: Array) -> Array:
        """All of them at given times, (n,) -> (n, rows)."""

    def scale(self, rows: Array) -> Array:
        """For each of the rows."""

    def change(self, a: Array, b: Array, scale: Array) -> Array:
        """The largest change of each of several rows."""


@dataclass(frozen=True)
class HeldState:
    """Forces, and rates that drives prescribe, as functions of time alone: those of a system with a state held, ``known`` at the
    times (s) that were asked for. ``compiled``: the driver is to tell them, whose tables are made when they are asked for.
    """

    system: System
    state: State
    compiled: bool = False
    known: dict[float, Array] = field(default_factory=dict)

    def rows(self, times: Array) -> Array:
        """All of them at given times (s) as forces, speeds and accelerations, (n,) -> (n, rows); collective."""
        at = [float(t) for t in times]
        asked = np.array([t for t in at if t not in self.known])
        pieces = np.array_split(asked, 1 + int(len(asked) * len(self.state.v) / AT_ONCE))
        for piece in pieces if len(asked) else ():
            self.known.update(zip(map(float, piece), self._rows(piece), strict=True))
        return np.array([self.known[t] for t in at])

    def _rows(self, times: Array) -> Array:
        system = self.system
        if self.compiled:
            use_driver(system)
        q, v = (np.tile(x, (len(times), 1)) for x in (self.state.q, self.state.v))
        seen = system.batch(times, q, v)
        forces = seen.balance(np.zeros_like(v)) / system.units
        if not system.prescribes:  # to make rows of joints costs as much again
            return np.concatenate((forces, np.zeros((len(times), 2 * system.n_lam))), axis=1)
        return np.concatenate((forces, *(system.row_units * x for x in (seen.opening(), seen.gamma()))), axis=1)

    def scale(self, rows: Array) -> Array:
        """The largest force, speed and acceleration of all times and rows, for each of the rows; collective."""
        n = self.system.n_v, self.system.n_lam, self.system.n_lam
        kinds = np.split(np.abs(rows), np.cumsum(n)[:-1], axis=1)
        most = self._of_all_ranks(np.array([x.max(initial=0.0) for x in kinds]))
        return np.repeat(np.where(most > 0.0, most, 1.0), n)

    def change(self, a: Array, b: Array, scale: Array) -> Array:
        """The largest change of each of several rows, over their scale; collective."""
        return self._of_all_ranks((np.abs(b - a) / scale).max(axis=1, initial=0.0))

    def _of_all_ranks(self, x: Array) -> Array:
        return np.max(self.system.comm.allgather(x), axis=0) if self.system.fields else x  # type: ignore[no-any-return]


def jumps_in_time(held: TimeRows, stretches: Iterable[Array]) -> tuple[float, ...]:
    """Instants (s) at which forces or drives jump, between the times of each of some stretches, ascending (n,); collective."""
    return tuple(t for times in stretches for t in _within(held, times))


def all_along(schedule: StepSchedule) -> list[Array]:
    """Ends of steps, or :data:`USUAL` instants where a scheme chooses them, between the break points that are known, s."""
    return instants(schedule, schedule.steps or USUAL)


def instants(schedule: StepSchedule, intervals: int) -> list[Array]:
    """The ends of so many intervals in all, :data:`MOST` at most between two break points that are known, s."""
    found = []
    for begin, end in schedule.stretches:
        count = int(np.clip(round(intervals * (end - begin) / schedule.t_end), 1, MOST))
        found.append(np.linspace(far_side(begin) if begin else 0.0, near_side(end), count + 1))
    return found


def _within(held: TimeRows, times: Array) -> list[float]:
    """The same in the intervals between some times, one in each at most.

    Those that change as their neighbours do are looked at one in :data:`SAMPLED` only, and all where that shows a jump: steps of
    a staircase look even, one in each interval.
    """
    rows = held.rows(times)
    scale = held.scale(rows)
    whole = held.change(rows[:-1], rows[1:], scale)
    uneven = held.change(_as_neighbours_do(rows), np.diff(rows, axis=0), scale) > UNEVEN * whole
    wanted = uneven | (np.arange(len(whole)) % SAMPLED == 0)

    found = _halved(held, Intervals.of(times, rows, (whole > SEEN) & wanted), scale)
    if any(not uneven[k] for k in found):
        found |= _halved(held, Intervals.of(times, rows, (whole > SEEN) & ~wanted), scale)
    return [found[k] for k in sorted(found)]


def _as_neighbours_do(rows: Array) -> Array:
    """The change in each of several intervals that the cubic through those of its two neighbours on each side has in it, of the
    first and last two intervals none: (n + 1, rows) -> (n, rows).
    """
    change = np.diff(rows, axis=0)
    expected = np.zeros_like(change)
    if len(change) > 4:
        expected[2:-2] = (4.0 * (change[1:-3] + change[3:-1]) - change[:-4] - change[4:]) / 6.0
    return expected


@dataclass(frozen=True)
class Intervals:
    """Their numbers, ends (s), and the rows there."""

    at: np.ndarray
    low: Array
    high: Array
    before: Array
    behind: Array

    @classmethod
    def of(cls, times: Array, rows: Array, wanted: np.ndarray) -> Intervals:
        """Those wanted (n,) between some times (n + 1,)."""
        (at,) = np.nonzero(wanted)
        return cls(at, times[at], times[at + 1], rows[at], rows[at + 1])

    def only(self, kept: np.ndarray) -> Intervals:
        """Some of them."""
        return Intervals(*(x[kept] for x in (self.at, self.low, self.high, self.before, self.behind)))


def _halved(held: TimeRows, x: Intervals, scale: Array) -> dict[int, float]:
    """Number of an interval with a jump -> when (s)."""
    whole = held.change(x.before, x.behind, scale)
    for _ in range(HALVINGS):
        middle = x.low + HALF * (x.high - x.low)
        if not ((x.low < middle) & (middle < x.high)).any():
            break
        between = held.rows(middle)
        first, second = held.change(x.before, between, scale), held.change(between, x.behind, scale)

        # on into the half that changes more, where this is nearly all of the change
        early = first > second
        ends = np.where(early, (x.low, middle), (middle, x.high))
        rows = np.where(early[:, None], (x.before, between), (between, x.behind))
        # between the last numbers that instant is met
        kept = (np.maximum(first, second) > JUMPS * whole) | (x.high - x.low <= SIDE * np.spacing(x.high))
        whole, x = whole[kept], Intervals(x.at, *ends, *rows).only(kept)
    return {int(k): float(t) for k, t in zip(x.at, x.high, strict=True)}


def loads_vary(scene: Scene, system: System) -> bool:
    """Whether loads and drives may be functions of time alone that jump: not where velocities jump. What gets no energy knows no
    time, and a ramp of gravity is smooth.
    """
    return not (struck_or_sampled(scene) or closed(scene, system, ramped=True))


@as_held
def jumps_about_kinks(run: Run, schedule: StepSchedule, sensors: Iterable[str]) -> tuple[float, ...]:
    """Jumps within the equal steps of a run about the kinks of some sensors: those of slow motion in large steps are not seen;
    collective.
    """
    if not schedule.steps or closed(run.scene, run.system):
        return ()
    stretches = [times for name in sensors for times in about_kinks(run, name)]
    held = HeldState(run.system, run.state, Declared.by(run.scheme).compiled)
    return tuple(sorted({*jumps_in_time(held, stretches)}))


def with_break_points(scene: Scene, more: tuple[float, ...]) -> Scene:
    """The scene with further break points (s)."""
    return replace(scene, breakpoints=tuple(sorted({*scene.breakpoints, *more})))
