"""Newton's increment for the stages of elastic fields with the tangent of each: generalized conjugate residuals on their action.

One tangent for all stages (:mod:`.stage_krylov`) is the matrix P of a preconditioner here. With r the residual of all stages, a
solution y = (dxi, dv, dmult) of

    P^-1 J y = -P^-1 r,        J y = (r(points + e y) - r(points)) / e                                                 (1)

has what turns and bends from stage to stage. An iteration evaluates all stages once, and solves with P once.
Source: Knoll and Keyes, doi:10.1016/j.jcp.2003.08.010.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...linear.residual import Judge
from ...ranks import rank_sum
from ...rotations import Array
from ...system.compiled.states.stages import StageRule
from ..dae import Points
from .field_tangent import SHIFT
from .stage_krylov import Directions, FieldStages, shares

WORTH = 8  # iterations from which on the next increment is worth new tangents of the fields
LEAST = 0.1  # share of an increment
FALLS = 0.25  # of what it takes of the residual, the share that is asked for

if TYPE_CHECKING:
    from .field_stages import FieldEquations


class CoupledStages:
    """(1) at ``points`` of times t (k,) in a step of h (s); ``one``: the solver with one tangent. Collective."""

    def __init__(
        self, equations: FieldEquations, t: Array, points: Points, rule: StageRule, one: FieldStages, judge: Judge
    ) -> None:
        self.eq, self.t, self.points, self.rule, self.one, self.judge = equations, t, points, rule, one, judge
        system = equations.system
        length, replicated = shares(system), np.arange(system.n_v) < system.n_core
        h = 1.0 / np.abs(one.frequency).min()
        k, width = points.mult.shape
        self._weights = np.concatenate((np.tile(length, k), np.tile(h * length, k), np.zeros(k * width)))
        self._replicated = np.concatenate((np.tile(replicated, 2 * k), np.ones(k * width, bool)))
        self._cuts = np.cumsum([k * system.n_v] * 2)
        self._h = h

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """As :meth:`.FieldStages.solve`, of stages, (k, ..) each, for their residuals."""
        self.residual = kin, low
        first = self._by_one(kin, low)
        _, _, mult = self._parted(first)

        # multipliers count as much as motions
        moved, pushed = self._dot(first[None], first)[0], float((mult * mult).sum())
        if pushed > 0.0:
            self._weights[self._cuts[1] :] = np.sqrt(moved / pushed)
        directions = Directions(self._dot, self.judge.what)
        none: Array = np.zeros(0)
        y, *_ = directions.solve((first, none, none), lambda d: (self._image(d), none, none))
        self.eq.krylov += directions.iterations
        if directions.iterations > WORTH:
            self.eq.renewals.ask(again=True)
        dxi, dv, mult = self._parted(self._share(y, directions.norm(first)) * y)
        return np.concatenate((dxi, dv), axis=1), mult

    def _share(self, y: Array, size: float) -> float:
        """How much of an increment is taken: so much that P^-1 r, of this ``size``, falls. Pressures would have to move along."""
        share = 1.0
        while not self.eq.pressures.fields and share > LEAST:
            left = self._by_one(*self.eq.left_of(self.t, self._moved(share * y), self.rule))
            if float(self._dot(left[None], left)[0]) ** 0.5 < (1.0 - FALLS * share) * size:
                break
            share *= 0.5
        return share

    def _parted(self, y: Array) -> tuple[Array, Array, Array]:
        k = len(self.t)
        dxi, dv, mult = (x.reshape(k, -1) for x in np.split(y, self._cuts))
        return dxi, dv, mult

    def _by_one(self, kin: Array, low: Array) -> Array:
        """-P^-1 of a residual."""
        rule, n = self.rule, self.eq.system.n_v
        self.one.before[:] = 0.0  # each solution by itself
        self.eq.trusted = True
        change, mult = self.one.solve(rule.inverse @ kin, rule.inverse @ low)
        change, mult = (np.asarray((rule.vectors @ x).real) for x in (change, mult))
        return np.concatenate([x.ravel() for x in (change[:, :n], change[:, n:], mult)])

    def _image(self, y: Array) -> Array:
        """P^-1 J y."""
        system = self.eq.system
        dxi, dv, _ = self._parted(y)
        moved = max(system.each_max_abs(dxi).max(), self._h * system.each_max_abs(dv).max())
        e = SHIFT * system.length / (moved or 1.0)
        kin, low = self.eq.left_of(self.t, self._moved(e * y), self.rule)
        return -self._by_one((kin - self.residual[0]) / e, (low - self.residual[1]) / e)

    def _moved(self, y: Array) -> Points:
        """The points after an increment."""
        p, couple = self.points, self.rule.couple
        dxi, dv, mult = self._parted(y)
        return Points(p.xi + dxi, p.rate + couple @ dxi, p.v + dv, p.vd + couple @ dv, p.mult + mult)

    def _dot(self, V: Array, w: Array) -> Array:
        """Inner products of vectors (count, all) with one; collective."""
        w = self._weights**2 * w
        system = self.eq.system
        if system.comm.size == 1:
            return np.asarray(V @ w)
        known = self._replicated
        return np.asarray(V[:, known] @ w[known] + rank_sum(system.comm, V[:, ~known] @ w[~known]))
