"""The values at the end of a BDF step of a given order: predicted by the past, corrected by Newton's iteration.

With the increments xi_j of past configurations and the slopes c_j of the polynomial through them and the new value,

    xi' = c_0 xi + sum_j c_j xi_j,        v' = c_0 v + sum_j c_j v_j,                                               (1)

the equations of the step (:mod:`~fmbd_fenicsx.schemes.dae`) are solved for xi, v and the multipliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...rotations import Array
from ...system.compiled.states.convergence import CONVERGED
from ...system.compiled.states.stages import StageRule
from ...system.layout import State
from ..dae import Points
from ..newton import OTHER_SOLUTION, strayed
from .multistep_march import ALONE, NEAR, RATES, MultistepMarch
from .past import local, slopes_at_first, weights


class Corrector(MultistepMarch):
    """Newton's iteration of :class:`.BDF`; the tangent is kept from step to step while it converges fast."""

    def _newton(self, h: float, k: int) -> Points | str:
        """The new values of a step of size h, or the cause of failure."""
        return self._found(lambda: self._iterate(h, k))

    def _predicted(self, h: float, k: int) -> tuple[Points, Array]:
        """The new values as the past foretells them, and the coefficients c of (1)."""
        s, t = self.state, self.state.t + h
        times, xis, vs = local(self.system, self.state.q, self.past[: max(k + 1, 2)])
        c = slopes_at_first(np.concatenate(([t], times[:k])))

        # on the polynomial through k + 1 past values
        if len(times) == 1:
            xi = h * s.v + 0.5 * h * h * s.a
            v = s.v + h * s.a
        else:
            ahead = weights(times[: k + 1], t)
            xi = ahead @ xis[: k + 1]
            v = ahead @ vs[: k + 1]

        # multipliers by three past values at most
        few = self.past[: min(k, 3)]
        mult = weights(times[: len(few)], t) @ np.array([p.mult for p in few])
        rate = c[0] * xi + c[1:] @ xis[:k]
        accel = c[0] * v + c[1:] @ vs[:k]
        return Points(xi[None], rate[None], v[None], accel[None], mult[None]), c

    def _iterate(self, h: float, k: int) -> Points | str:
        """The new values by Newton's iteration, or why it failed."""
        t = self.state.t + h
        p, c = self._predicted(h, k)
        foretold = p.xi[0]
        self.eq.begin(self.state)
        ends = np.array([x.t for x in self.past[:k]])
        rule = StageRule(c[:1, None], ALONE, ALONE, past=c[None, 1:], ends=ends)
        self.eq.collocate(np.array([t]), p, rule)  # a tangent knows how memories follow
        rule = replace(rule, relax=self._prepare(t, p, c[0]))

        iteration = self._iteration(h, np.array([t]), p, rule)
        convergence, most = self._convergence(h, RATES, 1.0), self.newton.max_iterations
        for until in range(1, most + 1) if self._full else (most,):
            if convergence.done:
                self._own_tangent(t, iteration.points, c[0])
            if failed := self._iterated(h, iteration, convergence, until):
                return failed
            if convergence.outcome == CONVERGED:
                break

        self.newton.note(convergence.share * convergence.size)
        p = iteration.points
        self.eq.collocate(np.array([t]), p, rule)
        if self._full and strayed(self.system, p.xi[0], foretold):
            return OTHER_SOLUTION
        return p

    def _own_tangent(self, t: float, p: Points, frequency: float) -> None:
        """Tangent and factor of this very iterate."""
        tangent = self.eq.tangent_at(t, p.xi[0], p.v[0], p.vd[0], p.mult[0])
        self._pencil = self.eq.pencil(tangent, np.array([frequency]), self.judge)
        self.stats.factorisations += 1

    def _prepare(self, t: float, p: Points, s: float) -> float:
        """Tangent and factor for the frequency s; returns the correction of increments for an old factor."""
        if self._tangent is None:
            at = State(t, self.system.compose(self.eq.origin, p.xi[0]), p.v[0], p.vd[0], self.state.lam)
            self._tangent, self._pencil, self._fresh = self.eq.refresh(at, p.mult[0]), None, True
        old = None if self._pencil is None else float(self._pencil.s[0])
        least, most = NEAR
        if old is None or not least <= s / old <= most or (not self.adaptive and s != old):
            self._pencil = self.eq.pencil(self._tangent, np.array([s]), self.judge)
            self.stats.factorisations += 1
            return 1.0
        return 2.0 / (1.0 + s / old)
