"""The transient saddle point of elastic bodies tied by trace multipliers, as PETSc blocks with names.

    [ E_1              B_1^T ] [ u_1 ]   [ f_1 ]
    [      ...          ...  ] [ ... ] = [ ... ]        E_k = cm M_k + ck K_k,    cm = 0: statics           (1)
    [ B_1  ...          0    ] [ lam ]   [ g   ]

Displacements are distributed over the ranks like the meshes. Multipliers are few: every rank holds all their values
in the arrays of this module; inside PETSc their rows are split evenly. Blocks carry names ("rod.u", "pin.force")
which are the names of the splits under ``-<prefix>fieldsplit_<name>_...``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp

from ...errors import InputError
from ...fem.assembly import petsc_of
from ...ranks import together
from ...rotations import Array
from ..rigid_modes import elastic_matrix
from .elastic import Elastic
from .ties import TraceTie


@dataclass
class Solution:
    """Displacements (this rank's share, one array per body), multipliers (replicated, one per tie), and how
    they came.
    """

    u: list[Array]
    multipliers: list[Array]
    iterations: int
    residual: float
    counters: dict[str, float] = field(default_factory=dict)


class SaddlePoint:
    """System (1) as a PETSc nest with named blocks; collective to build and to destroy."""

    def __init__(self, elastic: Sequence[Elastic], ties: Sequence[TraceTie]) -> None:
        from petsc4py import PETSc

        # softest body: a stiff one without inertia is held by its neighbours, which sets the scale of its rigid motion
        softest = min(e.ck * e.modulus for e in elastic)
        self.elastic = tuple(
            replace(e, stand_in=e.static_inertia * softest / (e.ck * e.modulus)) if e.cm == 0 else e for e in elastic
        )

        self.ties = tuple(ties)
        self.comm = elastic[0].body.comm
        together(self.comm, self._check())
        self.names = [e.name for e in elastic] + [t.name for t in ties]

        # rows of a tie are split evenly among the ranks
        shares = [share_of(t.rows, self.comm) for t in self.ties]
        self.rows = [e.rows for e in self.elastic] + shares
        self.E = [elastic_matrix(e.body, e.cm, e.ck) for e in elastic]
        self._own: list[Any] = []
        self.table = self._blocks(shares)

        self.matrix = PETSc.Mat().createNest(self.table, comm=self.comm)
        self.matrix.assemble()
        self.sets = self.matrix.getNestISs()[0]
        # mean sizes of the columns of each block, for the residual
        self.norms = [
            [0.0 if M is None else M.norm(PETSc.NormType.FROBENIUS) / M.getSize()[0] ** 0.5 for M in row]
            for row in self.table
        ]

    def _blocks(self, shares: list[int]) -> list[list[Any]]:
        """The blocks of (1), None where there is nothing; ``shares``: of the rows of each tie on this rank."""
        n, size = len(self.E), len(self.names)
        table: list[list[Any]] = [[None] * size for _ in range(size)]
        for k, E in enumerate(self.E):
            table[k][k] = E
        for i, (tie, share) in enumerate(zip(self.ties, shares, strict=True)):
            for k, B in tie.columns:
                up = _transposed(B, share, tie.rows, self.elastic[k], self.comm)
                down = up.copy()
                down.transpose()
                table[k][n + i], table[n + i][k] = up, down
                self._own += [up, down]
        return table

    def _check(self) -> Exception | None:
        """What cannot be a well-posed system: statics of bodies with no tie, names that appear twice."""
        held = {k for t in self.ties for k, _ in t.columns}
        for k, e in enumerate(self.elastic):
            if e.cm == 0 and k not in held:
                return InputError(
                    f'Body "{e.body.name}" has no inertia (statics) and no tie holds it. Tie it, or give cm > 0.'
                )
        names = [e.name for e in self.elastic] + [t.name for t in self.ties]
        twice = sorted({n for n in names if names.count(n) > 1})
        return InputError(f"Blocks with the same name: {twice}.") if twice else None

    def diagonal(self, k: int) -> Array:
        """diag(E_k) on this rank; collective."""
        v = self.E[k].getDiagonal()
        out = np.array(v.array)
        v.destroy()
        return out

    @property
    def n_multipliers(self) -> int:
        """All multipliers."""
        return sum(t.rows for t in self.ties)

    def vector(self, u: Sequence[Array], lam: Sequence[Array]) -> Any:
        """A PETSc vector from displacement blocks (this rank's) and multiplier blocks (replicated)."""
        b = self.matrix.createVecLeft()
        b.array[:] = np.concatenate([*u, *(x[self._slice(x.size)] for x in lam)])
        return b

    def blocks(self, x: Any) -> tuple[list[Array], list[Array]]:
        """The reverse of :meth:`vector`; collective."""
        parts = np.split(x.array.copy(), np.cumsum(self.rows)[:-1])
        n = len(self.elastic)
        return parts[:n], [np.concatenate(self.comm.allgather(p)) for p in parts[n:]]

    def _slice(self, n: int) -> slice:
        low = sum(share_of(n, self.comm, r) for r in range(self.comm.rank))
        return slice(low, low + share_of(n, self.comm))

    def relative_residual(self, x: Any, b: Any) -> float:
        """|A x - b| / |b| over blocks, each block measured against its own terms: the largest; collective.

        A block's size is |b_i| + sum_j |A_ij x_j| so that units and small blocks do not hide an error.
        """
        xs = [x.getSubVector(s) for s in self.sets]
        bs = [b.getSubVector(s) for s in self.sets]

        values, sizes, floors = np.zeros((3, len(bs)))
        given = np.array([v.norm() for v in bs])

        # residuals b - A x and the sizes of their terms
        for i, bi in enumerate(bs):
            r, y, sizes[i] = bi.copy(), bi.duplicate(), bi.norm()
            r.scale(-1.0)
            for j, xj in enumerate(xs):
                if self.table[i][j] is not None:
                    self.table[i][j].mult(xj, y)
                    sizes[i] += y.norm()
                    floors[i] += 1e-6 * self.norms[i][j] * xj.norm()  # rigid motions leave nothing but roundoff
                    r.axpy(1.0, y)
            values[i] = r.norm()
            r.destroy(), y.destroy()

        for s, v, w in zip(self.sets, xs, bs, strict=True):
            x.restoreSubVector(s, v), b.restoreSubVector(s, w)
        if not np.isfinite(values).all():
            return np.inf

        worst = 0.0
        for kind in (slice(0, len(self.elastic)), slice(len(self.elastic), None)):  # forces, constraints
            largest = given[kind].max(initial=0.0) or np.inf
            least = max(1e-6 * sizes[kind].max(initial=0.0), min(floors[kind].max(initial=0.0), largest), 1e-300)
            worst = max(worst, float((values[kind] / np.maximum(sizes[kind], least)).max(initial=0.0)))
        return worst

    def destroy(self) -> None:
        """Free all blocks; collective."""
        for M in (self.matrix, *self._own, *self.E):
            M.destroy()


class SaddleSolver(Protocol):
    """Solves (1)."""

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        """Displacements and multipliers for loads f (this rank's, one per body) and data g (replicated, one per tie)."""

    def destroy(self) -> None:
        """Free PETSc objects; collective."""


def share_of(n: int, comm: Any, rank: int | None = None) -> int:
    """Rows of n that a rank holds inside PETSc."""
    r = comm.rank if rank is None else rank
    return n // comm.size + (r < n % comm.size)


def _transposed(B: sp.csr_matrix, share: int, total: int, e: Elastic, comm: Any) -> Any:
    """B^T as a PETSc matrix: this rank's displacements by all multipliers."""
    return petsc_of(B.T, ((e.rows, e.body.n_global), (share, total)), comm)
