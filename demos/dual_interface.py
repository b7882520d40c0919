"""The dual problem of a body cut into subdomains, each a body of its own on one rank, several on a rank where there are more.

    E_k u_k + B_k^T lam = f_k,   sum_k B_k u_k = g   =>   S lam = sum_k B_k E_k^-1 f_k - g,   S = sum_k B_k E_k^-1 B_k^T

solved by conjugate gradients on the interfaces (in the manner of FETI: Farhat and Roux, doi:10.1002/nme.1620320604). With inertia
no subdomain floats. Meshes need not match. The preconditioner is the fractional one of ``linear/saddle/precondition.py`` with its
coarse term of rigid motions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

# here and not later: its import is collective, and ranks without subdomains take part
from petsc4py import PETSc  # noqa: F401

from fmbd_fenicsx.fem.traces.mortar import Mortar, mortar
from fmbd_fenicsx.fem.traces.multipliers import Multipliers, MultiplierSpace
from fmbd_fenicsx.fem.traces.traces import Trace
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor
from fmbd_fenicsx.linear.presets.multiplier_schur import conjugate_gradients
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.precondition import Fractional, rigid_term
from fmbd_fenicsx.linear.saddle.ties import TraceTie
from fmbd_fenicsx.rotations import Array

FRACTIONAL = Fractional()


@dataclass(frozen=True)
class Answers:
    """What preconditioners need to know of a subdomain on another rank (see ``Elastic``)."""

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
