"""The matrix of an implicit step of a constrained system with velocities as unknowns, for a real or complex frequency s.

The equations of a step, with U = M^-1 G^T the normal directions, multipliers lambda, mu, tau (see
:mod:`fmbd_fenicsx.schemes.dae`) and increments d,

    s dxi - J dxi - dv + U dmu = -r_kin,        a = s v + U tau
    [K; P] dxi + [C; Q] dv + [M; S] da + [G^T dlambda + R^T dN; 0] = -r_low                                    (1)
    k R dxi + c R dv - dN = -r_N

with efforts N of stiff springs along R are reduced to the unknowns (dxi, dlambda, dmu, dtau, dN): with D = s - J the first row
gives dv = D dxi + U dmu + r_kin. The rest is dense, scaled by rows and columns, and inverted by LAPACK, all frequencies of a
scheme in one call: the matrices are small, and a step solves with them many times. Every solve is judged by its residual. A
stiffly damped mode, a free body and an index-3 constraint all have the same condition number, whatever s.
"""

from __future__ import annotations

import numpy as np

from ...errors import LinearSolveError
from ...rotations import Array, matvec
from ...system.tangents.step_tangent import StepTangent
from ..residual import Judge

REFINED = 1e-12  # relative residuals above this are refined once
OPEN_ROWS = "Constraints depend on each other, or a body is not held."
SINGULAR_MATRIX = (
    "the matrix is singular. Constraints depend on each other, or a body without mass is not held. See scene.check()."
)


class Pencil:
    """(1) inverted for frequencies s, (p,) real or complex, all in one array.

    ``redundant``: dependent constraints are solved with multipliers of least norm.
    """

    def __init__(self, tangent: StepTangent, s: Array, judge: Judge, redundant: int = 0) -> None:
        self.s, self.judge, self.t, self.redundant = s, judge, tangent, redundant
        T = tangent
        n = tangent.M.shape[0]
        m = tangent.G.shape[0]
        self.n = n
        self.m = m
        ties = T.R.shape[0]
        self.levels = (T.by_q.shape[0] - n - ties) // m if m else 0
        L = self.levels

        self.D = s[:, None, None] * np.eye(n) - T.J
        self.va = T.by_v + s[:, None, None] * T.by_a  # lower rows by v, with a = s v

        # rows of the balance; those of the constraints follow with their levels
        size = n + L * m + ties
        K = np.zeros((len(self.D), size, size), dtype=self.va.dtype)
        K[:, :, :n] = T.by_q + self.va @ self.D
        if L > 0:
            K[:, :n, n : n + m] = T.G.T
        if L > 1:
            K[:, :, n + m : n + 2 * m] = self.va @ T.U
        if L > 2:
            K[:, :, n + 2 * m : n + 3 * m] = T.by_a @ T.U
        if ties:
            K[:, :n, -ties:] = T.R.T
            K[:, range(size - ties, size), range(size - ties, size)] = -1.0

        self._factor(K)

    def _factor(self, K: Array) -> None:
        if not np.isfinite(K).all():
            raise LinearSolveError(f"{self.judge.what}: the matrix is not finite.")
        self.rows, self.columns = _equilibration(K)
        self.matrix = self.rows[:, :, None] * K * self.columns[:, None, :]
        try:
            self.inverse = np.linalg.pinv(self.matrix, rcond=1e-11) if self.redundant else np.linalg.inv(self.matrix)
        except np.linalg.LinAlgError as error:
            raise LinearSolveError(f"{self.judge.what}: {SINGULAR_MATRIX}") from error

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """Increments dxi, dv side by side (p, 2 n) and multipliers (p, levels m), for residuals r_kin (p, n) and r_low
        (p, n + levels m).
        """
        n, m = self.n, self.m
        rhs = -self.rows * (low + matvec(self.va, kin))
        y = matvec(self.inverse, rhs)
        left, size = self._left(rhs, y)
        # an inverse leaves cond(A) roundoffs, one refinement brings them down to those of a factor
        if left > REFINED * size:
            y = y + matvec(self.inverse, rhs - matvec(self.matrix, y))
            left, size = self._left(rhs, y)

        self.judge.check(left, size, OPEN_ROWS, solves=len(y))
        z = self.columns * y

        # rates follow from increments and the multipliers of lower levels
        dxi, mult = z[:, :n], z[:, n:]
        dv = matvec(self.D, dxi) + kin
        if self.levels > 1:
            dv = dv + mult[:, m : 2 * m] @ self.t.U.T
        return np.concatenate((dxi, dv), axis=1), mult

    def _left(self, rhs: Array, y: Array) -> tuple[float, float]:
        """Largest residual and its scale, of the frequency where the two are farthest apart."""
        left = np.abs(matvec(self.matrix, y) - rhs)
        if self.redundant:  # dependent rows agree up to the nonlinear residual only
            left = left[:, : self.n]
        largest = np.maximum.reduce  # what numpy.max calls
        size = largest(np.abs(rhs), axis=1, initial=0.0) + largest(np.abs(y), axis=1, initial=0.0)
        most = largest(left, axis=1, initial=0.0)
        worst = int((most / np.where(size > 0, size, 1.0)).argmax())
        return float(most[worst]), float(size[worst])


def _equilibration(K: Array) -> tuple[Array, Array]:
    """Row and column scales, (p, n) each, that bring all largest entries near one (two sweeps), as powers of two: no rounding."""
    A = np.abs(K)
    rows = np.ones(A.shape[:2])
    columns = np.ones(A.shape[:2])
    for _ in range(2):
        r = _power(np.sqrt(A.max(axis=2, initial=0.0)))
        A /= r[:, :, None]
        c = _power(np.sqrt(A.max(axis=1, initial=0.0)))
        A /= c[:, None, :]
        rows, columns = rows / r, columns / c
    return rows / _power(A.max(axis=2, initial=0.0)), columns


def _power(x: Array) -> Array:
    return np.exp2(np.rint(np.log2(np.where(x > 0, x, 1.0))))
