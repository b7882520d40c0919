"""Domain decomposition: one distributed body by BDDC, or a body cut into subdomains that trace multipliers tie.

(a) :func:`unassembled` gives the elastic block of a distributed body as PETSc's MATIS: each rank keeps the matrix of its own
cells. BDDC (Dohrmann, doi:10.1137/S1064827502412887) then needs a bounded number of iterations.

(b) A body cut into subdomains, each a body of its own on one rank, several on a rank where there are more:

    E_k u_k + B_k^T lam = f_k,   sum_k B_k u_k = g      =>      S lam = sum_k B_k E_k^-1 f_k - g,   S = sum_k
    B_k E_k^-1 B_k^T

solved by conjugate gradients on the interfaces (the dual problem, in the manner of FETI: Farhat and Roux,
doi:10.1002/nme.1620320604). With inertia no subdomain floats. Meshes need not match. The preconditioner is the fractional one
of :mod:`..saddle.precondition` with its coarse term of rigid motions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
from petsc4py import (
    PETSc,  # here and not later: its import is collective, and ranks without subdomains take part
)

from ...fem.fields import Field
from ...fem.traces.mortar import Mortar, mortar
from ...fem.traces.multipliers import Multipliers, MultiplierSpace
from ...fem.traces.traces import Trace
from ...rotations import Array
from ..residual import Judge
from ..rigid_modes import rigid_modes
from ..saddle.conjugate_gradients import conjugate_gradients
from ..saddle.precondition import Fractional, rigid_term
from ..saddle.saddle import Elastic, TraceTie
from .spd import CholeskyFactor


def unassembled(body: Field, cm: float, ck: float) -> Any:
    """cm M + ck K of a distributed body as MATIS over the nodes of each rank's own cells, with rigid-body modes; collective.

    The map from local to global rows has block size 1: with the block map that DOLFINx gives, BDDC of PETSc 3.22 finds no
    interface and returns at once, "converged" and wrong. Nodes that belong to ghost cells only are left out.
    """
    import dolfinx.fem.petsc as fp

    d, space = body.dim, body.space

    whole = fp.create_matrix(body.stiffness_form, "is")
    whole.zeroEntries()
    fp.assemble_matrix(whole, body.mass_form)
    whole.assemble()
    whole.scale(cm / ck)
    fp.assemble_matrix(whole, body.stiffness_form)
    whole.assemble()
    whole.scale(ck)

    # rows of the nodes of this rank's own cells
    topology = body.mesh.dolfinx.topology
    nodes = np.unique(space.dofmap.list[: topology.index_map(topology.dim).size_local]).astype(np.int32)
    local = (d * nodes[:, None] + np.arange(d)).ravel().astype(PETSc.IntType)
    rows = space.dofmap.index_map.local_to_global(nodes)
    rows = (d * rows[:, None] + np.arange(d)).ravel().astype(PETSc.IntType)

    sets = PETSc.IS().createGeneral(local, comm=PETSc.COMM_SELF)
    own = whole.getISLocalMat().createSubMatrix(sets, sets)
    lgmap = PETSc.LGMap().create(rows, comm=body.comm)
    size = (body.n * d, body.n_global)
    A = PETSc.Mat().createIS((size, size), lgmapr=lgmap, lgmapc=lgmap, comm=body.comm)
    A.setISLocalMat(own)
    A.assemble()
    A.setOption(PETSc.Mat.Option.SPD, True)
    A.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    # rigid motions, which the coarse problem has to hold
    modes = []
    for column in _orthonormal(body).T:
        v = A.createVecRight()
        v.array[:] = column
        modes.append(v)
    near = PETSc.NullSpace().create(vectors=modes, comm=body.comm)
    A.setNearNullSpace(near)

    for obj in (*modes, near, own, sets, lgmap, whole):
        obj.destroy()
    return A


def _orthonormal(body: Field) -> Array:
    """Rigid modes with orthonormal columns over all ranks."""
    R = rigid_modes(body)
    factor = np.linalg.cholesky(body.total(R.T @ R))
    return np.asarray(np.linalg.solve(factor, R.T).T)


FRACTIONAL = Fractional()


# -- (b) subdomains -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Answers:
    """What preconditioners need to know of a subdomain on another rank (see :class:`.saddle.Elastic`)."""

    ck: float
    moduli: tuple[float, float]
    depth: float
    size: float


def shared_traces(world: Any, own: dict[Any, Trace]) -> dict[Any, Trace]:
    """Traces of subdomains on single ranks, made known to all; collective over ``world``. Keys must be comparable."""
    packed = [(key, replace(t, comm=None)) for key, t in own.items()]
    out: dict[Any, Trace] = {}
    for rank, part in enumerate(world.allgather(packed)):
        for key, t in part:
            # others' nodes are none of this rank's unknowns
            mine = rank == world.rank
            owned = t.owned if mine else np.full(t.n, -1)
            out[key] = replace(t, comm=world, owned=owned, n_owned=t.n_owned if mine else 0)
    return out


class DualInterface:
    """The dual problem of subdomains on single ranks; collective over ``world``.

    ``own``: number -> :class:`Elastic` of the subdomains on this rank (bodies on COMM_SELF, cm > 0). ``ties`` are made by
    :meth:`tie` and :meth:`hold`, in the same order on all ranks, before :meth:`prepare`.
    """

    def __init__(self, world: Any, own: dict[int, Elastic], traces: dict[Any, Trace]) -> None:
        self.world, self.own, self.traces = world, own, traces
        self.ties: list[TraceTie] = []
        self.judge = Judge("the dual interface problem", 1e-6)
        facts = {k: Answers(e.ck, e.moduli, e.depth, e.size) for k, e in own.items()}
        everything = {k: a for part in world.allgather(facts) for k, a in part.items()}
        self.elastic = [everything[k] for k in sorted(everything)]

    def tie(self, slave: tuple[int, str], master: tuple[int, str], space: MultiplierSpace) -> Mortar:
        """Tie two surfaces (subdomain, surface); collective."""
        c = mortar(self.traces[slave], self.traces[master], space)
        sides = ((slave[0], c.slave_trace, c.slave), (master[0], c.master_trace, -c.master))
        self._add(f"{slave}-{master}", sides, c.multipliers)
        return c

    def hold(self, surface: tuple[int, str], space: MultiplierSpace) -> Multipliers:
        """Weak Dirichlet data on a surface; collective."""
        mu = space.on(self.traces[surface])
        self._add(str(surface), ((surface[0], mu.trace, mu.coupling()),), mu)
        return mu

    def _add(self, name: str, sides: tuple[tuple[int, Trace, sp.csr_matrix], ...], mu: Multipliers) -> None:
        d = mu.trace.dim
        columns = [(k, sp.kron(t.columns(B), sp.identity(d), format="csr")) for k, t, B in sides if k in self.own]
        self.ties.append(_Tie(name, tuple(columns), mu, d, sides))

    def prepare(self, preconditioner: Fractional | None = FRACTIONAL) -> None:
        """Factor the subdomains and the preconditioner (None: plain conjugate gradients); collective."""
        self.n = sum(t.rows for t in self.ties)
        self.factors = {k: CholeskyFactor(e.body, e.cm, e.ck) for k, e in self.own.items()}

        # rows of each tie among those of all
        first = np.cumsum([0, *(t.rows for t in self.ties)])
        self.B = {k: sp.csr_matrix((self.n, e.rows)) for k, e in self.own.items()}
        for i, t in enumerate(self.ties):
            for k, B in t.columns:
                lift = sp.csr_matrix(
                    (np.ones(t.rows), (np.arange(first[i], first[i + 1]), np.arange(t.rows))),
                    (self.n, t.rows),
                )
                self.B[k] = self.B[k] + lift @ B

        self._factor: Any = None
        if preconditioner is not None:
            S = sp.block_diag([preconditioner.block(self, i) for i in range(len(self.ties))]).toarray()
            rigid = np.zeros((self.n, self.n))
            for k, e in self.own.items():
                gram, BR = rigid_term(e, k, self.ties)
                rigid += BR @ np.linalg.solve(gram, BR.T)
            S += self._total(rigid)
            self._factor = sl.cho_factor(S)

    def _total(self, x: Array) -> Array:
        return np.asarray(np.sum(self.world.allgather(x), axis=0))

    def operator(self, lam: Array) -> Array:
        """S lam; collective."""
        local = sum((B @ self.factors[k].solve(B.T @ lam) for k, B in self.B.items()), np.zeros(self.n))
        return self._total(local)

    def solve(
        self, f: dict[int, Array], g: Array, *, rtol: float = 1e-10, limit: int = 500
    ) -> tuple[dict[int, Array], Array, int]:
        """Displacements of this rank's subdomains, multipliers, and the number of iterations; collective."""
        free = {k: self.factors[k].solve(f[k]) for k in self.own}
        d = self._jumps(free) - g
        lam, iterations = conjugate_gradients(self.operator, self._precondition, d, rtol=rtol, limit=limit)

        held = {k: self.factors[k].solve(self.B[k].T @ lam) for k in self.own}
        u: dict[int, Array] = {k: free[k] - held[k] for k in self.own}

        # judged by the gaps that are left
        gap = self._jumps(u) - g
        size = float(np.linalg.norm(d)) + float(np.linalg.norm(g))
        self.judge.check(float(np.linalg.norm(gap)), size)
        return u, lam, iterations

    def _jumps(self, u: dict[int, Array]) -> Array:
        """sum_k B_k u_k over the subdomains of all ranks; collective."""
        return self._total(sum((self.B[k] @ u[k] for k in self.own), np.zeros(self.n)))

    def _precondition(self, r: Array) -> Array:
        return r if self._factor is None else np.asarray(sl.cho_solve(self._factor, r))

    def destroy(self) -> None:
        """Free the factors."""
        for factor in self.factors.values():
            factor.destroy()


class _Tie(TraceTie):
    """A tie whose rows do not depend on the subdomains of this rank."""

    @property
    def rows(self) -> int:
        assert self.multipliers is not None
        return self.multipliers.n * self.components
