"""Ties of many field multipliers in a scene: iterations on their Schur complement, everything else eliminated exactly.

With K the step's matrix and the few other constraint rows (joints, frame conditions), which :mod:`.condensation` solves with one
back-solve for each elastic field, and G the rows of the ties,

    (G K^-1 G^T) mu = G K^-1 b - c,        x = K^-1 (b - G^T mu)                                                     (1)

by GMRES (K need not be symmetric: follower forces), preconditioned by

    S~ = blockdiag(S~_i) + W W^T                                                                                     (2)

with the fractional operators S~_i of :mod:`.tie_preconditioner` on the surfaces of each tie, and W W^T what the rows see of the
motion of all bodies as rigid ones, held by the other constraints: it connects the ties, and keeps counts flat in chains.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from ..errors import LinearSolveError
from ..matrices import dense
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.system import System
from .blocks.elastic_blocks import Elastic
from .residual import Judge
from .rigid_modes import rigid_mass, rigid_modes
from .tie_preconditioner import Lumped, TraceTie, inverse_of

CONTACT_RTOL = 1e-13  # of scenes with contact, whose own iteration needs products of that accuracy
CHANGED = 0.1  # relative change of G after which S~ is made anew


class IteratedMultipliers:
    """Equation (1) for the ties of a system; ``iterations`` counts those of all solves. Collective throughout."""

    def __init__(self, system: System, multiplier: Any, rtol: float) -> None:
        self.system, self.rtol = system, rtol if system.contacts is None else min(rtol, CONTACT_RTOL)
        self.multiplier = multiplier
        self.rows = np.concatenate([np.arange(span.start, span.stop) for _, span in system.traces])
        self.direct = np.setdiff1d(np.arange(system.n_lam), self.rows)
        self.judge = Judge("the multipliers of surface ties", max(1e-9, 100 * rtol))
        self.iterations = 0
        self._made: tuple[Any, ...] | None = None

    def prepare(self, ev: Evaluation, weights: Any, core: Array) -> None:
        """Take the rows of a configuration; ``core`` is the core's block of K (dense)."""
        self.G = ev.jacobian
        key = (weights.cm, weights.ck)
        if self._made is None or self._made[0] != key or self._moved():
            self._made = (key, self.G.core, self.G.port)
            self._inverse = self._preconditioner(weights, core)

    def _moved(self) -> bool:
        """Whether G is far from the one that S~ was made with."""
        assert self._made is not None
        for old, new in zip(self._made[1:], (self.G.core, self.G.port), strict=True):
            if min(old.shape) and abs(new - old).max() > CHANGED * abs(old).max():
                return True
        return False

    def solve(self, few: Callable[[Array, Array], tuple[Array, Array]], b: Array, c: Array) -> tuple[Array, Array]:
        """x and all multipliers; ``few(b, c)`` solves K with the few rows alone."""
        # the gaps that ties would have without their multipliers
        x, lam = few(b, c[self.direct])
        r, terms = self._gap(x, c)

        # these are what the multipliers close
        mu = self._iterate(few, r, 1e-15 * terms)
        x, lam = few(b - self._force(mu), c[self.direct])

        gap, after = self._gap(x, c)
        self.judge.check(float(np.linalg.norm(gap)), max(terms, after))

        out = np.zeros(self.system.n_lam)
        out[self.rows], out[self.direct] = mu, lam
        return x, out

    def _iterate(self, few: Callable[[Array, Array], tuple[Array, Array]], r: Array, floor: float) -> Array:
        """mu with G K^-1 G^T mu = r, to the relative residual ``rtol`` or the residual ``floor``."""
        zero = np.zeros(len(self.direct))
        n = len(r)

        def apply(mu: Array) -> Array:
            return self.G.times(few(self._force(mu), zero)[0])[self.rows]

        mu, info = spl.gmres(
            spl.LinearOperator((n, n), apply), r, rtol=self.rtol, atol=floor, restart=100, maxiter=3,
            M=spl.LinearOperator((n, n), self._inverse), callback=self._count, callback_type="pr_norm",
        )  # fmt: skip
        if info:
            raise LinearSolveError(
                f"GMRES on {n} multipliers of surface ties did not reach {self.rtol:g} in 300 iterations: ties that depend "
                "on each other, or a multiplier space that fails inf-sup. See scene.check(deep=True)."
            )
        return np.asarray(mu)

    def _gap(self, x: Array, c: Array) -> tuple[Array, float]:
        """G x - c of the ties, and the size of the terms that cancel in it; collective."""
        s = self.system
        parts = [np.asarray(self.G.core @ x[: s.n_core]), -c, *self.G.openings(x)]
        return np.sum(parts, axis=0)[self.rows], float(sum(np.linalg.norm(y[self.rows]) for y in parts))

    def _count(self, _: float) -> None:
        self.iterations += 1

    def _force(self, mu: Array) -> Array:
        """G^T mu, like v."""
        lam = np.zeros(self.system.n_lam)
        lam[self.rows] = mu
        return self.G.transposed(lam)

    # -- preconditioner -----------------------------------------------------------------------------------------
    def _preconditioner(self, weights: Any, core: Array) -> Callable[[Array], Array]:
        """S~^-1 of (2), by Woodbury's formula."""
        seen = SceneTies(self.system, weights)
        blockwise = self._blockwise(seen, stiff=weights.ck != 0)
        W = self._rigid(seen, core)
        if not W.shape[1]:
            return lambda r: blockwise(np.ravel(r))

        Y = np.stack([blockwise(w) for w in W.T], axis=1)
        small = sl.cho_factor(np.eye(W.shape[1]) + W.T @ Y)

        def inverse(r: Array) -> Array:
            z = blockwise(np.ravel(r))
            return z - Y @ sl.cho_solve(small, W.T @ z)

        return inverse

    def _blockwise(self, seen: SceneTies, *, stiff: bool) -> Callable[[Array], Array]:
        """The inverse of blockdiag(S~_i); ``stiff``: whether the matrix holds stiffness beside masses."""
        how = self.multiplier if stiff else Lumped()
        solves = [inverse_of(how.block(seen, i)) for i in range(len(seen.ties))]
        ends = np.cumsum([t.rows for t in seen.ties])[:-1]

        def blockwise(r: Array) -> Array:
            return np.concatenate([solve(part) for solve, part in zip(solves, np.split(r, ends), strict=True)])

        return blockwise

    def _rigid(self, seen: SceneTies, core: Array) -> Array:
        """W of (2): what ties see of bodies that can only move as rigid ones, held by the few rows."""
        M, G = self._as_rigid(seen, core)

        # masses and rows are made of one size, so that one threshold tells what is singular
        size = np.sqrt(np.maximum(np.abs(np.diag(M)), 1e-300))
        M, G = M / np.outer(size, size), G / size
        return np.asarray(G[self.rows] @ _free_motions(M, G[self.direct]))

    def _as_rigid(self, seen: SceneTies, core: Array) -> tuple[Array, Array]:
        """Masses (m, m) of all bodies as rigid ones, and G on their motions, (n_lam, m)."""
        s = self.system
        masses = [np.asarray(core)]
        columns = [dense(self.G.core)]

        for (k, part), elastic in zip(s.fields, seen.elastic, strict=True):
            if part.frame < s.n_frames:
                continue  # its frame carries the rigid motion
            modes = rigid_modes(elastic.body)
            masses.append(elastic.cm * rigid_mass(elastic.body, modes))

            ports = np.stack([part.ports_of(mode, self.G.t) for mode in modes.T], axis=1)
            columns.append(np.asarray(self.G.port[:, s.port_slice(k)] @ ports))
        return sl.block_diag(*masses), np.concatenate(columns, axis=1)


def _free_motions(M: Array, held: Array) -> Array:
    """X, (m, k), with X X^T = M^-1 on the motions that rows ``held`` (.., m) leave."""
    m = len(M)
    size = np.linalg.norm(held, axis=1)
    held = held[size > 0] / size[size > 0, None]

    saddle = np.block([[0.5 * (M + M.T), held.T], [held, np.zeros((len(held), len(held)))]])
    inverse = np.linalg.pinv(saddle, rcond=1e-10, hermitian=True)[:m, :m]

    values, vectors = np.linalg.eigh(0.5 * (inverse + inverse.T))
    keep = values > 1e-10 * max(float(values.max(initial=0.0)), 1e-300)
    return np.asarray(vectors[:, keep] * np.sqrt(values[keep]))


class SceneTies:
    """The ties of a system as :mod:`.tie_preconditioner` wants to see them."""

    def __init__(self, system: System, weights: Any) -> None:
        self.comm = system.comm
        self.elastic = [Elastic(p.field, weights.cm, weights.ck) for _, p in system.fields]
        number = {k: i for i, (k, _) in enumerate(system.fields)}
        self.ties = []
        for tie, _ in system.traces:
            sides = tuple((number[side.part], side.trace, side.coupling) for side in tie.sides if side.part is not None)
            columns = tuple((k, _columns(trace, coupling, tie)) for k, trace, coupling in sides)
            components = tie.data.shape[1] if tie.normal is None else 1
            self.ties.append(TraceTie(tie.name, columns, components, sides))

    def diagonal(self, k: int) -> Array:
        """diag(cm M + ck K) on this rank; collective."""
        e = self.elastic[k]
        M = e.body.M.getDiagonal()
        K = e.body.K.getDiagonal()
        out = e.cm * np.repeat(M.array, e.body.dim) + e.ck * K.array[: e.rows]
        M.destroy(), K.destroy()
        return np.asarray(out)


def _columns(trace: Any, B: sp.csr_matrix, tie: Any) -> sp.csr_matrix:
    """B of a side on this rank's displacements, all components or the normal one."""
    d = tie.data.shape[1]
    part = np.eye(d) if tie.normal is None else np.atleast_2d(tie.normal)
    return sp.kron(trace.columns(B), part, format="csr")
