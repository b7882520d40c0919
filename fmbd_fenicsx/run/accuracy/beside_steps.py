"""What runs with other steps do not tell: vibrations that a scheme takes out, rest before impacts are over, Newton's iteration.

Vibrations that the steps of a run do not resolve are taken out within the first few of them. Stiffly accurate schemes (Radau,
BDF) and generalized-alpha with a small rho_inf leave nothing of one of w h >> 1: runs with h, 2 h and 4 h all miss it, agree, and
tell no error. A rule that conserves energy keeps its amplitude, whatever it makes of its frequency. Over the first steps of a
size h both differ by

    e_h = max |x_damped - x_undamped|  =  O(h^2) or less of smooth motion,   the amplitude of what was taken out else       (1)

so that of vibrations e_2h is about e_h, of smooth motion it is four to eight times as large. The undamped rule takes eight steps
in one of the scheme: places tremble little, and its own errors would hide that. What loads excite later is not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...log import log
from ...rotations import Array
from ...schemes.declared import Declared
from ...schemes.newton import FINEST
from ...system.scene.contents import contents_of
from ..problem import Problem
from ..recording.output import Output
from ..schedule import StepSchedule
from .certificate import HIDDEN, moving
from .companion_runs import UNFIT, Compared, as_recorded, companion
from .deviation import Deviation, scaled

FEW = 8  # steps that are looked at
FINER = 8  # steps of the rule that damps nothing in one of the scheme
FALLING = 2.0  # e_2h over e_h, from which on the difference is that of smooth motion


def with_damped(
    errors: dict[str, Deviation], problem: Problem, schedule: StepSchedule
) -> tuple[dict[str, Deviation], dict[str, float]]:
    """Errors that are at least the amplitudes of what the scheme has taken out of the first steps, by (1), and those amplitudes
    that say more than the errors do; collective.

    As they are for schemes that damp little, for runs of a few steps, and where one does not end.
    """
    if not problem.said.forgets or schedule.left(0) < 2 * FEW:
        return errors, {}
    free, h = _undamped(problem), schedule.next(0.0)
    try:
        apart = _apart(problem, free, h)
        hidden = {n: x for n, x in apart.items() if n in errors and x > HIDDEN * errors[n].size > 0.0}
        far = _apart(problem, free, 2.0 * h) if hidden else {}
    except UNFIT as error:
        log.info("vibrations that the scheme damps are not looked for: a run of a few steps did not end: %s", error)
        return errors, {}
    hidden = {n: x for n, x in hidden.items() if far[n] < FALLING * x}
    return {n: scaled(x, hidden[n] / x.size) if n in hidden else x for n, x in errors.items()}, hidden


def _undamped(problem: Problem) -> Any:
    """A scheme that conserves energy; where it refuses the scene, as with floating frames, one that damps little."""
    from ...schemes.onestep.alpha.generalized_alpha import GeneralizedAlpha
    from ...schemes.onestep.conserving.energy_momentum import EnergyMomentum

    conserving = EnergyMomentum()
    refused = Declared.by(conserving).refuse(conserving.name, contents_of(problem.scene))
    return GeneralizedAlpha(0.9) if refused else conserving


def _apart(problem: Problem, free: Any, h: float) -> dict[str, float]:
    """e_h of every sensor, with the scheme that damps nothing."""
    damped, kept = (_begun(problem, scheme, h, parts) for scheme, parts in ((problem.scheme, 1), (free, FINER)))
    return {n: float(np.abs(x - kept[n]).max(initial=0.0)) for n, x in damped.items()}


def _begun(problem: Problem, scheme: Any, h: float, parts: int) -> dict[str, Array]:
    """The sensors over the first steps of size h, each of so many parts by a scheme."""
    wanted, schedule = Output(energy=False, progress=False, every=parts), StepSchedule(FEW * h, FEW * parts)
    return companion(replace(problem, scheme=scheme, most_parts=0.0), schedule, wanted).recorder.series


def with_early_rest(errors: dict[str, Deviation], problem: Problem, made: Compared) -> dict[str, Deviation]:
    """Errors of time, or what a scheme that lets bodies rest ``early`` leaves out, by one more run, if that is more; collective.

    Flights that are over within a step h rise by a h^2 (1 - e)^2 / 8 where a pulls them: runs with 2 h and 4 h leave out the
    same, at the instants that they share. Where the run that makes all flights fails nothing is told.
    """
    contacts = problem.system.contacts
    bounces = contacts is not None and any(np.any(pair.restitution) for pair in contacts.pairs)
    if not (problem.said.early and errors and bounces):
        return errors
    late = replace(problem, scheme=replace(problem.scheme, early=False))
    try:
        whole = companion(late, made.schedule, as_recorded(made.recorder, made.schedule)).recorder
    except UNFIT as error:
        log.info("what early rest leaves out is not known: the run that makes all flights did not end: %s", error)
        return errors
    own, times = made.recorder.series, made.recorder.times
    told = {n: (x.at(times), whole.series[n] - own[n]) for n, x in errors.items()}
    return {n: Deviation(times, np.where(np.abs(left) > np.abs(x), left, x)) for n, (x, left) in told.items()}


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
