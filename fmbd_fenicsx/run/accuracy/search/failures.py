"""Runs of a search that did not come to their end."""

from __future__ import annotations

from dataclasses import dataclass

from ....errors import ConvergenceError, LinearSolveError, StabilityError

IN_VAIN = 2  # times in a row that steps a quarter as large get no farther: parts of single ones were tried, too


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
