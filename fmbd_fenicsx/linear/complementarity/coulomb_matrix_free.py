"""Forces of many contact points: Newton's linear systems by GMRES with products of W.

At an iterate of :mod:`.coulomb` open points have known steps of their forces; on points that slip with direction e, share r of
the trial force on the cone, and t orthogonal to e,

    e . ds = mu dL + known,      t . (W ds) + (1 - r) / (c r) t . ds = known                                (1)

so that with forces ds = V y + s_0 and tests Z (V without the cone's slope mu), Newton's system is

    (Z^T W V + D) y = -Z^T (F / c + W s_0)                                                                  (2)

on normal forces of closed points, both tangential forces where they stick and one where they slip (3D). It is not symmetric
(friction has no potential); GMRES solves it to 1e-3, which makes Newton's iteration linear with this factor, at the products
that one accurate solve would need. With the sparse P ~ W^-1 of :mod:`.delassus_matrix_free` its preconditioner is the solution of

    P w = V y,     Z^T w + D y = r                                                                          (3)

where y follows from w, so that one sparse system on the known and the turning forces remains: three to six times fewer
products than with Z^T P Z. r scales rows and columns of (1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...rotations import Array
from .coulomb import ContactCounts, Coulomb, Iterate, comparable, solve_friction, solved
from .delassus_matrix_free import Applied

INNER = 1e-3  # relative residual of (2)
ENDS = 0.5  # of what is enough, that such a step leaves
RESTART, CYCLES = 100, 3  # of GMRES
SHARE = 1e-8  # r below which the slip's turn is left out of (2)


def contact_forces(W: Array | Applied, gap: Array, mu: Array, force: Array, counts: ContactCounts) -> Array:
    """Forces (m, 1 or d) of the law of contact for gaps and slips (m d,) that are ``gap`` under ``force``; collective."""
    if isinstance(W, np.ndarray):
        return solve_friction(W, (gap - W @ force.ravel()).reshape(force.shape), mu, force, counts)
    return solve_many(W, gap.reshape(force.shape), mu, force, counts)


def solve_many(W: Applied, gap: Array, mu: Array, start: Array, counts: ContactCounts) -> Array:
    """Forces (m, d) as of :func:`.coulomb.solve_friction`, from products of W; ``gap``: under ``start``; collective.

    Raises:
        ConvergenceError: no solution found; there is no pivoting by products.
    """
    q = gap - (W @ start.ravel()).reshape(gap.shape) if start.any() else gap
    problem = Products(W, q, mu, comparable(np.maximum(W.inverse.diagonal(), 1e-300), q.shape))
    return solved(problem, start, gap, counts)


@dataclass(frozen=True)
class Products(Coulomb):
    """The problem of :mod:`.coulomb` with W known by its products."""

    attempts: ClassVar[tuple[tuple[int, float], ...]] = ((0, 0.0), (0, 1e-4), (0, 1e-2))
    enough: ClassVar[float] = 1e-12
    ahead: ClassVar[int] = 1  # each is a solution by GMRES

    def step(self, it: Iterate) -> Array:
        """Newton's step of the forces, roughly; collective."""
        import scipy.sparse.linalg as spl

        cone = _Cone.of(self, it)
        s = cone.known(it)
        r = cone.tested(-it.F / self.c) / cone.share
        if s.any():
            r = r - cone.tested(self._response(s))
        if not r.any():
            return s

        n = r.size
        inverse = cone.inverse(self.W.inverse)

        def product(y: Array) -> Array:
            forces = cone.forces(y.reshape(s.shape))
            return (cone.tested(self._response(forces)) + cone.stiffness * y.reshape(s.shape)).ravel()

        y, _ = spl.gmres(
            spl.LinearOperator((n, n), product), r.ravel(), rtol=self._inner(it), restart=RESTART, maxiter=CYCLES,
            M=spl.LinearOperator((n, n), inverse),
        )  # fmt: skip
        return np.asarray(s + cone.forces(y.reshape(s.shape)))

    def _inner(self, it: Iterate) -> float:
        """The relative residual of (2); without friction one step solves the problem of a set of closed points to the end."""
        return INNER if it.x.shape[1] > 1 else ENDS * self.enough / self.size(it.F, it.x)

    def _response(self, s: Array) -> Array:
        return np.asarray((self.W @ s.ravel()).reshape(s.shape) + self.shift * s)


@dataclass(frozen=True)
class _Cone:
    """V, Z and D of (2) at an iterate, on arrays (m, d) in axes (normal, e, t) where points slip; zero where unknowns are known.

    ``turn`` (m, d - 1, d - 1): these axes in columns; ``weight`` (m, d): sqrt(r) on t, 1 on other unknowns, 0 elsewhere;
    ``share`` (m, d): r on t, 1 elsewhere; ``slope`` (m,): mu where a point slips; ``stiffness`` (m, d): D.
    """

    turn: Array
    weight: Array
    share: Array
    slope: Array
    stiffness: Array

    @classmethod
    def of(cls, problem: Products, it: Iterate) -> _Cone:
        """At an iterate of the problem."""
        x = it.x
        m, d = x.shape
        slip = it.state == 2

        # directions of slip, of the trial force
        trial = x[:, 1:] - problem.c[:, 1:] * it.u[:, 1:]
        size = np.where(slip, np.linalg.norm(trial, axis=1), 1.0)
        along = np.where(slip[:, None], trial / size[:, None], np.arange(d - 1) == 0)
        turn = np.zeros((m, d - 1, d - 1))
        turn[:, :, :1] = along[:, :, None]
        if d == 3:
            turn[:, :, 1] = np.stack((-along[:, 1], along[:, 0]), axis=1)

        # share of the cone's radius in the trial force
        radius = problem.mu * np.maximum(x[:, 0], 0.0)
        r = np.where(slip, radius / size, 1.0)
        inside = r > SHARE

        weight = np.where(it.state[:, None] > 0, 1.0, np.zeros((m, d)))
        weight[slip, 1:2] = 0.0
        weight[:, 2:] *= np.where(inside, np.sqrt(r), 0.0)[:, None]

        share = np.ones((m, d))
        share[:, 2:] = np.maximum(r, SHARE)[:, None]

        stiffness = np.zeros((m, d))
        left = np.where(slip & inside, np.maximum(1.0 - r, SHARE), 0.0)
        stiffness[:, 2:] = (left / problem.c[:, -1])[:, None]

        slope = np.where(slip & (x[:, 0] > 0), problem.mu, 0.0)
        return cls(turn, weight, share, slope, stiffness)

    def known(self, it: Iterate) -> Array:
        """s_0: forces of open points vanish, those of slipping points come back to the cone."""
        a = self._into(-it.F)
        return self._out(np.where(self.weight > 0, 0.0, a))

    def forces(self, y: Array) -> Array:
        """V y."""
        a = self.weight * y
        a[:, 1:2] += self.slope[:, None] * a[:, :1]
        return self._out(a)

    def tested(self, g: Array) -> Array:
        """Z^T g."""
        return self.weight * self._into(g)

    def inverse(self, P: Any) -> Callable[[Array], Array]:
        """y of (3) for r, arrays (m d,) scaled like those of (2)."""
        import scipy.sparse.linalg as spl

        m, d = self.weight.shape
        turn = np.zeros((m, d, d))
        turn[:, 0, 0], turn[:, 1:, 1:] = 1.0, self.turn
        Q = sp.bsr_matrix((turn, np.arange(m), np.arange(m + 1)))
        P = (Q.T @ P @ Q).tocsr()
        sliding = np.flatnonzero(self.slope)
        along = sliding * d
        back = sp.csr_matrix((self.slope[sliding], (along + 1, along)), shape=P.shape)
        P = (P - back @ P).tocsr()  # P w - V y has no share in the known forces

        weight = self.weight.ravel()
        soft = self.stiffness.ravel() > 0
        free = (weight > 0) & ~soft
        rest = ~free
        give = np.zeros(m * d)
        give[soft] = weight[soft] ** 2 / self.stiffness.ravel()[soft]
        solve = spl.splu((P[rest][:, rest] + sp.diags(give[rest])).tocsc()).solve
        held = P[rest][:, free]

        def y(r: Array) -> Array:
            w = np.where(free, r, 0.0)
            load = np.zeros(m * d)
            load[soft] = give[soft] * r[soft] / weight[soft]
            w[rest] = solve(load[rest] - held @ r[free])
            return np.where(weight > 0, P @ w, 0.0) / np.where(weight > 0, weight, 1.0)

        return y

    def _into(self, g: Array) -> Array:
        return np.concatenate((g[:, :1], np.einsum("mij,mi->mj", self.turn, g[:, 1:])), axis=1)

    def _out(self, a: Array) -> Array:
        return np.concatenate((a[:, :1], np.einsum("mij,mj->mi", self.turn, a[:, 1:])), axis=1)
