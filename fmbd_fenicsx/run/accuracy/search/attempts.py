"""Lines of the table of a search: what its attempts were made with, what they state, what was done next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .next_attempt import AttemptPlan, Looked

SHOWN = 4  # jumps of loads in a line


@dataclass(frozen=True)
class Attempt:
    """One run on the way to a tolerance: its steps (s, or rtol), its level of refinement, stated errors, seconds with estimates.

    One that only looked at the error in space, with the fewest steps that follow the motion, states this error alone, one whose
    loads were found to jump none.
    ``worst`` is the largest stated error over its tolerance; ``errors``: sensor -> sum of errors. ``then``: what was done next.
    """

    step: float
    meshes: int
    modes: int
    worst: float
    errors: dict[str, float]
    seconds: float
    then: str

    def __str__(self) -> str:
        """A line of a table."""
        errors = ", ".join(f"{n} {x:.1e}" for n, x in self.errors.items())
        said = f"error / tol {self.worst:8.2g} ({errors})" if errors else "no errors stated"
        return (
            f"step {self.step:<9.3g} mesh level {self.meshes}, modes level {self.modes}: {said}, {self.seconds:.2f} s: "
            f"{self.then}"
        )


def of_space(plan: AttemptPlan, looked: Looked, seconds: float) -> Attempt:
    """The line of an attempt that ended when its meshes were found too coarse."""
    step = plan.schedule.t_end / plan.orders.follow
    return Attempt(step, plan.meshes, plan.modes, looked.over, looked.errors, seconds, "finer meshes")


def of_jumps(plan: AttemptPlan, jumps: Sequence[float], seconds: float) -> Attempt:
    """The line of an attempt that ended when loads were found to jump within its steps."""
    shown = ", ".join(f"{t:.6g} s" for t in jumps[:SHOWN]) + (", .." if len(jumps) > SHOWN else "")
    then = f"steps that end where loads jump: {shown}"
    return Attempt(plan.step, plan.meshes, plan.modes, np.inf, {}, seconds, then)
