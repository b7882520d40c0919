"""States between the ends of steps: what a run records at given times.

A scheme whose steps are polynomials gives their values (:meth:`.TimeStepper.between`). Otherwise positions follow the cubic
through the ends with their velocities, and all else parabolas (:mod:`...schemes.dense_output`), all of at least second
order in the step. Contact forces are those of the step: the mean over it; gaps are those of the places.
"""

from __future__ import annotations

from dataclasses import replace

from ...schemes import dense_output
from ...schemes.stepping import TimeStepper
from ...system.compiled.kept import KeptSteps
from ...system.layout import State, States
from ...system.system import System


def state_between(
    system: System,
    ends: tuple[State, State],
    t: float,
    stepper: TimeStepper,
    *,
    earlier: State | None = None,
) -> State:
    """The state at a time t (s) between two ends of a step, that the ``stepper`` made; ``earlier``: the one that the step
    before began with, where forces are smooth.
    """
    before, after = ends
    found = stepper.unwrapped.between(t) if stepper.unwrapped.state is after else None
    if found is None:
        found = dense_output.within(system, before, after, t, earlier)
    contact = getattr(found, "contact", None)
    if contact is None:
        return found
    from ...system.sensors.contact import ContactState, gaps_within

    assert isinstance(found, ContactState)
    gaps = gaps_within(system, [found])
    return found if gaps is None else replace(found, contact=replace(contact, gap=gaps[0]))


def states_within(steps: KeptSteps, stepper: TimeStepper, roundoff: float) -> States:
    """The states at the instants of steps that a march of the ``stepper`` has kept; ends of steps, but for so much roundoff (s),
    as they are. Collective.
    """
    inside = steps.t[:, 0] < steps.after.t[:, 0] - roundoff
    if inside.all():
        return stepper.unwrapped.within(steps)
    found = steps.after
    if inside.any():
        found.put(inside, stepper.unwrapped.within(steps.chosen(inside)))
    return found
