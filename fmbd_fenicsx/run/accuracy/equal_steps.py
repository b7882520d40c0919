"""Errors of runs with equal steps, by runs with larger and with smaller ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ...log import log
from ...rotations import Array
from ..problem import Problem
from ..recording.output import Output
from ..recording.recorder import Recorder
from ..schedule import StepSchedule, step_schedule
from .certificate import moving
from .companion_runs import UNFIT, Compared, StoppedError, again, companion
from .deviation import BeyondLarger, Deviation, alignment, at_least, scaled
from .jumps_at_records import instants_off
from .jumps_in_time import with_break_points
from .orders import (
    REGULAR,
    SEEN,
    TOO_HIGH,
    expected_orders,
    highest_order,
    of_the_scheme,
    order_seen,
    resolved,
    usable_order,
)

if TYPE_CHECKING:
    from ..single_run import Solved

FEWEST = 12  # steps of runs that tell errors by spaces and modes; fewer show an order
ROUNDOFF = 1e-9  # errors below this share of a sensor have no order
MATTERS = 1e-6  # the same of its range, below which nobody minds which one it is
ALIGNED = 0.5  # cosine between differences of runs below which they are not what one motion leaves by its steps
ASTRAY = 0.1  # share of the range of a sensor by which runs differ from where on the one with larger steps follows another motion
FURTHER = 1.5  # times what half the step tells that larger ones are believed, where they tell more
NEAREST = 1.5  # least ratio of steps of runs of which one tells the error of the other
TWICE = 2.0  # least ratio of steps that tells an error where no order is seen
MORE_THAN_TWICE = 2.2  # ratio from which on half of the steps are nearer


@dataclass(frozen=True)
class Orders:
    """Orders seen in runs of the same motion in other spaces: sensor -> order; ``follow``: the fewest steps that have them."""

    seen: Mapping[str, float] = field(default_factory=dict)
    follow: int = 0


@dataclass(frozen=True)
class TimeError:
    """Error of time and observed order of each sensor; ``with_others``: the cheapest run that follows the same motion;
    ``halved``: told by one with half the step. ``unseen``: no order was seen where one had to be. ``by_chance``: sensors whose
    orders are, see :func:`compare_steps`. ``told_by``: the fewest steps of the runs that tell it, those that only show the order
    left out where it is that of the scheme. ``apart``: what the run has beyond the next one with larger steps. ``instead``: the
    run whose error it is, in place of the one that was asked about: a whole one with half its step. ``struck``: instants of
    impacts, and what they are off, s.
    """

    errors: dict[str, Deviation]
    orders: dict[str, float]
    with_others: Compared
    halved: bool = False
    unseen: bool = False
    by_chance: frozenset[str] = frozenset()
    told_by: int = 0
    apart: Mapping[str, Deviation] = field(default_factory=dict)
    instead: Solved | None = None
    struck: tuple[Array, Array] = (np.zeros(0), np.zeros(0))


def time_error(problem: Problem, fine: Recorder, schedule: StepSchedule, *, kinked: bool = False) -> TimeError:
    """Error of each sensor from runs with 2 h and 4 h, and the observed order, see :func:`compare_steps`; collective.

    Where a run with larger steps does not end, where the order in some sensor is not that of the scheme, and where forces jump
    or have kinks that depend on the state (``kinked``), one with half the step tells the error: what these leave in h, 2 h and
    4 h is chance, by where they fall in a step, and of two such errors the larger step's is the larger one nearly always. Motion
    that the scheme damps in all runs is not seen.
    Hairer, Norsett, Wanner, doi:10.1007/978-3-540-78862-1, II.4.
    """
    given, coarser = Compared(fine, schedule, problem.scheme), []
    orders = expected_orders(problem.scheme, problem.scene, problem.system)

    found: TimeError | None = None
    try:
        for parts in (2, 4):
            coarser.append(again(problem, schedule, schedule.steps // parts, fine.output.times))
        found = compare_steps(orders, given, coarser)
    except UNFIT as error:
        if not isinstance(error, StoppedError):
            found = _by_smaller_steps(problem, given, coarser, orders)
        if found is None:
            log.warning("no error estimate: the run with twice the step did not end: %s", error)
            return TimeError({}, {}, given)

    if not found.halved and (kinked or _irregular(highest_order(problem.scheme, problem.system), orders, fine, found)):
        found = _by_smaller_steps(problem, given, coarser[:1], orders, found if kinked else None) or found
    return found if found.with_others is given else replace(found, with_others=coarser[0])


def _irregular(highest: int, expected: Mapping[str, int], made: Recorder, found: TimeError) -> bool:
    """Whether the order of a sensor that moves is not that of the scheme in it, or by chance, and its error matters."""
    spans = moving(made.series, made.scene.sensors)
    seen = [n for n, span in spans.items() if found.errors[n].size > MATTERS * span]
    return not found.by_chance.isdisjoint(seen) or not all(
        of_the_scheme((expected[n], highest), found.orders[n]) for n in seen
    )


def _by_smaller_steps(
    problem: Problem,
    given: Compared,
    coarser: list[Compared],
    expected: Mapping[str, int],
    larger: TimeError | None = None,
) -> TimeError | None:
    """Errors of the ``given`` run with the help of one with half its step, None where nothing can be compared; collective."""
    schedule = given.schedule
    try:
        finer = again(problem, schedule, 2 * schedule.steps, given.recorder.output.times, whole=False)
    except UNFIT:
        return compare_steps(expected, given, coarser) if coarser else None
    return by_half(expected, given, finer, coarser=coarser, larger=larger)


def by_half(
    expected: Mapping[str, int],
    given: Compared,
    finer: Compared,
    *,
    coarser: Sequence[Compared],
    larger: TimeError | None,
) -> TimeError:
    """Errors of the ``given`` run as one with half its step tells them by orders 1 <= p <= 2, with those that it and some
    ``coarser`` ones show.

    p is the order of the scheme in the sensor, or the one that is seen where it is clearly lower, of one about. For motion of
    order one the truth is 3/2 of this with p = 2, for motion that is off by its own size in both runs 3/4. Kinks may leave about
    the same in both: what ``larger`` steps tell beyond it counts up to :data:`FURTHER` times this. ``unseen`` without coarser
    ones.
    """
    seen = compare_steps(expected, finer, [given, *coarser]).orders
    orders = {n: min(p, 2.0) for n, p in expected.items()}
    lower = {n: max(seen[n], 1.0) for n, p in orders.items() if SEEN <= seen[n] < SEEN * p}
    errors = of_order({**orders, **lower}, given, finer)
    if larger is not None:
        errors = {n: at_least(x, larger.errors[n], FURTHER) for n, x in errors.items()}
    struck = instants_off(given.recorder, finer.recorder, 2.0)
    return TimeError(errors, seen, given, halved=True, unseen=not coarser, struck=struck)


def jump_errors(problem: Problem, given: Compared, jumps: Sequence[float]) -> TimeError | None:
    """Errors of the ``given`` run within whose equal steps loads jump, by one of half their size that end there, too: what such a
    jump leaves is chance in both h and 2 h, and whole in this difference. None where it does not end; collective.
    """
    steps, t_end = 2 * given.schedule.steps, given.schedule.t_end
    schedule = step_schedule(with_break_points(problem.scene, tuple(jumps)), problem.scheme, t_end, t_end / steps)
    wanted = Output(energy=False, progress=False, times=tuple(given.recorder.times))
    try:
        finer = Compared(companion(problem, schedule, wanted).recorder, schedule, problem.scheme)
    except UNFIT:
        return None
    expected = expected_orders(problem.scheme, problem.scene, problem.system)
    return replace(by_half(expected, given, finer, coarser=(), larger=None), unseen=False)


def doubtful(
    found: TimeError, expected: Mapping[str, int], ends: tuple[Compared, Compared], sensors: Sequence[str]
) -> bool:
    """Whether the runs that told an error, the given one and the next of which are ``ends``, have steps too near to one another
    to do so without an order, or steps so far apart that they may follow another motion, as some of the ``sensors`` tell.
    """
    given, coarser = ends
    ratio = given.schedule.steps / coarser.schedule.steps
    if ratio < TWICE and not resolved(known_orders(found), expected):
        return True
    if ratio <= MORE_THAN_TWICE:
        return False

    apart = found.apart
    return (
        not found.by_chance.isdisjoint({*sensors, *astray(given, apart, MATTERS)})
        or bool(astray(given, {n: apart[n] for n in sensors}))
        or any(found.orders[n] > expected[n] + TOO_HIGH for n in sensors)
    )


def shows_order(found: TimeError, orders: tuple[Mapping[str, int], int], sensors: Iterable[str]) -> bool:
    """Whether the runs that told an error show in some ``sensors``, and not by chance, the order of the scheme, which has these
    ``orders`` in sensors and in positions.
    """
    expected, highest = orders
    seen = known_orders(found)
    return found.by_chance.isdisjoint(sensors) and all(
        n in seen and of_the_scheme((expected[n], highest), seen[n]) for n in sensors
    )


def compare_steps(
    expected: Mapping[str, float],
    given: Compared,
    coarser: Sequence[Compared],
    known: Mapping[str, float] | None = None,
) -> TimeError:
    """Error of each sensor by Richardson's extrapolation from one or two runs with larger steps, h < H < K:

        |x_h - x| ~ |x_h - x_H| / ((H/h)^p - 1),     (K^p - H^p) / (H^p - h^p) = |x_H - x_K| / |x_h - x_H|     (1)

    each the largest over time; p counts as :func:`usable_order` says.

    What steps leave of a motion that they follow is h^p e(t), whatever h is: the two differences are the same function of time
    but for their size. Where they are not (a cosine below :data:`ALIGNED`), as of motion that no run follows, or with kinks, the
    order is seen by chance.

    Where fast motion is not resolved (say, gravity switched on at once) the observed order is below the scheme's, and the
    estimate larger. From one run alone p is the ``known`` one, sensor -> p, or the ``expected`` one.
    """
    fine, coarse = given.recorder, coarser[0].recorder
    ratio = given.steps / coarser[0].steps
    errors, orders, by_chance = {}, {}, set()
    beyond = between(fine, coarse, fine.series)
    farther = between(coarse, coarser[1].recorder, fine.series) if len(coarser) > 1 else {}

    for name, apart in beyond.items():
        p = float("nan") if known is None else known.get(name, float("nan"))
        if len(coarser) > 1 and apart.size > 0:
            far = farther[name]
            p = order_seen(coarser[1].steps, coarser[0].steps, given.steps, far.size / apart.size)
            if alignment(apart, far) < ALIGNED:
                by_chance.add(name)
        errors[name], orders[name] = scaled(apart, 1.0 / (ratio ** usable_order(p, expected[name]) - 1.0)), p

    moves = [n for n, x in fine.series.items() if errors[n].size > ROUNDOFF * np.abs(x).max(initial=0.0)]
    seen = {n: orders[n] for n in moves}
    follows = bool(seen) and resolved(seen, expected) and (len(coarser) > 1 or known is not None)
    others = [made for made in coarser if follows and made.steps >= FEWEST]
    regular = resolved(seen, expected, REGULAR) and all(p <= expected[n] + TOO_HIGH for n, p in seen.items())
    told_by = coarser[0 if regular else -1].steps
    follower, chance = others[-1] if others else given, frozenset(by_chance)
    struck = instants_off(fine, coarse, 1.0 / (ratio - 1.0))
    return TimeError(errors, orders, follower, by_chance=chance, told_by=told_by, apart=beyond, struck=struck)


def of_order(
    expected: Mapping[str, float], given: Compared, other: Compared, share: float = 1.0, least: float = 0.0
) -> dict[str, Deviation]:
    """Errors of a run as one with larger or smaller steps tells them, by a ``share`` of the expected orders, at least so much:

    x - x_h ~ (x_h - x_H) / ((H/h)^p - 1),     H > h or H < h                                                 (1)
    """
    ratio = given.steps / other.steps
    fine, coarse = (given, other) if ratio > 1.0 else (other, given)
    factors = {n: 1.0 / abs(ratio ** max(share * p, least) - 1.0) for n, p in expected.items()}
    return {n: scaled(x, factors[n]) for n, x in between(fine.recorder, coarse.recorder, factors).items()}


def falling_slowly(
    found: TimeError,
    expected: Mapping[str, int],
    compared: tuple[Compared, Compared],
    sensors: Iterable[str],
    enough: Callable[[dict[str, Deviation]], bool],
) -> TimeError:
    """What was found, but for errors of ``sensors`` whose orders are seen by chance: these are told by half of the orders of the
    scheme, from a run and one with larger steps, where that is small ``enough``. Nobody has to see their orders then.
    """
    chance = found.by_chance.intersection(sensors)
    if not chance:
        return found

    slow = of_order(expected, *compared, 0.5)
    alone = {n: slow[n] if n in chance else scaled(x, 0.0) for n, x in found.errors.items()}
    if not enough(alone):
        return found

    told = {n: slow[n] if n in chance else x for n, x in found.errors.items()}
    return replace(found, errors=told, by_chance=found.by_chance - chance)


def equal_steps_error(problem: Problem, made: Compared, jumps: Sequence[float], *, kinked: bool) -> TimeError:
    """The error of time of a run with equal steps, within which loads may jump, or its records show kinks; collective."""
    found = jump_errors(problem, made, jumps) if jumps else None
    return found or time_error(problem, made.recorder, made.schedule, kinked=kinked)


def between(fine: Recorder, coarse: Recorder, sensors: Iterable[str]) -> dict[str, Deviation]:
    """Some sensors of a run less those of one with larger steps, see :class:`.BeyondLarger`."""
    beyond = BeyondLarger(fine.times, coarse.times, fine.t_end)
    return {name: beyond.of(fine.series[name], coarse.series[name]) for name in sensors}


def astray(given: Compared, apart: Mapping[str, Deviation], share: float = ASTRAY) -> list[str]:
    """The sensors that move in which a run is so far ``apart`` from a given one that agreement of others is chance: by more than
    a ``share`` of the range.
    """
    spans = moving(given.recorder.series, given.recorder.scene.sensors)
    return [name for name, span in spans.items() if name in apart and apart[name].size > share * span]


def known_orders(found: TimeError) -> dict[str, float]:
    """Orders that were seen, by sensor."""
    return {name: p for name, p in found.orders.items() if np.isfinite(p)}
