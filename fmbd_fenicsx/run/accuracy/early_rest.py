"""What bodies miss that come to rest before their impacts are over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...log import log
from ..problem import Problem
from .companion_runs import UNFIT, Compared, as_recorded, companion
from .deviation import Deviation


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
