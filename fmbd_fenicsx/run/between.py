"""States between the ends of a step: what a run records at given times.

A scheme whose steps are polynomials gives their values (:meth:`.TimeStepper.between`). Otherwise positions follow the cubic
through the ends with their velocities, in the local coordinates of the step's start, and velocities, accelerations and
multipliers the straight lines between their ends, all of at least second order in the step. Contact forces are those of the
step: the mean over it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..schemes.stepping import TimeStepper
from ..system.system import State, System


def state_between(system: System, before: State, after: State, t: float, stepper: TimeStepper | None = None) -> State:
    """The state at a time t (s) between two ends of a step, in which the ``stepper`` made it where given."""
    if stepper is not None and stepper.unwrapped.state is after:
        found = stepper.unwrapped.between(t)
        if found is not None:
            return found

    h = after.t - before.t
    x = (t - before.t) / h
    moved = system.difference(before.q, after.q)
    rate = system.rate(moved, after.v)
    xi = x * (1 - x) ** 2 * h * before.v + x * x * (3 - 2 * x) * moved - x * x * (1 - x) * h * rate

    def line(a: Any, b: Any) -> Any:
        return (1 - x) * a + x * b

    v = line(before.v, after.v)
    a = line(before.a, after.a)
    lam = line(before.lam, after.lam)
    return replace(after, t=t, q=system.compose(before.q, xi), v=v, a=a, lam=lam)
