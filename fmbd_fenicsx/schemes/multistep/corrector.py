"""The values at the end of a BDF step of a given order: predicted by the past, corrected by Newton's iteration.

With the increments xi_j of past configurations and the slopes c_j of the polynomial through them and the new value,

    xi' = c_0 xi + sum_j c_j xi_j,        v' = c_0 v + sum_j c_j v_j,                                               (1)

the equations of the step (:mod:`~fmbd_fenicsx.schemes.dae`) are solved for xi, v and the multipliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.convergence import CONVERGED
from ...system.compiled.states.stages import StageRule
from ...system.layout import State
from ...system.serialisation import Memory
from ...system.system import System
from ...system.tangents.step_tangent import StepTangent
from ..dae import Points
from ..implicit.convergence import Rates
from ..implicit.step_newton import StepNewton
from ..newton import OTHER_SOLUTION, strayed
from .past import Past, local, slopes_at_first, weights

ALONE = np.eye(1)  # one point is coupled with none
RATES = Rates(limit=0.95, largest=2.0)
NEAR = 0.8, 1.25  # frequencies over that of a factor with which it serves on, with error control


def foretold(system: System, h: float, state: State, past: list[Past], k: int) -> tuple[Points, Array]:
    """The values after a step of size h (s) of order k as the past foretells them, and the coefficients c of (1)."""
    t = state.t + h
    times, xis, vs = local(system, state.q, past[: max(k + 1, 2)])
    c = slopes_at_first(np.concatenate(([t], times[:k])))

    # on the polynomial through k + 1 past values
    if len(times) == 1:
        xi = h * state.v + 0.5 * h * h * state.a
        v = state.v + h * state.a
    else:
        ahead = weights(times[: k + 1], t)
        xi = ahead @ xis[: k + 1]
        v = ahead @ vs[: k + 1]

    # multipliers by three past values at most
    few = past[: min(k, 3)]
    mult = weights(times[: len(few)], t) @ np.array([p.mult for p in few])
    rate = c[0] * xi + c[1:] @ xis[:k]
    accel = c[0] * v + c[1:] @ vs[:k]
    return Points(xi[None], rate[None], v[None], accel[None], mult[None]), c


class Corrector(StepNewton):
    """Newton's iteration of :class:`.BDF`."""

    what = "a BDF step"

    def remember(self, m: Memory) -> None:
        """With the tangent, whose factor is made again; of elastic fields every step takes its own."""
        kept = self.pencil if self.eq.dense else None
        self.tangent, self.judge = m("tangent", (self.tangent, self.judge), StepTangent, Judge)
        factored = m("factored", None if kept is None else (kept.t, kept.s), StepTangent)
        if m.reading:
            self.pencil = None if factored is None else self.eq.pencil(*factored, self.judge)
        super().remember(m)

    def find(self, h: float, state: State, past: list[Past], k: int) -> Points | str:
        """The new values of a step of size h (s) of order k, or the cause of failure."""
        return self.found(state, lambda: self._iterate(h, state, past, k))

    def _iterate(self, h: float, state: State, past: list[Past], k: int) -> Points | str:
        """The new values by Newton's iteration, or why it failed."""
        t = state.t + h
        p, c = foretold(self.system, h, state, past, k)
        begun = p.xi[0]
        self.eq.begin(state)
        ends = np.array([x.t for x in past[:k]])
        rule = StageRule(c[:1, None], ALONE, ALONE, past=c[None, 1:], ends=ends)
        self.eq.collocate(np.array([t]), p, rule)  # a tangent knows how memories follow
        rule = replace(rule, relax=self._prepare(state, t, p, c[0]))

        iteration = self.iteration(h, state, np.array([t]), p, rule)
        convergence, most = self.convergence(h, RATES, 1.0), self.settings.max_iterations
        for until in range(1, most + 1) if self.full else (most,):
            if convergence.done:
                self._own_tangent(t, iteration.points, c[0])
            if failed := self.iterated(h, iteration, convergence, until):
                return failed
            if convergence.outcome == CONVERGED:
                break

        self.settings.note(convergence.share * convergence.size)
        p = iteration.points
        self.eq.collocate(np.array([t]), p, rule)
        if self.full and strayed(self.system, p.xi[0], begun):
            return OTHER_SOLUTION
        return p

    def _own_tangent(self, t: float, p: Points, frequency: float) -> None:
        """Tangent and factor of this very iterate."""
        tangent = self.eq.tangent_at(t, p.xi[0], p.v[0], p.vd[0], p.mult[0])
        self.pencil = self.eq.pencil(tangent, np.array([frequency]), self.judge)
        self.factorisations += 1

    def _prepare(self, state: State, t: float, p: Points, s: float) -> float:
        """Tangent and factor for the frequency s; returns the correction of increments for an old factor."""
        if self.tangent is None:
            at = State(t, self.system.compose(self.eq.origin, p.xi[0]), p.v[0], p.vd[0], state.lam)
            self.tangent, self.pencil, self.fresh = self.eq.refresh(at, p.mult[0]), None, True
        old = None if self.pencil is None else float(self.pencil.s[0])
        served = self._serving(s, old)
        if served != old:
            self.pencil = self.eq.pencil(self.tangent, np.array([served]), self.judge)
            self.factorisations += 1
        return 2.0 / (1.0 + s / served)

    def _serving(self, s: float, factored: float | None) -> float:
        """The frequency whose factors serve s, as bdf.c has it: of constant steps its own, else that of the grid, or the one at
        hand, which is near. Tangents of each iterate have their own.
        """
        grid, (least, most) = self.eq.frequency_grid, NEAR
        if self.full or not self.adaptive:
            return s
        if grid.get("anchor"):
            places = grid["places_of_decade"]
            return float(grid["anchor"] * 10.0 ** (round(places * float(np.log10(s / grid["anchor"]))) / places))
        return s if factored is None or not least <= s / factored <= most else factored
