"""The matrix of an implicit step of a constrained system with velocities as unknowns, for a real or complex frequency s.

The equations of a step, with U = M^-1 G^T the normal directions, multipliers lambda, mu, tau (see
:mod:`fmbd_fenicsx.schemes.dae`) and increments d,

    s dxi - J dxi - dv + U dmu = -r_kin,        a = s v + U tau
    [K; P] dxi + [C; Q] dv + [M; S] da + [G^T dlambda; 0] = -r_low                                             (1)

are reduced to the unknowns (dxi, dlambda, dmu, dtau): with D = s - J the first row gives dv = D dxi + U dmu + r_kin. The rest is
dense, scaled by rows and columns, factored by LAPACK. A stiffly damped mode, a free body and an index-3 constraint all have
the same condition number, whatever s.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.linalg as sl

from ..errors import LinearSolveError
from ..rotations import Array
from .residual import Judge


@dataclass(frozen=True)
class Tangent:
    """Coefficients of (1): J, M (n, n); G (m, n); U (n, m); derivatives of the lower rows by xi, v, a: (n + k m, n) each."""

    J: Array
    M: Array
    G: Array
    U: Array
    by_q: Array
    by_v: Array
    by_a: Array


def stacked(tangents: list[Tangent]) -> Tangent:
    """The tangent of several stages together: variables and balances stage by stage, then each constraint level stage by
    stage.
    """
    n, m = tangents[0].M.shape[0], tangents[0].G.shape[0]

    def lower(name: str) -> Array:
        blocks = [getattr(t, name) for t in tangents]
        cuts = [0, *range(n, blocks[0].shape[0] + 1, m)] if m else [0, n]
        return np.concatenate([sl.block_diag(*(b[i:j] for b in blocks)) for i, j in pairwise(cuts)])

    def diagonal(name: str) -> Array:
        return np.asarray(sl.block_diag(*(getattr(t, name) for t in tangents)))

    J, M, G, U = (diagonal(name) for name in ("J", "M", "G", "U"))
    return Tangent(J, M, G, U, lower("by_q"), lower("by_v"), lower("by_a"))


class Pencil:
    """(1) factored for one s: a number, or a matrix (n, n) for coupled stages. ``redundant``: dependent constraints are
    solved with multipliers of least norm.
    """

    def __init__(self, tangent: Tangent, s: Any, judge: Judge, redundant: bool = False) -> None:
        self.s, self.judge, self.t = s, judge, tangent
        T, n, m = tangent, tangent.M.shape[0], tangent.G.shape[0]
        self.n, self.m, self.levels = n, m, (T.by_q.shape[0] - n) // m if m else 0
        S = s if isinstance(s, np.ndarray) else s * np.eye(n)
        self.D = S - T.J
        self.va = T.by_v + T.by_a @ S  # lower rows by v, with a = s v
        K = np.zeros((n + self.levels * m,) * 2, dtype=np.result_type(self.va, self.D))
        K[:, :n] = T.by_q + self.va @ self.D
        if self.levels > 0:
            K[:n, n : n + m] = T.G.T
        if self.levels > 1:
            K[:, n + m : n + 2 * m] = self.va @ T.U
        if self.levels > 2:
            K[:, n + 2 * m :] = T.by_a @ T.U
        self.matrix = K
        self._factor(redundant)

    def _factor(self, redundant: bool) -> None:
        K = self.matrix
        if not np.isfinite(K).all():
            raise LinearSolveError(f"{self.judge.what}: the matrix is not finite.")
        self.rows, self.columns = _balance(K)
        self.redundant = redundant
        scaled = self.rows[:, None] * K * self.columns
        if redundant:
            inverse = np.linalg.pinv(scaled, rcond=1e-11)
            self._solve = lambda b: inverse @ b
            return
        lu, pivots, info = sl.get_lapack_funcs("getrf", (scaled,))(scaled)
        if info != 0:
            raise LinearSolveError(
                f"{self.judge.what}: the matrix is singular (pivot {info}). Constraints depend on each other, or a body without "
                "mass is not held. See scene.check()."
            )
        getrs = sl.get_lapack_funcs("getrs", (scaled,))
        self._solve = lambda b: getrs(lu, pivots, b)[0]

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array, Array]:
        """Increments dxi (n,), dv (n,) and multipliers (levels, m) for residuals r_kin (n,), r_low (n + levels m,)."""
        rhs = -low - self.va @ kin
        z = self.columns * self._solve(self.rows * rhs)
        if not np.isfinite(z).all():
            raise LinearSolveError(f"Linear solve of {self.judge.what}: the solution is not finite.")
        left = self.rows * (self.matrix @ z - rhs)
        size = np.linalg.norm(self.rows * rhs) + np.linalg.norm(z / self.columns)
        if self.redundant:  # dependent rows agree up to the nonlinear residual only
            left = left[: self.n]
        self.judge.check(
            float(np.linalg.norm(left)),
            float(size),
            "Constraints depend on each other, or a body is not held.",
        )
        dxi, mult = z[: self.n], z[self.n :].reshape(self.levels, self.m)
        dv = self.D @ dxi + kin
        if self.levels > 1:
            dv = dv + self.t.U @ mult[1]
        return dxi, dv, mult


def _balance(K: Any) -> tuple[Array, Array]:
    """Row and column scales that bring all largest entries near one (two sweeps), as powers of two: no rounding."""
    A = np.abs(K)
    rows, columns = np.ones(len(A)), np.ones(len(A))
    for _ in range(2):
        rows /= _power(np.sqrt((rows[:, None] * A * columns).max(axis=1, initial=0.0)))
        columns /= _power(np.sqrt((rows[:, None] * A * columns).max(axis=0, initial=0.0)))
    rows /= _power((rows[:, None] * A * columns).max(axis=1, initial=0.0))
    return rows, columns


def _power(x: Array) -> Array:
    return np.exp2(np.round(np.log2(np.where(x > 0, x, 1.0))))
