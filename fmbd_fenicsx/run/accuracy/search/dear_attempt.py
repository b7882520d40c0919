"""A line where the next attempt of a search will take far longer than all before it.

With equal steps the time loop of a run of n steps, which took s seconds, takes s n' / n with n' of them at least: finer spaces
cost more. How many steps a smaller tolerance of a scheme asks for is not known where finer spaces bring faster vibrations;
attempts are thought to become dearer by the ratio of the last two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ....log import note
from ...result import Run

if TYPE_CHECKING:
    from .attempts import Attempt
    from .next_attempt import AttemptPlan

LONG = 10.0  # s, which a user wants to be told of
TIMES = 5.0  # the seconds of all attempts before


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
