"""The judge: every linear solve is accepted by its own true residual and by finiteness, never by a solver's word."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from ..errors import LinearSolveError
from ..rotations import Array

ROUNDOFF = 1e-15
"""Backward error |A x - b| / (|A| |x| + |b|) that a stable factorisation stays below, |A| the largest row sum;
measured with Cholesky on thin rods: 6e-17."""

LARGEST_GROWTH = 1e11
"""|A| |x| / |b|, a lower bound of the condition number, above which a matrix counts as singular: a factor of a matrix that is
singular to roundoff gives 1e15 or more. With ROUNDOFF: no solve passes with a residual above 1e-4 |b|."""

NOTHING = float(np.sqrt(np.finfo(float).tiny))
"""Forces below, whose squares have lost their digits, are none: loads that come like exp(-t^2) begin there."""


@dataclass(eq=False)
class Judge:
    """Accepts or refuses linear solves; keeps the worst relative residual seen.

    A solve passes when |A x - b| <= tolerance |b| in the norm the caller uses. Where the matrix is regular but so
    ill-conditioned that roundoff of A x itself is larger than that (a thin body, a long step), a solve passes too when

        |A x - b| <= ROUNDOFF (|A| |x| + |b|)      and      |A| |x| <= LARGEST_GROWTH |b|                      (1)

    x then solves a system that differs from the given one by roundoff (Rigal and Gaches, doi:10.1145/321406.321416).
    Callers that give no |A| |x| get the first criterion alone. ``what`` names the system in messages. ``worst`` is of
    |A x - b| / |b| in either case. Compiled code that judges by the first criterion writes ``told``: the number of solves, and
    the worst.
    """

    what: str
    tolerance: float = 1e-8
    told: Array = field(default_factory=lambda: np.zeros(2))

    @property
    def solves(self) -> int:
        """Solves so far."""
        return int(self.told[0])

    @solves.setter
    def solves(self, count: int) -> None:
        self.told[0] = count

    @property
    def worst(self) -> float:
        """The largest relative residual."""
        return float(self.told[1])

    @worst.setter
    def worst(self, relative: float) -> None:
        self.told[1] = relative

    def check(self, residual: float, scale: float, advice: str = "", *, grown: float = 0.0, solves: int = 1) -> None:
        """Raise :class:`LinearSolveError` when |A x - b| = ``residual`` is too large against |b| = ``scale``.

        ``grown``: |A| |x|, or 0 where it is not known. ``solves``: how many this is the worst of.
        """
        self.told[0] += solves
        relative = residual / scale if scale > NOTHING else residual
        # also where the residual is no number
        if not (relative <= self.tolerance or self._is_roundoff(residual, scale, grown)):
            raise LinearSolveError(
                f"Linear solve of {self.what}: relative residual {relative:.1e}, allowed {self.tolerance:.0e}. "
                + (advice or "The matrix is singular or nearly so: a body or joint is not determined.")
            )
        self.told[1] = max(self.told[1], relative)

    def _is_roundoff(self, residual: float, scale: float, grown: float) -> bool:
        """Criterion (1); False for anything not finite."""
        return grown <= LARGEST_GROWTH * scale and residual <= ROUNDOFF * (grown + scale)


class KrylovTest:
    """When a Krylov method of PETSc stops: its own norm has fallen from the ``first`` by rtol, and the true residual is small.

    ``residual``: of the solution so far, whose vector it is given; it is asked only where the norm is small. Collective.
    """

    def __init__(self, judge: Judge, residual: Callable[[Any], float]) -> None:
        self.judge, self.residual, self.first = judge, residual, 0.0

    def __call__(self, ksp: Any, iteration: int, norm: float) -> Any:
        """PETSc's reason to stop."""
        from petsc4py import PETSc

        reasons = PETSc.KSP.ConvergedReason
        if iteration == 0:
            self.first = norm
        if not isfinite(norm):
            return reasons.DIVERGED_NANORINF
        rtol, _, _, limit = ksp.getTolerances()
        # the preconditioned norm is cheap and may deceive; the true residual has the last word
        if norm == 0.0 or (norm <= rtol * self.first and self._accurate(ksp)):
            return reasons.CONVERGED_RTOL
        return reasons.DIVERGED_MAX_IT if iteration >= limit else reasons.ITERATING

    def _accurate(self, ksp: Any) -> bool:
        return bool(self.residual(ksp.buildSolution()) <= 0.5 * self.judge.tolerance)
