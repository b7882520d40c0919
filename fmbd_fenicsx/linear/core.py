"""The core of a constrained step: a small symmetric saddle point, dense or sparse, scaled before it is factored.

    [ A  G^T ] [ x ]   [ b ]
    [ G   0  ] [ y ] = [ c ]                                                                             (1)

Rows and columns are scaled (:func:`scales`). Where a dense factor loses pivots, even scales are taken for it, and residuals are
judged in the first ones as before; a sparse factor has the first ones only, and where it sees fields and loses pivots the dense
one takes its place. Dependent rows of G are solved in the minimum-norm sense when the caller allows it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl
from scipy.sparse.csgraph import connected_components

from ..errors import LinearSolveError
from ..matrices import dense, singular_values
from ..rotations import Array
from .residual import Judge

MOST_SCALINGS = 8  # of a matrix whose rows are of different size
SMALL_ROW = 0.1  # largest entry of a row, scaled, above which it is large enough
TIE_LIMIT = 1500  # multipliers of surface ties that the dense core takes
RANK_TOLERANCE = 1e-11
EPS = float(np.finfo(float).eps)
MOVES = 1e-6  # share of motions in a singular vector, above which it is no matter of multipliers alone
SINGULAR = 1e-7  # ratio of pivots below which a matrix is solved in the minimum-norm sense
LARGEST_GROWTH = 1e13  # of a solution over its right-hand side, both scaled
REFINEMENTS = 3  # of a solution whose residual is too large
ADVICE = "Constraints depend on each other, or a body without mass is not held. See scene.check()."


class Saddle:
    """The sparsity pattern of (1) with its columns in a given order."""

    def __init__(self, A: Any, G: Any) -> None:
        self.keys = tuple(x.copy() for M in (A, G) for x in (M.indptr, M.indices))
        n, m = A.shape[0], G.shape[0]
        self.size = n + m

        # entries of A, of G below it, and of G^T beside it
        of_a = np.repeat(np.arange(n), np.diff(A.indptr))
        of_g = np.repeat(np.arange(m), np.diff(G.indptr)) + n
        self.rows = np.concatenate((of_a, of_g, G.indices))
        self.cols = np.concatenate((A.indices, G.indices, of_g))
        self.reorder(np.arange(self.size))

    def fits(self, A: Any, G: Any) -> bool:
        """Whether A and G have the pattern this was made for."""
        now = tuple(x for M in (A, G) for x in (M.indptr, M.indices))
        return all(np.array_equal(x, y) for x, y in zip(self.keys, now, strict=True))

    def reorder(self, columns: np.ndarray) -> None:
        """Put column ``columns[k]`` at place k."""
        self.columns = np.asarray(columns)

        place = np.empty(self.size, dtype=np.int64)
        place[self.columns] = np.arange(self.size)
        at = place[self.cols]

        # entries by column, within it by row: compressed columns
        self.order = np.lexsort((self.rows, at))
        self.indices = self.rows[self.order].astype(np.int32)
        counts = np.bincount(at, minlength=self.size)
        self.indptr = np.concatenate(([0], np.cumsum(counts))).astype(np.int32)

    def matrix(self, A: Any, G: Any, scale: Array) -> Any:
        """The scaled matrix in compressed columns."""
        data = np.concatenate((A.data, G.data, G.data)) * scale[self.rows] * scale[self.cols]
        return sp.csc_matrix((data[self.order], self.indices, self.indptr), shape=(self.size, self.size))


class CoreSolver:
    """Factor (1) and solve it. ``redundant`` permits dependent constraint rows: multipliers of minimum norm;
    it is the number of corrections that solutions in compiled code take then, 0 where rows do not depend.

    ``ratio`` tells how close to singular the last factored matrix was (smallest over largest pivot; with redundant rows:
    of the singular values kept).
    """

    def __init__(self, judge: Judge) -> None:
        self.judge, self.redundant = judge, 0
        self.factorisations = 0
        self.ratio, self.exact = 1.0, True
        self.rank: int | None = None  # of the constraints, where they are redundant
        self._saddle: Saddle | None = None

    @property
    def uncounted(self) -> bool:
        """Whether some rows depend on others, so many rows that nobody has counted how many."""
        return bool(self.redundant) and self.rank is None

    def factor(self, A: Any, G: Any, C: Array | None = None, upper: Array | None = None) -> None:
        """Factor for A (n, n) and rows G (m, n), both dense or both sparse; C (m, m) stands for the 0 where given, and
        ``upper`` (n, m) for G^T.
        """
        self.A, self.G, self.C = A, G, C
        self.upper: Any = G.T if upper is None else upper
        self.n, self.m = A.shape[0], G.shape[0]
        if self.n + self.m == 0:  # absolute bodies without joints: nothing replicated
            return

        self.factorisations += 1
        self.ratio = 1.0
        self.scale = scales(A, G) if C is None else even_rows(self._whole())
        self._change: Any = 1.0  # of these scales for the factor
        self.exact = not self.redundant

        if sp.issparse(A) and not self.redundant and self._factor_sparse():
            return
        K = both_sides(dense(self._whole()), self.scale)
        if self.redundant:
            self._factor_redundant(K)
        else:
            self._factor_dense(K)

    def _even(self, K: Array) -> Array:
        """The scaled matrix K with all that joints move alike at one size."""
        self._change = even_scales(both_sides(K, 1.0 / self.scale), self.n) / self.scale
        return both_sides(K, self._change)

    def _factor_dense(self, K: Array) -> None:
        """LU, or, while passing through a singular configuration, what is left of the matrix there."""
        if not np.isfinite(K).all():
            raise LinearSolveError(f"{self.judge.what}: the matrix is not finite.")

        factor, solve = sl.get_lapack_funcs(("getrf", "getrs"), (K,))
        lu, pivots, _ = factor(K)
        self.ratio = _pivot_ratio(lu.diagonal())
        if self.ratio < SINGULAR and self.C is None:
            K = self._even(K)
            lu, pivots, _ = factor(K)
            self.ratio = _pivot_ratio(lu.diagonal())
        if self.ratio < SINGULAR:
            self.exact = False
            self._factor_any(K)
            return
        self._solve = lambda b: solve(lu, pivots, b)[0]

    def _whole(self) -> Any:
        """The matrix of (1), dense or sparse as A."""
        C = np.zeros((self.m, self.m)) if self.C is None else self.C
        if sp.issparse(self.A):
            return sp.block_array([[self.A, self.upper], [self.G, sp.csr_array(C)]], format="csc")
        return np.block([[self.A, dense(self.upper)], [dense(self.G), C]])

    def _factor_sparse(self) -> bool:
        """Sparse LU; its pattern and the order of its columns are those of the first factorisation while they fit. False where
        one that sees fields is singular: a dense factor tells what is left of it.
        """
        if self.C is not None:
            try:
                factor = spl.splu(both_sides(self._whole(), self.scale).tocsc())
            except RuntimeError:
                return False
            self.ratio = _pivot_ratio(factor.U.diagonal())
            self._solve = factor.solve
            return self.ratio >= SINGULAR
        A, G = self.A.tocsr(), self.G.tocsr()
        if self._saddle is None or not self._saddle.fits(A, G):
            # the fill-reducing order is found once; later factors take their columns in it
            self._saddle = Saddle(A, G)
            first = self._lu(self._saddle.matrix(A, G, self.scale), "COLAMD")
            self._saddle.reorder(first.perm_c)
        saddle = self._saddle
        lu = self._lu(saddle.matrix(A, G, self.scale), "NATURAL")

        def solve(b: Array) -> Array:
            x = np.empty_like(b)
            x[saddle.columns] = lu.solve(b)
            return x

        self._solve = solve
        return True

    def _lu(self, K: Any, order: str) -> Any:
        try:
            return spl.splu(K, permc_spec=order)
        except RuntimeError as error:
            raise LinearSolveError(f"{self.judge.what}: {error}. {ADVICE}") from error

    def _factor_redundant(self, K: Array) -> None:
        """Range-space solution with a pseudo-inverse of G W^-1 G^T: dependent rows share their multiplier evenly.

        W = A + G^T G has the same x where G x = c, and multipliers y - c; it is regular wherever A and G hold all motions, and
        of one size in bodies of any mass.
        """
        n = self.n
        if self.C is not None:
            self._factor_any(K)
            return
        K = self._even(K)
        B, upper = K[n:, :n], K[:n, n:]
        factor, back = sl.get_lapack_funcs(("getrf", "getrs"), (K,))
        lu, pivots, _ = factor(K[:n, :n] + upper @ B)
        if _pivot_ratio(lu.diagonal()) < SINGULAR:
            self._factor_any(K)
            return
        AB = back(lu, pivots, upper)[0]
        # singular values of the compliance of the rows: zero for those that depend on others
        U, s, Vt = singular_values(B @ AB)
        keep = s > RANK_TOLERANCE * s[0]
        if self.rank is None:
            self.rank = int(keep.sum())
        self.ratio = float(s[self.rank - 1] / s[0]) if self.rank else 1.0
        U, S = U[:, keep], (Vt[keep].conj().T / s[keep]) @ U[:, keep].conj().T

        def solve(b: Array) -> Array:
            z = back(lu, pivots, b[:n])[0]
            y = S @ (B @ z - b[n:])
            return np.concatenate((z - AB @ y, y + U @ (U.conj().T @ b[n:])))

        self._solve = solve

    def _factor_any(self, K: Array) -> None:
        """Solution of smallest norm by singular values of the whole matrix; null motions must not be among them.

        Multipliers that move next to nothing are left out; a motion of next to no inertia counts down to roundoff.
        """
        U, s, Vt = singular_values(K)
        share = (abs(Vt[:, : self.n]) ** 2).sum(1)
        keep = s > np.where(share > MOVES, len(s) * EPS, RANK_TOLERANCE) * s[0]
        # a null vector with a part in x is a motion that nothing holds
        lost = np.where(keep, 0.0, share)
        if lost.max(initial=0.0) > MOVES:
            error = LinearSolveError(f"{self.judge.what}: a motion has neither mass nor stiffness. {ADVICE}")
            error.motion = (self.scale * self._change)[: self.n] * Vt[int(np.argmax(lost)), : self.n].conj()
            raise error

        inverse = (Vt[keep].conj().T / s[keep]) @ U[:, keep].conj().T

        def solve(b: Array) -> Array:
            z = inverse @ b
            return np.asarray(z + inverse @ (b - K @ z))  # one refinement: stiff directions cost the first one digits

        self._solve = solve

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x (n,) and y (m,) for right-hand sides b, c; judged by the true residual (rows of A only when redundant)."""
        if self.n + self.m == 0:
            return b, c
        rhs = self.scale * np.concatenate((b, c))
        z = self._solution(rhs)
        x, y, left = self._residual(z, b, c)

        residual, given, found = _norm(left), _norm(rhs), _norm(z)
        for _ in range(REFINEMENTS):  # where stiff and soft parts meet, the factor alone leaves too few digits
            if not residual > self.judge.tolerance * (given + found):
                break
            better = z - self._solution(left)
            *both, left = self._residual(better, b, c)
            if not _norm(left) < 0.5 * residual:
                break
            z, (x, y), residual = better, both, _norm(left)

        # against a solution that grows in any scale the residual of a singular matrix is small
        if found > LARGEST_GROWTH * given and _norm(z / self._change) > LARGEST_GROWTH * _norm(rhs * self._change):
            residual = np.inf
        self.judge.check(residual, given + found, ADVICE)
        return x, y

    def _solution(self, rhs: Array) -> Array:
        """Scaled unknowns for a scaled right-hand side or columns of these."""
        return np.asarray((self._change * self._solve((self._change * rhs.T).T).T).T)

    def solve_columns(self, b: Array, c: Array) -> tuple[Array, Array]:
        """x (n, k) and y (m, k) for columns b, c: all at once, or one by one where a residual is too large at first."""
        if self.n + self.m == 0:
            return b, c
        rhs = self.scale[:, None] * np.concatenate((b, c))
        z = self._solution(rhs)
        x, y, left = self._residual(z, b, c)
        residual, given, found = (np.sqrt((abs(a) ** 2).sum(axis=0)) for a in (left, rhs, z))
        sizes = given + found
        if (residual <= self.judge.tolerance * sizes).all() and (found <= LARGEST_GROWTH * given).all():
            for k, size in enumerate(sizes):
                self.judge.check(float(residual[k]), float(size), ADVICE)
            return x, y
        each = [self.solve(b[:, k], c[:, k]) for k in range(b.shape[1])]
        return np.stack([x for x, _ in each], axis=1), np.stack([y for _, y in each], axis=1)

    def _residual(self, z: Array, b: Array, c: Array) -> tuple[Array, Array, Array]:
        """x, y of scaled unknowns z, and their scaled residual; arrays or columns."""
        unscaled = (self.scale * z.T).T
        x = unscaled[: self.n]
        y = unscaled[self.n :]
        upper = self.A @ x + self.upper @ y - b
        lower = self.G @ x - c if self.C is None else self.G @ x + self.C @ y - c
        left = np.concatenate((upper, lower if self.exact else np.zeros_like(lower)))
        return x, y, (self.scale * left.T).T


def _pivot_ratio(diagonal: Array) -> float:
    """Smallest over largest pivot."""
    pivot = np.abs(diagonal)
    return float(pivot.min(initial=np.inf) / pivot.max(initial=1e-300))


def _norm(x: Array) -> float:
    return math.sqrt(np.vdot(x, x).real)


def both_sides(K: Any, scale: Array) -> Any:
    """Rows and columns of a matrix scaled alike, dense or sparse."""
    return sp.diags_array(scale) @ K @ sp.diags_array(scale) if sp.issparse(K) else K * scale * scale[:, None]


def scales(A: Any, G: Any) -> Array:
    """Scales of rows and columns alike, for A (n, n) and G (m, n), both dense or both sparse, (n + m,):

        [ A  G^T ]        D = diag(A)^-1/2  for A,   the norms of the rows of G D  for G
        [ G   0  ]

    so that masses, lengths and step sizes of any size give the same condition number (the step's own h-scaling is in A, see
    :mod:`fmbd_fenicsx.schemes`). A body of hardly any mass between others makes the rows of its joints the same then, to
    roundoff: even scales leave all that joints move alike at one size. They need the whole matrix, dense.

    Source: Ruiz, A scaling algorithm to equilibrate both rows and columns norms in matrices, RAL-TR-2001-034.
    """
    diagonal = np.asarray(A.diagonal())
    largest = max(float(np.abs(diagonal).max(initial=0.0)), 1e-300)
    D = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, largest))

    if sp.issparse(G):
        norms = np.sqrt(np.asarray(G.multiply(D).power(2).sum(1)).ravel())
    else:
        norms = np.sqrt(((G * D) ** 2).sum(1))
    return np.concatenate((D, 1.0 / np.where(norms > 0, norms, 1.0)))


def even_scales(K: Array, n: int) -> Array:
    """Scales of the whole matrix K, with A (n, n), that bring what joints move alike to one size in G, whatever it weighs; of
    bodies that joints connect the heaviest has a mass of one.
    """
    part = connected_components(K, directed=False)[1]
    weight = np.sqrt(np.abs(K.diagonal()[:n]))

    def heaviest_one(scale: Array) -> Array:
        top = np.zeros(len(part))
        np.maximum.at(top, part[:n], weight * scale[:n])
        top = np.where(top > 0, top, 1.0)[part]
        return np.concatenate((scale[:n] / top[:n], scale[n:] * top[n:]))

    scale = heaviest_one(np.ones(len(part)))
    return heaviest_one(scale * even_rows(both_sides(K, scale)))


def even_rows(K: Any) -> Array:
    """Scales of any matrix, dense or sparse: roots of the row maxima, again while that leaves rows with small entries only."""
    rows = abs(K)
    scale = 1.0 / np.sqrt(_tops(rows))
    for _ in range(MOST_SCALINGS):
        top = _tops(both_sides(rows, scale))
        if top.min(initial=1.0) > SMALL_ROW:
            break
        scale = scale / np.sqrt(top)
    return scale


def _tops(rows: Any) -> Array:
    """Largest entry of each row and column, 1 for those of zeros."""
    of_columns, of_rows = (dense(rows.max(axis=k)).ravel() for k in (0, 1))
    top = np.maximum(of_columns, of_rows)
    return np.where(top > 0, top, 1.0)
