"""Where the steps of a run end: equal ones, or as the error control of the scheme likes, hitting break points and the end
exactly.

At a break point x the solution may have a kink. Steps end a little before it and the next ones begin a little behind it, so
that forces are those of either side however they are written: t < x or t <= x. Equal steps are a stretch of their own between
two break points, of a size that fits: as near to the one that is asked for as whole numbers of steps allow, and not above it.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np

from ..checks import number
from ..errors import InputError, require
from ..log import log
from ..rotations import Array
from ..schemes.declared import Declared
from ..system.scene.scene import Scene

SIDE = 16  # roundings of time between a break point and either side of it
# roundings of the latest time: break points that are nearer to each other, or to the ends of the run, are one; of what acts
# between two that are nearer than SHARP, more than a millionth is lost beside them
TOGETHER, SHARP = 2.0**15, 2.0**25
SAME = 1e-12  # share by which the sizes of steps of two stretches differ by roundoff: one factor serves both
MOST_SAMPLES = 1e7  # of a controller in a run whose steps end at each: a list of them fills the memory
MANY = 2.0  # times as many equal steps as without break points, from which on it is said


@dataclass(frozen=True)
class StepSchedule:
    """Where the steps of a march end: ``steps`` equal ones, or (0) as the scheme likes, hitting each of ``stops``, at which the
    solution may have a kink, each of ``marks``, at which it goes on, and the end. They ``begin`` at a time (s).

    ``counts``: of equal steps up to each stop, and from the last one to the end. ``largest``: what steps were to be at most, s.
    ``given``: steps that the scheme would choose end at stops and marks alone, whatever their errors are.
    """

    t_end: float
    steps: int
    stops: tuple[float, ...] = ()
    largest: float = np.inf
    marks: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()
    begin: float = 0.0
    given: bool = False

    def next(self, t: float) -> float:
        """Size of the next step, or the most it may be (s). Steps end a few roundings before a break point: on its near side."""
        if self.steps:
            return self._sizes[bisect_right(self.stops, t)] if self.stops else self._even
        return min(self.ends(t)[0] - t, self.largest)

    def ends(self, t: float) -> tuple[float, ...]:
        """Where steps that the scheme chooses have to end from a time on, rising (s): marks, then the near side of the next break
        point, or the end of the march.
        """
        (stops, reached), (marks, passed) = self._reached
        i = bisect_right(reached, t)
        last = stops[i] if i < len(stops) else self.t_end
        return (*marks[bisect_right(passed, t) : bisect_left(marks, last)], last)

    def below(self, size: float) -> StepSchedule:
        """The schedule with steps of a scheme's choice that are none above a size, s."""
        return replace(self, largest=min(self.largest, size))

    def left(self, done: int) -> int:
        """How many equal steps of one size there are after so many."""
        return self._ends[bisect_right(self._ends, done)] - done if self.stops else self.steps - done

    def broken(self, t: float, done: int = 0) -> float | None:
        """The far side of the break point that a step has just reached: the time at which the march goes on behind it."""
        if self.steps:
            i = bisect_left(self._ends, done)
            return far_side(self.stops[i]) if i < len(self.stops) and self._ends[i] == done else None
        i = bisect_left(self.stops, t - 8 * SIDE * np.spacing(t))
        near = self.stops[i : i + 1]
        return next((far_side(x) for x in near if abs(t - x) <= 4 * SIDE * np.spacing(x)), None)

    def ended(self, t: float, done: int) -> bool:
        """Whether the march is over."""
        return done >= self.steps if self.steps else t >= self.t_end * (1 - 1e-12)

    def reached(self, t: float) -> int:
        """How many of the equal steps end at a time t (s) or before."""
        if not self.stops:
            return round((t - self.begin) * self.steps / self.span)
        i = bisect_right(self.stops, t)
        begun = self.stops[i - 1] if i else self.begin
        return (0, *self._ends)[i] + round((t - begun) / self._sizes[i])

    def with_steps(self, steps: int) -> StepSchedule:
        """Other equal steps for the same run: so many, shared out among its stretches as they are here."""
        if not self.stops:
            return StepSchedule(self.t_end, steps, begin=self.begin)
        counts = tuple(max(round(n * steps / self.steps), 1) for n in self.counts)
        return StepSchedule(self.t_end, sum(counts), self.stops, counts=counts, begin=self.begin)

    @property
    def fitting(self) -> float | tuple[float, ...] | None:
        """What a run has to have in common with one that it goes on with: its sizes of equal steps (s)."""
        if not self.steps:
            return None
        sizes = tuple(float(f"{x:.12g}") for x in (self._sizes if self.stops else [self._even]))
        return sizes[0] if not self.stops else tuple(sorted({float(f"{x:.9g}") for x in sizes}))

    @property
    def given_sizes(self) -> Array:
        """Of steps that end at stops and marks alone, s."""
        return np.diff(sorted({self.begin, *self.stops, *self.marks, self.t_end}))

    @property
    def span(self) -> float:
        """How long the march is, s."""
        return self.t_end - self.begin

    @cached_property
    def stretches(self) -> tuple[tuple[float, float], ...]:
        """Times (s) between which the solution is smooth, as far as break points tell."""
        places = (self.begin, *self.stops, self.t_end)
        return tuple(zip(places[:-1], places[1:], strict=True))

    @cached_property
    def _reached(self) -> list[tuple[list[float], list[float]]]:
        """The near sides of stops, then of marks, each with the times from which on a march has reached them, s."""
        inside = [np.array([t for t in x if t < self.t_end]) for x in (self.stops, self.marks)]
        return [((x - SIDE * np.spacing(x)).tolist(), (x - 4 * SIDE * np.spacing(x)).tolist()) for x in inside]

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        """Numbers of the equal steps at which stretches end."""
        return tuple(accumulate(self.counts))

    @cached_property
    def _even(self) -> float:
        """The size of equal steps without stops (s): the one that was asked for, where it fits but for roundoff, so that it does
        not hang on when the march ends.
        """
        fitted = self.span / self.steps
        return self.largest if abs(self.largest - fitted) <= SAME * fitted else fitted

    @cached_property
    def _sizes(self) -> tuple[float, ...]:
        """Sizes of the equal steps of each stretch (s): their sum ends on the near side of the break point, roundoff included."""
        exact = []
        for (begin, end), count in zip(self.stretches, self.counts, strict=True):
            till = end if end == self.t_end else end - (SIDE + count) * np.spacing(end)
            exact.append(float(till - (begin if begin == self.begin else far_side(begin))) / count)

        known: list[float] = []
        for h in sorted(exact):
            if not known or h - known[-1] > SAME * h:
                known.append(h)
        return tuple(known[bisect_right(known, h) - 1] for h in exact)


def near_side(stop: float) -> float:
    """Just before a break point, s."""
    return float(stop - SIDE * np.spacing(stop))


def far_side(stop: float) -> float:
    """Just behind a break point, s."""
    return float(stop + SIDE * np.spacing(stop))


def step_schedule(
    scene: Scene, scheme: Any, t_end: float, dt: float | None, *, multiple: int = 1, at_samples: bool = False
) -> StepSchedule:
    """Steps of equal size, none above dt (but for roundoff), a ``multiple`` of them between break points; or none for error
    control.

    Samples of controllers are break points, too, where steps of other sizes will be compared with these (``at_samples``), or a
    ``multiple`` is wanted and steps of one size do not end at them.
    """
    begin = scene.begins
    t_end = number("End time t_end =", t_end, above=begin, unit="s")
    if dt is not None:
        dt = number("Step dt =", dt, above=0.0, unit="s")
        span = t_end - begin
        require(dt <= span * (1 + 1e-9), f"Step dt = {dt} s is larger than the whole run, {begin:g} to {t_end} s.")
        require(t_end + dt > t_end, f"Step dt = {dt} s is below the roundoff of t_end = {t_end} s: t + h == t.")

    if Declared.by(scheme).adaptive:
        require(
            multiple == 1,
            "estimate_error needs constant steps; with error control compare two values of rtol (study.py).",
        )
        return StepSchedule(t_end, 0, _apart(scene, t_end), np.inf if dt is None else dt, begin=begin)
    if dt is None:
        raise InputError(f"{scheme.name} takes constant steps: give dt (s). Schemes with rtol choose their own.")

    named = any(begin < t < t_end for t in scene.breakpoints)
    for groups in () if named or at_samples else dict.fromkeys((multiple, 1)):
        made = StepSchedule(t_end, _count(t_end - begin, dt, groups), largest=dt, begin=begin)
        if multiple == 1 or not sampled_late(scene, made):
            return made
    stops = _apart(scene, t_end)
    places = (begin, *stops, t_end)
    counts = tuple(_count(b - a, dt, multiple) for a, b in zip(places[:-1], places[1:], strict=True))
    return StepSchedule(t_end, sum(counts), stops, dt, counts=counts if stops else (), begin=begin)


def _count(length: float, dt: float, multiple: int) -> int:
    """How many equal steps there are in a stretch (s): its length over dt, a whole number but for roundoff, or the next above."""
    steps = max(1, round(length / dt))
    if abs(steps * dt - length) > 1e-9 * length:
        steps = int(np.ceil(length / dt))
    groups = -(-steps // multiple)
    return groups * multiple


def stops_within(scene: Scene, t_end: float) -> tuple[float, ...]:
    """Times inside a run at which the solution may have a kink: break points, and samples of controllers."""
    periods = {float(force.period): name for name, force in scene.forces.items() if force.period is not None}
    for period, name in periods.items():
        require(
            t_end <= MOST_SAMPLES * period,
            f'Controller "{name}" samples every {period:g} s, {t_end / period:.3g} times up to t_end = {t_end:g} s (is one of '
            "them in another unit?), and steps end at each. Take a shorter run, or a scheme of equal steps with a dt that "
            "divides the period.",
        )
    samples = [period * np.arange(1, int(np.ceil(t_end / period))) for period in periods]
    times = np.unique(np.concatenate([np.array(scene.breakpoints, dtype=float), *samples]))
    return tuple(times[(times > scene.begins) & (times < t_end)].tolist())


def _apart(scene: Scene, t_end: float) -> tuple[float, ...]:
    """The stops within a run without those that are :data:`TOGETHER` with the one before, or with the ends of the run."""
    kept, least = [scene.begins], TOGETHER * _rounding(scene, t_end)
    for stop in stops_within(scene, t_end):
        if stop - kept[-1] > least and t_end - stop > least:
            kept.append(stop)
    return tuple(kept[1:])


def _rounding(scene: Scene, t_end: float) -> float:
    """Of the latest time of a run, s."""
    return float(np.spacing(max(abs(scene.begins), abs(t_end))))


def warn_of_close_break_points(scene: Scene, t_end: float) -> None:
    """Break points between which time has too few digits for what acts there; not those that differ by roundoff."""
    rounding = _rounding(scene, t_end)
    named = sorted(float(t) for t in scene.breakpoints if scene.begins < t < t_end)
    for before, stop in pairwise((scene.begins, *named, t_end)):
        apart = (stop - before) / rounding
        if 4 * SIDE < apart < SHARP:
            lost = "all" if apart <= TOGETHER else f"{2 * SIDE / apart:.1g}"
            log.warning(
                "break points at t = %.12g s and %.2g s later: %s of what acts between them is lost in the roundoff of time. Let "
                "pulses last %.1g s or more, or name the instant once",
                before, stop - before, lost, SHARP * rounding,
            )  # fmt: skip


def warn_of_dense_break_points(schedule: StepSchedule) -> None:
    """Break points so dense that equal steps between them are far more than without: each begins anew."""
    usual = schedule.span / schedule.largest
    if schedule.stops and schedule.steps > MANY * usual > 0.0:
        log.warning(
            "%d break points, most of them nearer to each other than a step, make %d steps where some %d were asked for: name "
            "only instants at which loads or drives are not smooth, or smooth them",
            len(schedule.stops), schedule.steps, round(usual),
        )  # fmt: skip


def sampled_late(scene: Scene, schedule: StepSchedule) -> list[str]:
    """Controllers whose sampling period equal steps do not divide: samples come at the end of the step in which they are due."""
    if not schedule.steps or schedule.stops:  # which samples are among
        return []
    h = schedule.next(0.0)
    ratios = {name: force.period / h for name, force in scene.forces.items() if force.period is not None}
    return [name for name, steps in ratios.items() if abs(steps - max(1, round(steps))) > 1e-6 * steps]


def warn_of_late_samples(scene: Scene, schedule: StepSchedule) -> None:
    """Tell a user of samples that :func:`sampled_late` names."""
    for name in sampled_late(scene, schedule):
        log.warning(
            'controller "%s" samples every %g s, which is no multiple of the step of %g s: samples are taken late, at the '
            "end of the step in which they are due. Let dt divide the period, and t_end too",
            name, scene.forces[name].period, schedule.next(0.0),
        )  # fmt: skip
