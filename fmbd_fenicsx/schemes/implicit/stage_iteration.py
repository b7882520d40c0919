"""Increments of Newton's iteration for the points of an implicit step: evaluated, solved and added in compiled code where it can.

What the points leave of the equations is decoupled by the rule of the scheme, solved for frequency by frequency, and added:

    kin, low = residual(points),      z = pencil.solve(inverse kin, inverse low),      points += relax Re(vectors z)         (1)
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import StageRule
from ..dae import Points

Increments = tuple[Array, Array, Array]  # of xi, v and of multipliers


class StageIteration:
    """The iteration from predicted ``points`` at the times t (k,); ``equations`` and ``pencil`` of the step."""

    def __init__(self, equations: Any, t: Array, points: Points, rule: StageRule, weights: Array | None) -> None:
        self.eq, self.t, self.rule, self._weights = equations, t, rule, weights
        self._points = points
        self._room: Any = None  # of compiled code, which has the points

    @property
    def points(self) -> Points:
        """The newest."""
        if self._room is not None:
            self._points, self._room = Points(*self._room.points()), None
        return self._points

    def follow(self, pencil: Any, convergence: Convergence, until: int) -> None:
        """Add increments in compiled code, up to number ``until`` of the iteration, as far as it can."""
        room, eq, before = pencil.room, self.eq, convergence.done
        if room is None or self._weights is None:
            return
        if self._room is not room:
            room.put(self.t, eq.origin, self.points, self.rule, self._weights)
            self._room, eq.left = room, room.left
        try:
            pencil.iterate(convergence, until)
        finally:
            eq.residuals += len(self.t) * (convergence.done - before)

    def increment(self, pencil: Any) -> Increments:
        """Add one increment, in NumPy."""
        p, n = self.points, self._points.xi.shape[1]
        kin, low = self.eq.left_of(self.t, p, self.rule)
        change, mult = self._solved(pencil, kin, low)
        dxi, dv = change[:, :n], change[:, n:]
        couple = self.rule.couple
        self.eq.follow(dxi, self.rule)
        self._points = Points(p.xi + dxi, p.rate + couple @ dxi, p.v + dv, p.vd + couple @ dv, p.mult + mult)
        return dxi, dv, mult

    def creeps(self, pencil: Any, moved: Increments) -> bool:
        """Whether the last increment is one of a tangent with other slopes of laws."""
        return bool(self.eq.creeps(pencil.t, self.t, self.points, *moved[:2]))

    def _solved(self, pencil: Any, kin: Array, low: Array) -> tuple[Array, Array]:
        """(1): increments of xi and v side by side, and of the multipliers."""
        rule = self.rule
        change, mult = pencil.solve(rule.inverse @ kin, rule.inverse @ low)
        change, mult = (np.asarray((rule.vectors @ x).real) for x in (change, mult))
        return (change, mult) if rule.relax == 1.0 else (rule.relax * change, rule.relax * mult)
