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


class CoreSolver:
    """Factor (1) and solve it; ``redundant`` permits dependent constraint rows (minimum-norm multipliers)."""

    def __init__(self, judge: Judge, redundant: bool = False) -> None:
        self.judge, self.redundant = judge, redundant
        self.factorisations = 0

    def factor(self, A: Any, G: Any, C: Array | None = None) -> None:
        """Factor for A (n, n) and rows G (m, n), both dense or both sparse; C (m, m) stands for the 0 where given."""
        self.A, self.G, self.C = A, G, C
        self.n, self.m = A.shape[0], G.shape[0]
        if self.n + self.m == 0:  # absolute bodies without joints: nothing replicated
            return
        self.factorisations += 1
        D, E = _scales(A, G, C)
        self.scale = np.concatenate((D, E))
        if sp.issparse(A) and not self.redundant:
            S = sp.diags(self.scale)
            K = sp.bmat([[A, G.T], [G, None]], format="csc")
            self._sparse = spl.splu((S @ K @ S).tocsc())
            self._solve = self._sparse.solve
            return
        A = A.toarray() if sp.issparse(A) else A
        G = G.toarray() if sp.issparse(G) else G
        n, m = self.n, self.m
        K = np.zeros((n + m, n + m))
        K[:n, :n] = D[:, None] * A * D
        K[n:, :n] = E[:, None] * G * D
        K[:n, n:] = K[n:, :n].T
        if C is not None:
            K[n:, n:] = E[:, None] * C * E
        if self.redundant:
            self._factor_redundant(K)
            return
        lu, pivots, info = sl.lapack.dgetrf(K, overwrite_a=1)
        if info != 0 or not np.isfinite(lu).all():
            raise LinearSolveError(
                f"{self.judge.what}: the matrix is singular (pivot {info}). Constraints depend on each other, or a body "
                "without mass is not held. See scene.check()."
            )
        self._solve = lambda b: sl.lapack.dgetrs(lu, pivots, b)[0]

    def _factor_redundant(self, K: Array) -> None:
        """Range-space solution with a pseudo-inverse of G A^-1 G^T: dependent rows share their multiplier evenly."""
        n = self.n
        lu = sl.lu_factor(K[:n, :n])
        B = K[n:, :n]
        AB = sl.lu_solve(lu, K[:n, n:])
        S = np.linalg.pinv(B @ AB, rcond=RANK_TOLERANCE, hermitian=False)

        def solve(b: Array) -> Array:
            z = sl.lu_solve(lu, b[:n])
            y = S @ (B @ z - b[n:])
            return np.concatenate((z - AB @ y, y))

        self._solve = solve

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
        if not self.redundant:
            residual = np.hypot(residual, np.linalg.norm(self.scale[n:] * lower))
        size = np.linalg.norm(rhs) + np.linalg.norm(z / self.scale)
        self.judge.check(float(residual), float(size), "Constraints depend on each other, or a body is not held.")
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
