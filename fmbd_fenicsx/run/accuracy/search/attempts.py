"""Attempts of a search: the lines of its table, those that did not come to their end, and those that will take long.

With equal steps the time loop of a run of n steps, which took s seconds, takes s n' / n with n' of them at least: finer spaces
cost more. How many steps a smaller tolerance of a scheme asks for is not known where finer spaces bring faster vibrations;
attempts are thought to become dearer by the ratio of the last two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....errors import ConvergenceError, LinearSolveError, StabilityError
from ....log import note
from ...result import Run
from .next_attempt import AttemptPlan, Looked

SHOWN = 4  # jumps of loads in a line
IN_VAIN = 2  # times in a row that steps a quarter as large get no farther: parts of single ones were tried, too
LONG = 10.0  # s, which a user wants to be told of
TIMES = 5.0  # the seconds of all attempts before


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


@dataclass
class Failures:
    """How many runs failed, and how many of the last ones where the one before them did, to within one of its steps."""

    count: int = 0
    in_vain: int = 0
    last: tuple[float, float] | None = None

    def note(self, error: ConvergenceError | LinearSolveError) -> None:
        """One more; those whose steps were too many parts, or too large for their scheme, tell nothing of smaller ones."""
        before, self.last = self.last, None if isinstance(error, StabilityError) else error.halted
        there = before is not None and self.last is not None and abs(self.last[0] - before[0]) <= before[1]
        self.in_vain = self.in_vain + 1 if there else 0
        self.count += 1

    @property
    def hopeless(self) -> bool:
        """Whether no step gets farther."""
        return self.in_vain >= IN_VAIN


def tell_of_dear_attempt(tried: AttemptPlan, made: AttemptPlan | None, run: Run, history: Sequence[Attempt]) -> None:
    """Say how long an attempt ``made`` after one ``tried``, with its ``run``, is expected to take, where that is far longer."""
    if made is None:
        return
    last, spent = history[-1], sum(a.seconds for a in history)
    if tried.steps:
        expected = run.seconds["steps"] * made.steps / tried.steps
    else:
        expected = last.seconds**2 / history[-2].seconds if len(history) > 1 else 0.0
    if expected <= max(LONG, TIMES * spent):
        return
    how = f"{made.steps} steps" if made.steps else f"rtol = {made.step:.1g}"
    note(
        f'scene "{made.scene.name}": the next attempt, {how}, is expected to take {expected:.0f} s or more, after {spent:.2g} s '
        f"so far, which state {last.worst:.2g} times the tolerance. A larger tol, or a shorter run, takes less"
    )
