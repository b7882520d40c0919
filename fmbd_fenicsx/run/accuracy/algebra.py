"""What Newton's iteration leaves in each sensor, where that may be seen beside the error of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ...log import log
from ...schemes.newton import FINEST
from ..problem import Problem
from .certificate import moving
from .companion_runs import UNFIT, Compared, as_recorded, companion
from .deviation import Deviation

TIGHTER = 0.01  # of the tolerance of Newton's iteration
SEEN = 0.5  # share of the error of time above which what iterations may leave is looked at
ROUNDOFF = 1e-9  # of a sensor's range


def tighter_run(problem: Problem, made: Compared, of_time: Mapping[str, Deviation]) -> tuple[Problem, Compared] | None:
    """The run once more with a hundredth of the tolerance of Newton's iteration; collective. None where what this leaves is small
    beside errors ``of_time``, and where the run does not end.

    What iterations leave of accelerations and reactions, as a share a of the range of a sensor, is a bound: some of it cancels
    from step to step, and places that joints prescribe have nothing of it. With schemes of high order a may be above what runs
    with larger steps differ by, which then show no order.
    """
    newton, recorder = problem.newton, made.recorder
    spans = moving(recorder.series, recorder.scene.sensors)
    left = problem.said.accuracy(newton)
    seen = any(left * span > SEEN * of_time[name].size for name, span in spans.items() if name in of_time)
    if not seen or left <= ROUNDOFF:
        return None

    tight = replace(problem, newton=replace(newton.afresh(), tolerance=max(TIGHTER * newton.tolerance, FINEST)))
    try:
        found = companion(tight, made.schedule, as_recorded(recorder, made.schedule))
    except UNFIT as error:
        log.info("the error of algebra is a bound: the run with a tighter iteration did not end: %s", error)
        return None
    return tight, replace(made, recorder=found.recorder)


def algebra_error(made: Compared, tight: Compared) -> dict[str, Deviation]:
    """Error of each sensor by Newton's iteration, from a run with a share k of its tolerance:

    |x_k - x| <= 1 / (1 - k) |x - x_k|                                                                                   (1)
    """
    fine, recorder = tight.recorder.series, made.recorder
    return {n: Deviation(recorder.times, (fine[n] - x) / (1.0 - TIGHTER)) for n, x in recorder.series.items()}
