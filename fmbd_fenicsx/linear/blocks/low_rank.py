"""Factors with a correction of low rank: slack droppers of wires, and the inertia of second-order displacements.

Wires: the factor with all droppers taut serves, corrected by a small system for the slack ones. With B_S the rows of the slack
droppers and D = ck k their stiffness (Woodbury),

    (E - B_S^T D B_S)^-1 = E^-1 + Y_S (D^-1 - B_S Y_S)^-1 B_S E^-1,       Y = E^-1 B^T                         (1)

Y is computed once for a ratio cm : ck; a change of the slack set costs a small dense factorisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sl

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


class SlackFactor(FieldFactor):
    """(cm M + ck K) of wires with the droppers ``slack`` (numbers) left out."""

    def __init__(self, field: Any, cm: float, ck: float, slack: np.ndarray) -> None:
        self.fresh = (cm, ck) not in field.factors
        self.taut = _taut(field, cm, ck)
        self.taut.users += 1
        self.base, Y = self.taut.factor, self.taut.Y
        self.how = self.base.how
        self.judge = Judge(f'the wires of body "{field.name}"')
        self.field, self.weights = field, (cm, ck)
        self.slack, self.B, self.Y = slack, field.B[slack], Y[:, slack]

        self.push = ck * field.stiff[slack]
        self.small = None

        # D^-1 - B_S Y_S of (1)
        if slack.size:
            self.small = sl.lu_factor(np.diag(1.0 / self.push) - self.B @ self.Y)

    def solve(self, b: Array) -> Array:
        """x = (1) b, judged by its true residual."""
        z = self.base.solve(b)
        if self.small is not None:
            z = z + self.Y @ sl.lu_solve(self.small, self.B @ z)
        return self._judged(z, b)

    def in_c(self) -> InC | None:
        """As that of the taut wires, where none is slack."""
        return None if self.slack.size else self.base.in_c()

    def solve_columns(self, H: Array) -> Array:
        """(1) for columns (n, k)."""
        Z = self.base.solve_columns(H)
        if self.small is not None and H.shape[1]:
            Z = Z + self.Y @ sl.lu_solve(self.small, self.B @ Z)
        for z, h in zip(Z.T, H.T, strict=True):
            self._judged(np.asarray(z), np.asarray(h))
        return np.asarray(Z)

    def _judged(self, x: Array, b: Array) -> Array:
        """x, when it solves (E - B_S^T D B_S) x = b; the judge of E has seen the solve without slack droppers."""
        if self.small is None:
            self.judge.solves += 1
            self.judge.worst = max(self.judge.worst, self.base.judge.worst)
            return x
        f, (cm, ck) = self.field, self.weights
        r = cm * f.mass(x[:, None])[:, 0] + ck * f.tangent(x) - self.B.T @ (self.push * (self.B @ x)) - b
        norm = np.linalg.norm
        self.judge.check(float(norm(r)), float(norm(b)), grown=self.base.factor.norm * float(norm(x)))
        return x

    def destroy(self) -> None:
        """Use the taut factor no more; it stays with the field, whose ``free_factors`` frees it."""
        self.taut.users -= 1


class HeavierFactor(FieldFactor):
    """E + V C V^T by a factor of E, with columns V (n, k) of this rank's entries and a small C (k, k): as (1),

        (E + V C V^T)^-1 = E^-1 - Y (1 + C V^T Y)^-1 C V^T E^-1,       Y = E^-1 V                           (2)

    E^-1 and Y are judged by the factor of E; what is left of a residual is that of the small matrix.
    """

    def __init__(self, base: FieldFactor, V: Array, C: Array, total: Any) -> None:
        self.base, self.V, self.C, self.total = base, V, C, total
        self.judge, self.fresh, self.hidden = base.judge, base.fresh, base.hidden
        self.Y = base.solve_columns(V)
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
        """x = (2) b."""
        return self._corrected(self.base.solve(b))

    def solve_columns(self, B: Array) -> Array:
        """(2) for columns (n, k)."""
        return self._corrected(self.base.solve_columns(B))

    def _corrected(self, z: Array) -> Array:
        return np.asarray(z - self.Y @ (self.small @ self.total(self.V.T @ z)))

    def destroy(self) -> None:
        """Free the factor of E."""
        self.base.destroy()
