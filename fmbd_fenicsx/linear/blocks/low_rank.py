"""Factors with a correction of low rank: slack droppers of wires, and the inertia of second-order displacements.

With columns V (n, k) and a small matrix C (k, k) (Woodbury),

    (E + V C V^T)^-1 = E^-1 - Y (1 + C V^T Y)^-1 C V^T E^-1,       Y = E^-1 V                                  (1)

Wires: the factor with all droppers taut serves, V^T are the rows of the slack ones, -C their stiffness times ck. Y is computed
once for a ratio cm : ck and all droppers; a change of the slack set costs a small dense factorisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...fem.factors.factor import InC
from ...rotations import Array
from ..residual import Judge
from .spd import CholeskyFactor, FieldFactor

KEPT = 3  # factors for different ratios cm : ck, beside those in use


@dataclass
class TautFactor:
    """The factor of wires with all droppers taut, Y of (1), and how many factors with slack ones use these."""

    factor: CholeskyFactor
    Y: Array
    users: int = 0


def _taut(field: Any, cm: float, ck: float) -> TautFactor:
    """That of a ratio cm : ck, kept with the field; older ones that nobody uses are freed."""
    made: dict[tuple[float, float], TautFactor] = field.factors
    if (cm, ck) not in made:
        idle = [key for key, one in made.items() if not one.users]
        for key in idle[: max(len(made) - KEPT + 1, 0)]:
            made.pop(key).factor.destroy()
        base = CholeskyFactor(field, cm, ck)
        made[cm, ck] = TautFactor(base, base.solve_columns(field.B.T.toarray()))
    return made[cm, ck]


class LowRankFactor(FieldFactor):
    """E + V C V^T by (1) and a factor of E; V of this rank's entries, ``total`` sums over ranks. ``Y``: where it is known.

    E^-1 and Y are judged by the factor of E; what is left of a residual is that of the small matrix.
    """

    def __init__(
        self, base: FieldFactor, V: Any, C: Array, total: Callable[[Array], Array], Y: Array | None = None
    ) -> None:
        self.base, self.V, self.C, self.total = base, V, C, total
        self.judge, self.fresh, self.hidden = base.judge, base.fresh, base.hidden
        self.Y = base.solve_columns(V) if Y is None else Y
        self.small = np.linalg.solve(np.eye(len(C)) + C @ total(V.T @ self.Y), C)

    @property
    def iterations(self) -> int:  # type: ignore[override]
        """Of the factor of E."""
        return self.base.iterations

    @property
    def sparse(self) -> FieldFactor:
        """The factor of E."""
        return self.base

    def product(self, u: Array) -> Array:
        """E u + V C V^T u."""
        return np.asarray(self.base.product(u) + self.V @ (self.C @ self.total(self.V.T @ u)))

    def solve(self, b: Array) -> Array:
        """x = (1) b."""
        return self._corrected(self.base.solve(b))

    def solve_columns(self, B: Array) -> Array:
        """(1) for columns (n, k)."""
        return self._corrected(self.base.solve_columns(B))

    def _corrected(self, z: Array) -> Array:
        return np.asarray(z - self.Y @ (self.small @ self.total(self.V.T @ z)))

    def destroy(self) -> None:
        """Free the factor of E."""
        self.base.destroy()


class SlackFactor(LowRankFactor):
    """(cm M + ck K) of wires with the droppers ``slack`` (numbers) left out."""

    def __init__(self, field: Any, cm: float, ck: float, slack: np.ndarray) -> None:
        fresh = (cm, ck) not in field.factors
        self.taut = _taut(field, cm, ck)
        self.taut.users += 1
        push = np.diag(-ck * field.stiff[slack])
        super().__init__(self.taut.factor, field.B[slack].T, push, np.asarray, self.taut.Y[:, slack])
        self.fresh, self.how = fresh, self.base.how
        self.judge = Judge(f'the wires of body "{field.name}"')
        self.field, self.weights, self.slack = field, (cm, ck), slack

    def in_c(self) -> InC | None:
        """As that of the taut wires, where none is slack."""
        return None if self.slack.size else self.base.in_c()

    def solve(self, b: Array) -> Array:
        """x = (1) b, judged by its true residual."""
        return self._judged(super().solve(b), b)

    def solve_columns(self, B: Array) -> Array:
        """(1) for columns (n, k)."""
        X = super().solve_columns(B)
        for x, b in zip(X.T, B.T, strict=True):
            self._judged(np.asarray(x), np.asarray(b))
        return X

    def _judged(self, x: Array, b: Array) -> Array:
        """x, when it solves (E + V C V^T) x = b; the judge of E has seen the solve without slack droppers."""
        if not self.slack.size:
            self.judge.solves += 1
            self.judge.worst = max(self.judge.worst, self.base.judge.worst)
            return x
        f, (cm, ck) = self.field, self.weights
        r = cm * f.mass(x[:, None])[:, 0] + ck * f.tangent(x) + self.V @ (self.C @ (self.V.T @ x)) - b
        norm = np.linalg.norm
        self.judge.check(float(norm(r)), float(norm(b)), grown=self.taut.factor.factor.norm * float(norm(x)))
        return x

    def destroy(self) -> None:
        """Use the taut factor no more; it stays with the field, whose ``free_factors`` frees it."""
        self.taut.users -= 1
