"""The core of a constrained step: a small symmetric saddle point, dense or sparse, scaled before it is factored.

    [ A  G^T ] [ x ]   [ b ]
    [ G   0  ] [ y ] = [ c ]                                                                             (1)

Rows and columns are scaled by D = diag(A)^-1/2 and by the row norms of G D, so that masses, lengths and step sizes of any
size give the same condition number (the step's own h-scaling is in A, see :mod:`fmbd_fenicsx.schemes`). Dependent rows of
G are solved in the minimum-norm sense when the caller allows it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from ..errors import LinearSolveError
from ..rotations import Array
from .residual import Judge

RANK_TOLERANCE = 1e-11
SINGULAR = 1e-7  # ratio of pivots below which a matrix is solved in the minimum-norm sense
LARGEST_GROWTH = 1e13  # of a solution over its right-hand side, both scaled
ADVICE = "Constraints depend on each other, or a body without mass is not held. See scene.check()."


class CoreSolver:
    """Factor (1) and solve it. ``redundant`` permits dependent constraint rows: multipliers of minimum norm.

    ``ratio`` tells how close to singular the last factored matrix was (smallest over largest pivot; with redundant rows:
    of the singular values kept).
    """

    def __init__(self, judge: Judge, redundant: bool = False) -> None:
        self.judge, self.redundant = judge, redundant
        self.factorisations = 0
        self.ratio = 1.0
        self.rank: int | None = None  # of the constraints, where they are redundant
        self._sparse: Any = None

    def factor(self, A: Any, G: Any, C: Array | None = None) -> None:
        """Factor for A (n, n) and rows G (m, n), both dense or both sparse; C (m, m) stands for the 0 where given."""
        self.A, self.G, self.C = A, G, C
        self.n, self.m = A.shape[0], G.shape[0]
        if self.n + self.m == 0:  # absolute bodies without joints: nothing replicated
            return
        self.factorisations += 1
        self.ratio = 1.0
        D, E = _scales(A, G, C)
        self.scale = np.concatenate((D, E))
        self.exact = not self.redundant
        if sp.issparse(A) and not self.redundant:
            self._factor_sparse()
            return
        A = A.toarray() if sp.issparse(A) else A
        G = G.toarray() if sp.issparse(G) else G
        n, m = self.n, self.m
        K = np.empty((n + m, n + m))
        K[:n, :n] = D[:, None] * A * D
        K[n:, :n] = E[:, None] * G * D
        K[:n, n:] = K[n:, :n].T
        K[n:, n:] = 0.0 if C is None else E[:, None] * C * E
        if self.redundant:
            self._factor_redundant(K)
            return
        if not np.isfinite(K).all():
            raise LinearSolveError(f"{self.judge.what}: the matrix is not finite.")
        lu, pivots, _ = sl.lapack.dgetrf(K)
        pivot = np.abs(lu.diagonal())
        self.ratio = float(pivot.min() / pivot.max())
        if self.ratio < SINGULAR:  # passing through a singular configuration
            self.exact = False
            self._factor_any(K)
            return
        self._solve = lambda b: sl.lapack.dgetrs(lu, pivots, b)[0]

    def _factor_sparse(self) -> None:
        S = sp.diags(self.scale)
        K = sp.bmat([[self.A, self.G.T], [self.G, self.C]], format="csc")
        try:
            self._sparse = spl.splu((S @ K @ S).tocsc())
        except RuntimeError as error:
            raise LinearSolveError(f"{self.judge.what}: {error}. {ADVICE}") from error
        self._solve = self._sparse.solve

    def _factor_redundant(self, K: Array) -> None:
        """Range-space solution with a pseudo-inverse of G A^-1 G^T: dependent rows share their multiplier evenly."""
        n = self.n
        if self.C is not None or not np.abs(K[:n, :n]).max(axis=1, initial=0.0).all():
            self._factor_any(K)
            return
        lu = sl.lu_factor(K[:n, :n])
        B = K[n:, :n]
        AB = sl.lu_solve(lu, K[:n, n:])
        U, s, Vt = np.linalg.svd(B @ AB)
        keep = s > RANK_TOLERANCE * s[0]
        if self.rank is None:
            self.rank = int(keep.sum())
        self.ratio = float(s[self.rank - 1] / s[0]) if self.rank else 1.0
        S = (Vt[keep].T / s[keep]) @ U[:, keep].T

        def solve(b: Array) -> Array:
            z = sl.lu_solve(lu, b[:n])
            y = S @ (B @ z - b[n:])
            return np.concatenate((z - AB @ y, y))

        self._solve = solve

    def _factor_any(self, K: Array) -> None:
        """Solution of smallest norm by singular values of the whole matrix; null motions must not be among them."""
        U, s, Vt = np.linalg.svd(K)
        keep = s > RANK_TOLERANCE * s[0]
        rows = (Vt[~keep, : self.n] ** 2).sum(1)
        if rows.max(initial=0.0) > 1e-6:
            raise LinearSolveError(f"{self.judge.what}: a motion has neither mass nor stiffness. {ADVICE}")
        inverse = (Vt[keep].T / s[keep]) @ U[:, keep].T
        self._solve = lambda b: inverse @ b

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x (n,) and y (m,) for right-hand sides b, c; judged by the true residual (rows of A only when redundant)."""
        n = self.n
        if self.n + self.m == 0:
            return b, c
        rhs = self.scale * np.concatenate((b, c))
        z = self.scale * self._solve(rhs)
        x, y = z[:n], z[n:]
        upper = self.A @ x + self.G.T @ y - b
        lower = self.G @ x - c if self.C is None else self.G @ x + self.C @ y - c
        residual = np.linalg.norm(self.scale[:n] * upper)
        if self.exact:
            residual = np.hypot(residual, np.linalg.norm(self.scale[n:] * lower))
        given, found = np.linalg.norm(rhs), np.linalg.norm(z / self.scale)
        if found > LARGEST_GROWTH * given:  # against such a solution the residual of a singular matrix is small
            residual = np.inf
        self.judge.check(float(residual), float(given + found), ADVICE)
        return x, y


def _scales(A: Any, G: Any, C: Array | None) -> tuple[Array, Array]:
    """Scales of rows and columns: diag(A)^-1/2 and row norms of G D; with a block C, square roots of the row maxima."""
    if C is not None:
        rows = np.concatenate((np.concatenate((A, G.T), axis=1), np.concatenate((G, C), axis=1)))
        top = np.abs(rows).max(axis=1)
        scale = 1.0 / np.sqrt(np.where(top > 0, top, 1.0))
        return scale[: len(A)], scale[len(A) :]
    diagonal = np.asarray(A.diagonal())
    largest = max(float(np.abs(diagonal).max(initial=0.0)), 1e-300)
    D = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, largest))
    if sp.issparse(G):
        norms = np.sqrt(np.asarray(G.multiply(D).power(2).sum(1)).ravel())
    else:
        norms = np.sqrt(((G * D) ** 2).sum(1))
    return D, 1.0 / np.where(norms > 0, norms, 1.0)
