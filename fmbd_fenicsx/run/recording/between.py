"""States between the ends of a step: what a run records at given times.

A scheme whose steps are polynomials gives their values (:meth:`.TimeStepper.between`). Otherwise positions follow the cubic
through the ends with their velocities, and all else parabolas (:mod:`...schemes.dense_output`), all of at least second
order in the step. Contact forces are those of the step: the mean over it.
"""

from __future__ import annotations

from ...schemes.dense_output import place_within, state_within
from ...schemes.stepping import TimeStepper
from ...system.layout import State
from ...system.system import System


def state_between(
    system: System,
    ends: tuple[State, State],
    t: float,
    stepper: TimeStepper | None = None,
    *,
    earlier: State | None = None,
) -> State:
    """The state at a time t (s) between two ends of a step, in which the ``stepper`` made it where given; ``earlier``: the one
    that the step before began with, where forces are smooth.
    """
    before, after = ends
    if stepper is not None and stepper.unwrapped.state is after:
        found = stepper.unwrapped.between(t)
        if found is not None:
            return found
    return state_within(before, after, t, place_within(system, before, after, t, (before.v, after.v)), earlier)
