"""The dual problem of a body cut into subdomains, each a body of its own on one rank, several on a rank where there are more.

    E_k u_k + B_k^T lam = f_k,   sum_k B_k u_k = g   =>   S lam = sum_k B_k E_k^-1 f_k - g,   S = sum_k B_k E_k^-1 B_k^T

solved by conjugate gradients on the interfaces (in the manner of FETI: Farhat and Roux, doi:10.1002/nme.1620320604). With inertia
no subdomain floats. Meshes need not match. The preconditioner is the fractional one of ``linear/saddle/precondition.py`` with its
coarse term of rigid motions.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

# here and not later: its import is collective, and ranks without subdomains take part
from petsc4py import PETSc  # noqa: F401

from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import MultiplierSpace
from fmbd_fenicsx.fem.traces.traces import Trace
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor
from fmbd_fenicsx.linear.presets.multiplier_schur import conjugate_gradients
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.linear.saddle.elastic import Elastic
from fmbd_fenicsx.linear.saddle.precondition import Fractional, rigid_term
from fmbd_fenicsx.linear.saddle.ties import TraceTie, hold, tie
from fmbd_fenicsx.rotations import Array

SIZES = "ck", "moduli", "depth", "size"  # of a subdomain that preconditioners on other ranks ask for


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
        told = world.allgather({k: {name: getattr(e, name) for name in SIZES} for k, e in own.items()})
        sizes = {k: known for part in told for k, known in part.items()}
        self.elastic = [SimpleNamespace(**sizes[k]) for k in sorted(sizes)]

    def tie(self, slave: tuple[int, str], master: tuple[int, str], space: MultiplierSpace) -> None:
        """Tie two surfaces (subdomain, surface); collective."""
        coupling = mortar(self.traces[slave], self.traces[master], space)
        self.ties.append(tie(f"{slave}-{master}", slave[0], master[0], coupling))

    def hold(self, surface: tuple[int, str], space: MultiplierSpace) -> None:
        """Weak Dirichlet data on a surface; collective."""
        self.ties.append(hold(str(surface), surface[0], space.on(self.traces[surface])))

    def prepare(self) -> None:
        """Factor the subdomains and the preconditioner; collective."""
        self.factors = {k: CholeskyFactor(e.body, e.cm, e.ck) for k, e in self.own.items()}
        self.B: dict[int, sp.csr_matrix] = {}
        for k, e in self.own.items():
            rows = [dict(t.columns).get(k, sp.csr_matrix((t.rows, e.rows))) for t in self.ties]
            self.B[k] = sp.vstack(rows, format="csr")

        preconditioner = Fractional()
        S = sp.block_diag([preconditioner.block(self, i) for i in range(len(self.ties))]).toarray()
        self.n = len(S)
        rigid = np.zeros((self.n, self.n))
        for k, e in self.own.items():
            gram, BR = rigid_term(e, k, self.ties)
            rigid += BR @ np.linalg.solve(gram, BR.T)
        self._factor = sl.cho_factor(S + self._total(rigid))

    def _total(self, x: Array) -> Array:
        return np.asarray(np.sum(self.world.allgather(x), axis=0))

    def operator(self, lam: Array) -> Array:
        """S lam; collective."""
        return self._jumps({k: factor.solve(self.B[k].T @ lam) for k, factor in self.factors.items()})

    def solve(self, f: dict[int, Array], g: Array) -> tuple[dict[int, Array], Array, int]:
        """Displacements of this rank's subdomains, multipliers, and the number of iterations; collective."""
        free = {k: self.factors[k].solve(f[k]) for k in self.own}
        d = self._jumps(free) - g
        lam, iterations = conjugate_gradients(self.operator, self._precondition, d, rtol=1e-10)
        u: dict[int, Array] = {k: free[k] - self.factors[k].solve(self.B[k].T @ lam) for k in self.own}

        # judged by the gaps that are left
        gap = self._jumps(u) - g
        self.judge.check(float(np.linalg.norm(gap)), float(np.linalg.norm(d)) + float(np.linalg.norm(g)))
        return u, lam, iterations

    def _jumps(self, u: dict[int, Array]) -> Array:
        """sum_k B_k u_k over the subdomains of all ranks; collective."""
        return self._total(sum((self.B[k] @ u[k] for k in self.own), np.zeros(self.n)))

    def _precondition(self, r: Array) -> Array:
        return np.asarray(sl.cho_solve(self._factor, r))

    def destroy(self) -> None:
        """Free the factors."""
        for factor in self.factors.values():
            factor.destroy()
