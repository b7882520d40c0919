"""The dual problem of a body cut into subdomains, each a body of its own on one rank, several on a rank where there are more.

    E_k u_k + B_k^T lam = f_k,   sum_k B_k u_k = g   =>   S lam = sum_k B_k E_k^-1 f_k - g,   S = sum_k B_k E_k^-1 B_k^T

solved by conjugate gradients on the interfaces (in the manner of FETI: Farhat and Roux, doi:10.1002/nme.1620320604). With inertia
no subdomain floats. Meshes need not match. The preconditioner is that of ties in scenes, ``linear/tie_preconditioner.py``, with
its coarse term of rigid motions; a scene's bodies are each distributed over all ranks.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

# here and not later: its import is collective, and ranks without subdomains take part
from petsc4py import PETSc  # noqa: F401

from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.linear.blocks.spd import CholeskyFactor
from fmbd_fenicsx.linear.residual import Judge
from fmbd_fenicsx.linear.tie_preconditioner import Fractional, TraceTie, rigid_term

SIZES = "ck", "moduli", "depth", "size"  # of a subdomain that preconditioners on other ranks ask for


def shared_traces(world, own):
    """Traces of subdomains on single ranks, made known to all; collective over ``world``. Keys must be comparable."""
    known = {}
    for rank, part in enumerate(world.allgather({key: replace(t, comm=None) for key, t in own.items()})):
        for key, t in part.items():
            # others' nodes are none of this rank's unknowns
            mine = {} if rank == world.rank else {"owned": np.full(t.n, -1), "n_owned": 0}
            known[key] = replace(t, comm=world, **mine)
    return known


class DualInterface:
    """The dual problem of subdomains on single ranks; collective over ``world``.

    ``own``: number -> :class:`Elastic` of the subdomains on this rank (bodies on COMM_SELF, cm > 0). ``ties`` are made by
    :meth:`tie` and :meth:`hold`, in the same order on all ranks, before :meth:`prepare`.
    """

    def __init__(self, world, own, traces):
        self.world, self.own, self.traces, self.ties = world, own, traces, []
        self.judge = Judge("the dual interface problem", 1e-6)
        told = world.allgather({k: SimpleNamespace(**{s: getattr(e, s) for s in SIZES}) for k, e in own.items()})
        self.elastic = {k: known for part in told for k, known in part.items()}

    def tie(self, slave, master, space):
        """Tie two surfaces (subdomain, surface); collective."""
        c = mortar(self.traces[slave], self.traces[master], space)
        self._add(f"{slave}-{master}", (slave[0], c.multipliers.trace, c.slave), (master[0], c.master_trace, -c.master))

    def hold(self, surface, space):
        """Weak Dirichlet data on a surface; collective."""
        mu = space.on(self.traces[surface])
        self._add(str(surface), (surface[0], mu.trace, mu.coupling()))

    def _add(self, name, *sides):
        d = sides[0][1].dim
        columns = tuple((k, sp.kron(t.columns(B), sp.identity(d), format="csr")) for k, t, B in sides)
        self.ties.append(TraceTie(name, columns, d, sides))

    def prepare(self):
        """Factor the subdomains and the preconditioner; collective."""
        self.factors = {k: CholeskyFactor(e.body, e.cm, e.ck) for k, e in self.own.items()}
        self.n, self.B, rigid = sum(t.rows for t in self.ties), {}, 0.0
        for k, e in self.own.items():
            self.B[k] = sp.vstack([dict(t.columns).get(k, sp.csr_matrix((t.rows, e.rows))) for t in self.ties])
            gram, BR = rigid_term(e, k, self.ties)
            rigid = rigid + BR @ np.linalg.solve(gram, BR.T)
        S = sp.block_diag([Fractional().block(self, i) for i in range(len(self.ties))]).toarray()
        self._factor = sl.cho_factor(S + self.world.allreduce(rigid))

    def operator(self, lam):
        """S lam; collective."""
        return self._jumps({k: factor.solve(self.B[k].T @ lam) for k, factor in self.factors.items()})

    def solve(self, f, g):
        """Displacements of this rank's subdomains, multipliers, and the number of iterations; collective."""
        free, count = {k: self.factors[k].solve(f[k]) for k in self.own}, []
        d, shape = self._jumps(free) - g, (self.n, self.n)
        S, M = (spl.LinearOperator(shape, act) for act in (self.operator, lambda r: sl.cho_solve(self._factor, r)))
        lam, _ = spl.cg(S, d, rtol=1e-10, M=M, maxiter=500, callback=count.append)
        u = {k: free[k] - self.factors[k].solve(self.B[k].T @ lam) for k in self.own}

        # judged by the gaps that are left
        gap = self._jumps(u) - g
        self.judge.check(float(np.linalg.norm(gap)), float(np.linalg.norm(d)) + float(np.linalg.norm(g)))
        return u, lam, len(count)

    def _jumps(self, u):
        """sum_k B_k u_k over the subdomains of all ranks; collective."""
        return self.world.allreduce(sum((self.B[k] @ u[k] for k in self.own), np.zeros(self.n)))

    def destroy(self):
        """Free the factors."""
        for factor in self.factors.values():
            factor.destroy()
