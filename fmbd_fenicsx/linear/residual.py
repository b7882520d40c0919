"""The judge: every linear solve is accepted by its own true residual and by finiteness, never by a solver's word."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import LinearSolveError


@dataclass
class Judge:
    """Accepts or refuses linear solves; keeps the worst relative residual seen.

    A solve passes when |A x - b| <= tolerance |b| in the norm the caller uses. ``what`` names the system in messages.
    """

    what: str
    tolerance: float = 1e-8
    worst: float = 0.0
    solves: int = 0

    def check(self, residual: float, scale: float, advice: str = "") -> None:
        """Raise :class:`LinearSolveError` when |A x - b| = ``residual`` is too large against |b| = ``scale``."""
        self.solves += 1
        relative = residual / scale if scale > 0 else residual
        if not np.isfinite(relative) or relative > self.tolerance:
            raise LinearSolveError(
                f"Linear solve of {self.what}: relative residual {relative:.1e}, allowed {self.tolerance:.0e}. "
                + (advice or "The matrix is singular or nearly so: a body or joint is not determined.")
            )
        self.worst = max(self.worst, relative)
