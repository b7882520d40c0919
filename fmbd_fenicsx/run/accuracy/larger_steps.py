"""Errors of runs with steps of a scheme's own choice, by runs whose steps are two or four of them in one.

The sizes h(t) of such steps are a function of time times the root of the tolerance. Steps of 2 h(t) are spread over the run as
they are, so that errors of smooth motion are those of h(t) but for a power of two, as with equal steps: the order of the scheme,
which errors over tolerances do not show. They cost half of a run, one with a smaller tolerance up to three times as much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ...log import log
from ...rotations import Array
from ...schemes.error_norm import FINEST
from ..built import Built
from ..problem import Problem
from ..recording.output import Output
from ..schedule import StepSchedule, far_side
from ..single_run import Solved
from .companion_runs import UNFIT, Compared, as_recorded, companion
from .deviation import Deviation, unresolved
from .equal_steps import FEWEST, NEAREST, TimeError, astray, between, compare_steps, of_order
from .orders import MOST_LEFT, REGULAR, expected_orders, seen_by_ends
from .search.shares import DOUBTED, Allowed

SUDDEN = 1 / 3  # of the size of the step before: the error of smooth motion does not ask for so much less at once
# steps within which kinks ask for as much less beside refused ones, and the tolerance below which high orders do not pass them
SOON, NOT_PASSED = 3, 5e-6
MANY = 6 * FEWEST  # steps of which four in one still follow the motion
MEAN_ORDER = "mean order"  # counter of schemes that change their order
SHARPER = 0.1  # of the tolerance, by which halves of steps are iterated
SLOW = 0.75  # share of the order of the scheme that errors are stated by, where half of it would do


def _taken_order(scheme: Any, counters: Mapping[str, float]) -> tuple[float, bool]:
    """The order of the steps of a run, the mean of those that its scheme chose where it changes it; and whether it does."""
    return counters.get(MEAN_ORDER, scheme.order), MEAN_ORDER in counters


def may_be_larger(problem: Problem, given: Compared, counters: Mapping[str, float]) -> bool:
    """Whether steps that are two of a run's in one tell its error: its scheme takes them, it is recorded at its own ends, and
    sizes and refusals (``counters``) are those of smooth motion.
    """
    scene = problem.scene
    if not problem.said.takes_given or not _at_ends(given):
        return False
    if scene.contacts or scene.limits or seen_by_ends(problem.system):
        return False
    return _order_is_known(problem.scheme, given.steps, counters) and _smooth(given, bool(counters.get("rejections")))


def _order_is_known(scheme: Any, steps: int, counters: Mapping[str, float]) -> bool:
    """Whether the order of a run can be told, or taken for granted.

    Kinks, for which steps are refused, leave errors of the order :data:`.MOST_LEFT` at most: a higher one has to be seen beside
    such steps, which few of them do not show. Of a scheme that changes its order none is seen: there the tolerance has to tell
    kinks from quick motion, and a few steps are those of its start, of high orders twice as many.
    """
    order, changes = _taken_order(scheme, counters)
    refused = counters.get("rejections", 0.0)
    if refused > counters.get("rejected: error estimate", 0.0):
        return False

    high = SLOW * order > MOST_LEFT
    unseen = bool(refused) and high
    if changes:
        return steps >= MANY * (2 if high else 1) and not (unseen and scheme.rtol > NOT_PASSED)
    return steps >= MANY or not unseen


def _smooth(given: Compared, refused: bool) -> bool:
    """Whether no step is suddenly smaller than the one before; beside refused ones than any of the few before, as kinks, which
    are passed in several, ask for. The last one ends where it has to.
    """
    sizes = [np.diff(t) for t in _stretches(given)]
    before = range(1, 1 + (SOON if refused else 1))
    smooth = all((h[k:-1] > SUDDEN * h[: -1 - k]).all() for h in sizes for k in before)
    return smooth and sum(map(len, sizes)) >= 2 * FEWEST


def _at_ends(given: Compared) -> bool:
    """Whether a run is recorded at the ends of its steps: these are known then."""
    return given.recorder.output.times is None and given.recorder.output.every == 1


def _stretches(given: Compared) -> list[Array]:
    """The ends of steps of a run from one break point, or mark, to the next, both among them, s."""
    times, schedule = given.recorder.times, given.schedule
    stops = np.searchsorted(times, [far_side(t) for t in sorted({*schedule.stops, *schedule.marks})]) - 1
    return [times[first : last + 1] for first, last in pairwise((0, *stops, len(times) - 1))]


def in_one(given: Compared, count: int) -> StepSchedule:
    """Steps that are so many of a run's in one; the last ones before break points and marks may be less, and those before one
    that is suddenly longer: together with them it would hardly be larger than alone, and its error the same in both runs.
    """
    marks = list(set(given.schedule.marks) - set(given.schedule.stops))
    for t in _stretches(given):
        h, held = np.diff(t), 0
        for k in range(len(h)):
            if held == count or (held and h[k - 1] < SUDDEN * h[k]):
                marks.append(float(t[k]))
                held = 0
            held += 1
    return replace(given.schedule, marks=tuple(sorted(marks)), given=True)


def with_larger_steps(problem: Problem, given: Compared, count: int) -> Compared | None:
    """The run once more with so many steps in one; None where it does not end, or had to take others; collective."""
    return _with_steps(problem, in_one(given, count), Output(energy=False, progress=False))


def _with_steps(problem: Problem, schedule: StepSchedule, wanted: Output, of: Built | None = None) -> Compared | None:
    """The same with the steps of a schedule and an output, from that ``of`` another system where there is one."""
    try:
        made = companion(problem, schedule, wanted, of)
    except UNFIT as error:
        log.info("the run with steps like those of another one did not end: %s", error)
        return None
    other = Compared(made.recorder, schedule, problem.scheme)
    return None if _other_steps(other) else other


def beyond_by_halves(problem: Problem, given: Compared, of: Built | None = None) -> dict[str, Deviation]:
    """What a run with halves of the steps of a ``given`` one has beyond it; ``of``: made with another system of the problem's
    scene. Tolerances that ask for as many steps of second order share some with those, and drift with the pattern in which sizes
    change; and of schemes whose values between ends of steps are of a lower order, other ends would show these. Where the ends of
    steps were not recorded these are made once more. Empty where that is no way to tell its error; collective.
    """
    said = problem.said
    if not (said.takes_given and (said.ends_ahead or problem.scheme.order <= 2)) or seen_by_ends(problem.system):
        return {}
    recorder, schedule, at_ends = given.recorder, given.schedule, _at_ends(given)
    if not at_ends:
        asked = replace(problem, scene=recorder.scene)
        known = companion(asked, schedule, Output(energy=False, progress=False))
        given = replace(given, recorder=known.recorder)
    ends = set(schedule.marks) - set(schedule.stops)
    for t in _stretches(given):
        ends.update(map(float, t[1:-1]), map(float, 0.5 * (t[1:] + t[:-1])))
    halves = replace(schedule, marks=tuple(sorted(ends)), given=True)
    # which has its part of the iteration's error only
    sharper = replace(problem, scheme=replace(problem.scheme, rtol=max(SHARPER * problem.scheme.rtol, FINEST)))
    wanted = Output(energy=False, progress=False) if at_ends else as_recorded(recorder, halves)
    finer = _with_steps(sharper, halves, wanted, of)
    if finer is None:
        return {}
    there = finer.recorder.series
    alike = [n for n, x in recorder.series.items() if x.shape[1:] == there[n].shape[1:]]  # not those of each mesh
    return between(finer.recorder, recorder, alike)


def two_in_one(solved: Solved) -> Compared | None:
    """A run once more with steps that are two of its own in one; None where these do not tell its error, as where nearly all end
    at marks between them; collective.
    """
    problem, given = solved.problem, solved.compared
    if not may_be_larger(problem, given, solved.run.counters):
        return None
    two = with_larger_steps(problem, given, 2)
    return None if two is None or given.steps < NEAREST * two.steps else two


def larger_steps_error(solved: Solved, two: Compared, allowed: Allowed) -> TimeError | None:
    """The error by the steps of a run beside one with ``two`` in one; None where larger ones do not tell it; collective.

    They tell it where half of the order of the scheme would be enough, or most of it is far too much; stated is what :data:`SLOW`
    of the order has, or order one where larger steps leave out vibrations (:func:`.deviation.unresolved`). Else steps that are
    four in one show the order: see :func:`.compare_steps`; beside steps that were refused they have to. A scheme that changes its
    order has the share :data:`.REGULAR` of the mean of those taken, beside refused steps :data:`SLOW` of it: what three runs show
    is chance, and long motion falls by up to two fifths of an order less, weak kinks by more.
    """
    problem, given, sensors, own = solved.problem, solved.compared, allowed.sensors, solved.compared.recorder
    refused = bool(solved.run.counters.get("rejections"))
    order, changes = _taken_order(problem.scheme, solved.run.counters)
    expected = expected_orders(problem.scheme, problem.scene, problem.system)
    apart = between(own, two.recorder, expected)
    quick = {n: 1 for n, x in apart.items() if unresolved(x, Deviation(own.times, own.series[n]))}
    strays = bool(astray(given, {n: apart[n] for n in sensors}))

    def told(share: float) -> dict[str, Deviation]:
        most = {n: min(p, order) for n, p in expected.items()}
        return of_order(most, given, two, share) | of_order(quick, given, two, 1.0)

    others = two if quick.keys().isdisjoint(sensors) else given  # finer spaces need the vibrations, too
    slow = TimeError(told(REGULAR if changes and not refused else SLOW), dict.fromkeys(expected, float("nan")), others)
    if changes:
        return None if strays else slow
    if allowed.share(slow.errors) > DOUBTED * allowed.room:
        return slow
    if strays:
        return None
    taken_for_granted = not refused or SLOW * problem.scheme.order <= MOST_LEFT
    if taken_for_granted and allowed.lets(told(0.5)):
        return slow

    four = with_larger_steps(problem, given, 4) if given.steps >= MANY else None
    if four is None:
        return None
    found = compare_steps(expected, given, [two, four])
    return replace(found, with_others=others) if found.by_chance.isdisjoint(sensors) else None


def _other_steps(made: Compared) -> bool:
    """Whether a run had to take other steps than it was given, as where frames turn far."""
    return bool(made.recorder.indices[-1] > made.steps)
