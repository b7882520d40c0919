"""The matrix of an implicit step (:mod:`.pencil`) as a sparse one, of stages that have a tangent each.

With D = S - J and S the rates of all stages, d rate / d xi, the unknowns (dxi, dlambda, dmu, dtau, dN) have the columns

    by_q + (by_v + by_a S) D,      G^T,      (by_v + by_a S) U,      by_a U,      [R^T; -1]                          (1)

whose factors grow with the length of a chain. Rows that depend on each other are softened, as compiled factors do it (lu.c): with
the phase of their compliance by the masses, so that the two never cancel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu

from ...errors import LinearSolveError
from ...rotations import Array
from ...system.tangents.step_tangent import StepTangent
from ..redundancy import CORRECTED, SOFT
from ..residual import Judge
from .pencil import OPEN_ROWS, REFINED, SINGULAR_MATRIX


def stacked(tangents: list[StepTangent]) -> StepTangent:
    """The tangent of several stages together, stage by stage."""
    names = vars(tangents[0])
    return StepTangent(**{name: _diagonal([getattr(t, name) for t in tangents]) for name in names})


def _diagonal(blocks: list[Any]) -> Any:
    """Sparse matrices of one shape on the diagonal."""
    (rows, columns), k = blocks[0].shape, len(blocks)
    ends = np.cumsum([0, *(b.nnz for b in blocks)])
    start = [b.indptr[:-1] + end for b, end in zip(blocks, ends[:-1], strict=True)]
    at = [b.indices + i * columns for i, b in enumerate(blocks)]
    data = np.concatenate([b.data for b in blocks])
    return sp.csr_matrix(
        (data, np.concatenate(at), np.append(np.concatenate(start), ends[-1])), shape=(k * rows, k * columns)
    )


class WholePencil:
    """(1) for one or more rates S of k stages, (k, k) each; the tangent is that of k stages, with sparse matrices.

    ``first``: level of the first rows; ``units``: of the multipliers of rows that depend on each other, (m,), None: none do.
    """

    room: None = None

    def __init__(self, tangent: StepTangent, rates: list[Array], judge: Judge, first: int, units: Array | None) -> None:
        self.matrices, self.judge, self.softened = tangent, judge, units is not None
        self.stages = k = len(rates[0])
        self.m, self.n = (x // k for x in tangent.G.shape)
        self.size, self.ties = tangent.by_q.shape[0] // k, tangent.R.shape[0] // k
        self.levels = (self.size - self.n - self.ties) // self.m if self.m else 0
        self.systems = [_Whole(self, S, first, units) for S in rates]

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """As :meth:`.Pencil.solve`; of stages, (k, ..) each, for one S."""
        given = zip(kin.reshape(len(self.systems), -1), low.reshape(len(self.systems), -1), strict=True)
        found = [one.solve(*x) for one, x in zip(self.systems, given, strict=True)]
        change, mult = (np.concatenate(x) for x in zip(*found, strict=True))
        return change, mult


class _Whole:
    """One of the systems of a pencil."""

    def __init__(self, pencil: WholePencil, S: Array, first: int, units: Array | None) -> None:
        T, n, m, ties = pencil.matrices, pencil.n, pencil.m, pencil.ties
        self.pencil = pencil
        rates = sp.kron(S, sp.identity(n), format="csr")
        self.D = rates - T.J
        self.va = T.by_v + T.by_a @ rates

        balance, efforts = self._placed(0, n), self._placed(pencil.size - ties, ties)
        across = [balance @ T.G.T, self.va @ T.U, T.by_a @ T.U][: pencil.levels]
        tied = [balance @ T.R.T - efforts] if ties else []
        if units is not None:
            softness = self._softness(S, first, units)
            across = [
                x + self._placed(n + i * m, m) @ soft for i, (x, soft) in enumerate(zip(across, softness, strict=True))
            ]
            self.softness = sp.block_diag(softness, format="csr")
        self._factor(sp.hstack((T.by_q + self.va @ self.D, *across, *tied), format="csc"))

    def _placed(self, first: int, count: int) -> Any:
        """Where so many rows of each stage stand among all, from a row of theirs on; (rows, stages times count)."""
        o = self.pencil
        rows = (np.arange(o.stages)[:, None] * o.size + first + np.arange(count)).ravel()
        return sp.csr_matrix((np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(o.stages * o.size, len(rows)))

    def _softness(self, S: Array, first: int, units: Array) -> list[Any]:
        """What rows that depend on each other have on their multipliers, level by level, by the masses."""
        every = np.tile(units, len(S))
        M: Any = self.pencil.matrices.M
        G: Any = self.pencil.matrices.G
        masses = M.diagonal()
        light = np.where(masses > 0, 1.0 / np.where(masses > 0, masses, 1.0), 0.0)
        soft = SOFT * (every**2 * (G.power(2) @ light)).max(initial=0.0) / every**2
        compliance = -np.linalg.matrix_power(np.linalg.inv(S), 2 - first)
        pulled = sp.kron(compliance, sp.identity(len(units))) @ sp.diags(soft)
        return [pulled, *[sp.diags(soft)] * (self.pencil.levels - 1)]

    def _factor(self, K: Any) -> None:
        judge = self.pencil.judge
        if not np.isfinite(K.data).all():
            raise LinearSolveError(f"{judge.what}: the matrix is not finite.")
        self.rows, self.columns = _balance(K)
        self.matrix = K
        try:
            self.lu: SuperLU = splu(K)
        except RuntimeError as error:
            raise LinearSolveError(f"{judge.what}: {SINGULAR_MATRIX}") from error

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """Increments dxi, dv side by side, (k, 2 n), and multipliers (k, ..), for the residuals of all stages."""
        o, rhs = self.pencil, -self.rows * (low + self.va @ kin)
        y = self._back(rhs)
        left, size = self._left(rhs, y, o.size)
        if left > REFINED * size:
            y = y + self._back(rhs - self.matrix @ y)
            left, size = self._left(rhs, y, o.size)
        for times in CORRECTED if o.softened else ():
            y = y + self._back(times * self._open(y))
        if o.softened:  # rows that contradict each other stay open
            left, size = self._left(rhs, y, o.n)
        o.judge.check(left, size, OPEN_ROWS)

        k, n, m = o.stages, o.n, o.m
        z = self.columns * y
        dxi, by_level = z[: k * n], z[k * n : k * (n + o.levels * m)].reshape(o.levels, k, m)
        dv = self.D @ dxi + kin
        if o.levels > 1:
            dv = dv + o.matrices.U @ by_level[1].ravel()
        change = np.concatenate((dxi.reshape(k, n), dv.reshape(k, n)), axis=1)
        efforts = z[k * (n + o.levels * m) :].reshape(k, o.ties)
        return change, np.concatenate((*by_level, efforts), axis=1)

    def _open(self, y: Array) -> Array:
        """By what softness leaves rows open."""
        o, soft = self.pencil, np.zeros_like(y)
        of_rows = slice(o.stages * o.n, o.stages * (o.n + o.levels * o.m))
        left = (self.softness @ (self.columns * y)[of_rows]).reshape(o.levels, o.stages, o.m)
        soft.reshape(o.stages, o.size)[:, o.n : o.n + o.levels * o.m] = left.swapaxes(0, 1).reshape(o.stages, -1)
        return np.asarray(self.rows * soft)

    def _back(self, b: Array) -> Array:
        return np.asarray(self.lu.solve(b.astype(self.matrix.dtype)))

    def _left(self, rhs: Array, y: Array, rows: int) -> tuple[float, float]:
        """Largest residual of the first rows of each stage, and its scale."""
        left = np.abs(self.matrix @ y - rhs).reshape(self.pencil.stages, -1)[:, :rows]
        size = np.abs(rhs).max(initial=0.0) + np.abs(y).max(initial=0.0)
        return float(left.max(initial=0.0)), float(size)


def _balance(K: Any) -> tuple[Array, Array]:
    """Scale the rows and columns of a matrix so that all largest entries are near one, by powers of two, which are returned."""
    A, at = np.abs(K.data), (K.indices, np.repeat(np.arange(K.shape[1]), np.diff(K.indptr)))
    scales = np.ones(K.shape[0]), np.ones(K.shape[1])
    for side, root in ((0, 2), (1, 2), (0, 2), (1, 2), (0, 1)):
        most = np.zeros(K.shape[side])
        np.maximum.at(most, at[side], A)
        share = np.exp2(np.rint(np.log2(np.where(most > 0, most, 1.0)) / root))
        A = A / share[at[side]]
        scales[side][:] /= share
    K.data *= scales[0][at[0]] * scales[1][at[1]]
    return scales
