"""Dual multipliers eliminated locally: tied bodies as one symmetric positive definite system.

With a dual space (:class:`~fmbd_fenicsx.Dual`) the coupling D of a slave surface is diagonal on its inner nodes i, so that each
tie gives these at once from the master's nodes and from the nodes on the border of the surface (the cross-points, which stay),

    u_i = (g_j + M_j u_master - sum_(border) D_jb u_b) / D_ji,        u = T z + u_g                              (1)
    T^T E T z = T^T (f - E u_g),            lambda_j = (f - E u)_i / D_ji                                          (2)

with one multiplier j for each inner node i. No multipliers are left in the system, which is definite where the bodies have
inertia or are held. Source: Wohlmuth, doi:10.1137/S0036142999350929.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...errors import InputError
from ...rotations import Array
from ..residual import Judge
from ..saddle.saddle import Preset, SaddlePoint, Solution, TraceTie


@dataclass(frozen=True)
class Eliminated(Preset):
    """Ties by dual multipliers eliminated, the rest by a Cholesky factor."""

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> EliminatedSolver:
        """Eliminate and factor; collective.

        Raises:
            InputError: a tie without dual multipliers for all components, or a node that two ties would eliminate or share.
        """
        return EliminatedSolver(saddle, [_pivots(t) for t in saddle.ties], prefix)


@dataclass(frozen=True, eq=False)
class Pivots:
    """Of one tie: node i of each multiplier j on the slave's trace, (n,), and D_ji, (n,)."""

    nodes: np.ndarray
    diagonal: Array


def _pivots(t: TraceTie) -> Pivots:
    """An inner node for each multiplier, whose column of D has no other entry."""
    if t.multipliers is None or t.components != t.multipliers.trace.dim:
        raise InputError(f'Tie "{t.name}": only ties of all components by a multiplier space can be eliminated.')

    # entries of roundoff would hide columns with one entry
    D = sp.csc_matrix(t.sides[0][2])
    D.data[np.abs(D.data) < 1e-12 * np.abs(D.data).max()] = 0.0
    D.eliminate_zeros()

    # columns of inner nodes that one multiplier alone sees
    alone = np.flatnonzero(np.diff(D.indptr) == 1)
    alone = np.setdiff1d(alone, t.multipliers.trace.border)
    rows = D.indices[D.indptr[alone]]
    values = D.data[D.indptr[alone]]

    nodes = np.full(D.shape[0], -1)
    diagonal = np.ones(D.shape[0])
    nodes[rows], diagonal[rows] = alone, values
    if (nodes < 0).any():
        raise InputError(
            f'Tie "{t.name}": {int((nodes < 0).sum())} multipliers ({t.multipliers.name}) have no inner node of their own. '
            "Elimination needs Dual(), or another solver."
        )
    return Pivots(nodes, diagonal)


class EliminatedSolver:
    """Solves (2); collective to build, to solve and to destroy."""

    def __init__(self, saddle: SaddlePoint, pivots: Sequence[Pivots], prefix: str) -> None:
        from petsc4py import PETSc

        self.saddle, self.pivots = saddle, pivots
        self.judge = Judge("the eliminated system", 1e-9)
        bodies = saddle.elastic
        d = bodies[0].body.dim
        self.d, self.comm = d, saddle.comm

        self._refuse_shared()
        self.first = np.concatenate(([0], np.cumsum([e.rows for e in bodies])))  # of each body among this rank's rows

        # E of all bodies, then T^T E T
        n = len(bodies)
        table = [[saddle.E[i] if i == j else None for j in range(n)] for i in range(n)]
        nest = PETSc.Mat().createNest(table, comm=self.comm)
        self.E = nest.convert("aij", PETSc.Mat())
        nest.destroy()
        self.T = self._transformation()
        self.A = self.E.ptap(self.T)
        self.A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.A.setOption(PETSc.Mat.Option.SPD, True)

        self.ksp = PETSc.KSP().create(self.comm)
        self.ksp.setOptionsPrefix(prefix)
        self.ksp.setOperators(self.A)
        self.ksp.setType("preonly")
        self.ksp.getPC().setType("cholesky")
        self.ksp.getPC().setFactorSolverType("cholmod" if self.comm.size == 1 else "mumps")
        if self.comm.size > 1:
            self.ksp.getPC().setFactorSetUpSolverType()
            self.ksp.getPC().getFactorMatrix().setMumpsIcntl(14, 150)  # % of memory beyond the estimate
        self.ksp.setFromOptions()

    def _refuse_shared(self) -> None:
        """A node that a tie eliminates must not appear in another one."""
        gone: dict[tuple[int, int], str] = {}
        seen: dict[tuple[int, int], str] = {}

        # nodes by body and number over all ranks
        for t, p in zip(self.saddle.ties, self.pivots, strict=True):
            pivots: set[int] = {int(i) for i in p.nodes}
            for number, (k, trace, B) in enumerate(t.sides):
                low = self.saddle.elastic[k].body.space.dofmap.index_map.local_range[0]
                world = trace.values(low + np.arange(trace.n_owned, dtype=float)).astype(int)  # numbers over all ranks
                for i in np.unique(sp.coo_matrix(B).col):
                    key = (k, int(world[i]))
                    # it leaves with this tie, or one of its sides holds it
                    leaves = number == 0 and int(i) in pivots
                    other = seen.get(key, t.name) if leaves else gone.get(key, t.name)
                    if other != t.name:
                        raise InputError(
                            f'Ties "{other}" and "{t.name}" share nodes that one of them eliminates. Give the surface to the '
                            "other side, or take another solver."
                        )
                    seen[key] = t.name
                    if leaves:
                        gone[key] = t.name

    def _pivot_rows(self, number: int) -> np.ndarray:
        """This rank's first row of each eliminated node of a tie, -1 for nodes of other ranks."""
        (k, trace, _), p = self.saddle.ties[number].sides[0], self.pivots[number]
        own = trace.owned[p.nodes]
        return np.asarray(np.where(own >= 0, self.first[k] + self.d * own, -1))

    def _transformation(self) -> Any:
        """T of (1): this rank's displacements by the kept ones."""
        from petsc4py import PETSc

        d = self.d
        n = int(self.first[-1])

        pivots = [self._pivot_rows(i) for i in range(len(self.pivots))]
        stays = np.setdiff1d(np.arange(0, n, d), np.concatenate(pivots or [np.zeros(0, dtype=int)]))

        kept = d * len(stays)
        new = np.full(n, -1.0)  # column of the first component of each node
        new[stays] = int(self.comm.exscan(kept) or 0) + d * np.arange(len(stays))

        # kept displacements are themselves; an eliminated one follows from those of both sides
        rows = [stays]
        columns = [new[stays]]
        values = [np.ones(len(stays))]
        for t, p, place in zip(self.saddle.ties, self.pivots, pivots, strict=True):
            least = 1e-14 * np.abs(t.sides[0][2]).max()
            for number, (k, trace, B) in enumerate(t.sides):
                to = trace.values(new[self.first[k] : self.first[k + 1] : d])  # collective
                C = sp.coo_matrix(B)
                use = (place[C.row] >= 0) & (to[C.col] >= 0) & (np.abs(C.data) > least)
                rows.append(place[C.row[use]])
                columns.append(to[C.col[use]])
                values.append((-1.0 if number == 0 else 1.0) * C.data[use] / p.diagonal[C.row[use]])

        # all components of a node alike
        r, c = ((np.concatenate(x).astype(PETSc.IntType)[:, None] + np.arange(d)).ravel() for x in (rows, columns))
        shape = (n, self.comm.allreduce(kept))

        local = sp.coo_matrix((np.repeat(np.concatenate(values), d), (r, c)), shape).tocsr()
        csr = (local.indptr.astype(PETSc.IntType), local.indices.astype(PETSc.IntType), local.data)

        T = PETSc.Mat().createAIJ(((n, None), (kept, shape[1])), csr=csr, comm=self.comm)
        T.assemble()
        return T

    def solve(self, f: Sequence[Array], g: Sequence[Array]) -> Solution:
        """Displacements and multipliers; f this rank's loads, one per body, g replicated data, one per tie."""
        b = self.E.createVecLeft()
        u = self.E.createVecRight()
        z = self.T.createVecRight()
        r, y = b.duplicate(), z.duplicate()

        # reduced system: T^T E T z = T^T (b - E u_g)
        b.array[:] = np.concatenate(f)
        shift = self._given(g)
        u.array[:] = shift
        self.E.mult(u, r)
        r.aypx(-1.0, b)
        self.T.multTranspose(r, y)
        self.ksp.solve(y, z)
        self.T.mult(z, u)

        # u = T z + u_g; what is left of its balance is the force of the multipliers
        u.array[:] += shift
        self.E.mult(u, r)
        r.aypx(-1.0, b)
        parts, rest = (np.split(x.array.copy(), self.first[1:-1]) for x in (u, r))
        lam = []
        for t, p in zip(self.saddle.ties, self.pivots, strict=True):
            k, trace, _ = t.sides[0]
            lam.append((trace.values(rest[k].reshape(-1, self.d))[p.nodes] / p.diagonal[:, None]).ravel())

        for v in (b, u, z, r, y):
            v.destroy()

        full = self.saddle.vector(parts, lam)
        given = self.saddle.vector(f, g)
        residual = self.saddle.relative_residual(full, given)
        full.destroy(), given.destroy()
        self.judge.check(residual, 1.0)
        return Solution(parts, lam, 1, residual)

    def _given(self, g: Sequence[Array]) -> Array:
        """u_g of (1) on this rank."""
        out = np.zeros(int(self.first[-1]))
        for i, (p, data) in enumerate(zip(self.pivots, g, strict=True)):
            place = self._pivot_rows(i)
            mine = place >= 0
            out[place[mine][:, None] + np.arange(self.d)] = (data.reshape(-1, self.d) / p.diagonal[:, None])[mine]
        return out

    def destroy(self) -> None:
        """Free matrices and factor."""
        for x in (self.ksp, self.A, self.T, self.E):
            x.destroy()
