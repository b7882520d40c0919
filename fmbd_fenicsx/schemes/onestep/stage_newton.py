"""The stages of an implicit Runge-Kutta step by Newton's iteration: one tangent for all of them, or one for each.

With one tangent the stages decouple in the eigenvectors of the scheme's coefficients (:mod:`.collocation`): a real solve and one
of each complex pair, in place of one of all stages at once. Where the forces of a step turn too much for one tangent, constant
steps and steps through singular positions take one for each stage.

Source: Hairer and Wanner, Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7 (the iteration and when it ends).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...errors import CallbackError, ConvergenceError, LinearSolveError
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.implicit.whole_pencil import WholePencil
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.stages import StageRule
from ...system.element_memory import lead_memories
from ...system.layout import State
from ...system.serialisation import Memory, plain
from ...system.tangents.step_tangent import StepTangent
from ..control import FALLEN, ROUNDOFF, STAGNATION
from ..dae import Points
from ..error_norm import ErrorNorm
from ..implicit.convergence import Rates
from ..implicit.coupled_stages import CoupledStages
from ..implicit.step_newton import StepNewton
from ..newton import OTHER_SOLUTION, Newton, strayed
from .collocation import Tableau
from .last_step import Stages, StageStart

KEPT = 0.05  # rate up to which stages go on with the tangents that each has
LONGER = 1.2  # steps so much longer than that of a rate do not rely on it
LEAST_SHARE = 1e-3  # that one increment is trusted to leave of the error
RATES = {
    True: Rates(limit=0.99, before=10.0, averaged=True, foresees=True),
    # with constant steps the first rate flatters: fast components go first
    False: Rates(limit=0.99, before=10.0, averaged=True, least=0.05),
}  # with error control, and with constant steps


class StageNewton(StepNewton):
    """Newton's iteration of :class:`.Radau`, with the coefficients ``tab``.

    Attributes:
        h_factor: size of the step that the factor is for, s.
        eta: what the last increment of the last step left, over its size.
        h_rate: size of the step in which that was seen, s.
        done: increments that the last step took.
    """

    what = "a Radau step"
    keeps: ClassVar = {**StepNewton.keeps, **dict.fromkeys(("eta", "h_rate"), plain())}

    def __init__(self, equations: Any, norm: ErrorNorm, settings: Newton, tab: Tableau, *, adaptive: bool) -> None:
        super().__init__(equations, norm, settings, adaptive=adaptive)
        self.tab = tab
        self.h_factor = 0.0
        self.eta, self.h_rate = 1.0, 0.0
        self.done = 0
        self._filter: Any = None  # of the error estimate, of the same tangent

    # -- tangents and factors ---------------------------------------------------------------------------------------
    def _refresh(self, h: float, s: State, predicted: Stages) -> None:
        """Tangent in the middle of the step as predicted, where it serves all stages best."""
        lead_memories(self.system, float(1.0 / abs(self.tab.frequencies(h)[0])))
        (xi, v, mult), tab, count = predicted, self.tab, len(self.tab.c)
        change = v - s.v
        vd = np.add.reduce(tab.W @ change, axis=0) / (h * count)
        q = self.system.compose(s.q, tab.middle @ xi)
        at = State(s.t + 0.5 * h, q, s.v + tab.middle @ change, vd, s.lam)
        self.tangent = self.eq.refresh(at, np.add.reduce(mult, axis=0) / count)
        self.fresh = True
        self.pencil = None

    def _prepare(self, h: float, state: State, predicted: Stages) -> None:
        """Tangent and factors for a step of size h (s) with these stages."""
        if self.tangent is None:
            self._refresh(h, state, predicted)
        self.factor(h)

    def factor(self, h: float) -> None:
        """Factors for a step of size h (s)."""
        if self.pencil is not None and self.h_factor == h:
            return
        assert self.tangent is not None
        self.h_factor = h
        self.pencil = self.eq.pencil(self.tangent, self.tab.frequencies(h), self.judge, len(self.tab.c))
        self.factorisations += len(self.tab.values)
        self._filter = None

    def filter(self) -> Any:
        """The solver of the error estimate, for gamma_0 / h, the first of the frequencies, by the same tangent."""
        if self._filter is None:
            self._filter = self.pencil if isinstance(self.pencil, SparsePencil) else self._made_filter()
        return self._filter

    def _made_filter(self) -> Any:
        assert self.tangent is not None
        self.factorisations += 1
        return self.eq.pencil(self.tangent, np.array([self.tab.gamma / self.h_factor]), self.judge)

    def take_factors(self, h: float) -> None:
        """Go on with factors of compiled code, for steps of size h (s)."""
        self.h_factor, self._filter = h, None

    def remember(self, m: Memory) -> None:
        """With the tangent of dense equations, whose factors are made again."""
        if self.eq.dense:  # others take their own derivatives in every step
            self.tangent = m("tangent", self.tangent, StepTangent)
        made = m("made", (self.pencil is not None, self._filter is not None))
        self.judge, self.h_factor = m("judge", (self.judge, self.h_factor), Judge)
        if m.reading:
            self.pencil = self._filter = None
            if self.tangent is not None and made[0]:
                self.factor(self.h_factor)
                self._filter = self.filter() if made[1] else None
        super().remember(m)

    # -- one tangent for all stages ---------------------------------------------------------------------------------
    def find(self, h: float, start: StageStart) -> Points | str:
        """The stages of a step of size h (s), or the cause of failure."""

        def iterate() -> Points | str:
            predicted = start.predict(self.system, self.tab, h)
            self._prepare(h, start.state, predicted)
            return self._iterate(h, start.state, predicted)

        return self.found(start.state, iterate)

    def _iterate(self, h: float, state: State, predicted: Stages) -> Points | str:
        """With one tangent for all stages, as long as it converges."""
        rule, times = self._rule(h, state), state.t + h * self.tab.c
        stages = self.eq.aligned(times, rule.couple, self._stages(h, state, *predicted))
        iteration = self.iteration(h, state, times, stages, rule)
        convergence = self.convergence(h, RATES[self.adaptive], self._first_share(h))
        if failed := self.iterated(h, iteration, convergence, convergence.most):
            return failed

        self.eta, self.done = convergence.share, convergence.done
        self.h_rate = h if convergence.done > 1 else max(h, self.h_rate)
        self.settings.note(convergence.share * convergence.size)
        found = iteration.points
        return self._finished(h, state, found.xi, found.v, found.mult)

    def _first_share(self, h: float) -> float:
        """What one increment leaves of the error, over its size, by the rate of the step before.

        Rates grow with the step, by any power of it where motions turn far: those of shorter steps promise nothing, nor does that
        of a step at rest, which leaves roundoff.
        """
        return float(max(self.eta, LEAST_SHARE) ** 0.8) if h <= LONGER * self.h_rate else 1.0  # a little worse

    def _rule(self, h: float, state: State) -> StageRule:
        """Of the points of a step of size h (s)."""
        W = self.tab.W / h
        past, begun = -W.sum(axis=1, keepdims=True), np.array([state.t])
        return StageRule(W, self.tab.inverse, self.tab.vectors, past=past, ends=begun)

    def _stages(self, h: float, state: State, xi: Array, v: Array, mult: Array) -> Points:
        W = self.tab.W / h
        return Points(xi, W @ xi, v, W @ (v - state.v), mult)

    def _finished(self, h: float, state: State, *found: Array) -> Points:
        """The stages with these xi, v and multipliers, at which memories are found too."""
        points = self._stages(h, state, *found)
        self.eq.collocate(state.t + h * self.tab.c, points, self._rule(h, state))
        return points

    # -- a tangent for each stage -----------------------------------------------------------------------------------
    def find_singular(self, h: float, start: StageStart) -> Points | str:
        """The stages where one tangent for all has failed at falling step sizes: on the way through a singular configuration
        directions of constraint forces turn within any step, however small.
        """
        try:
            # the error estimate needs a tangent in the middle
            self._prepare(h, start.state, start.predict(self.system, self.tab, h))
            return self.iterate_full(h, start)
        except (LinearSolveError, CallbackError, ConvergenceError, np.linalg.LinAlgError):
            return "linear solve failed"

    def iterate_full(self, h: float, start: StageStart) -> Points | str:
        """The stages by Newton's iteration with a tangent of its own for each stage.

        For stiff springs that turn: with a frozen direction the iteration converges for h omega sqrt(k / m) h << 1 only (Lubich,
        doi:10.1007/BF01385643); constant steps have no other way out. For singular configurations too. Tangents of an iteration
        serve the next ones of the step while these converge fast.
        """
        if self.adaptive and not self.eq.dense:
            return "Newton too slow"
        state = start.state
        xi, v, mult = predicted = start.predict(self.system, self.tab, h)
        self.allow(h, state)

        # what is small enough, and what is as small as roundoff permits, after so many iterations
        enough, floor, calm = 1.0, STAGNATION, 1
        if self.adaptive:  # roundoff eps of a constraint leaves sqrt(eps) of the motion at a singular position
            enough = ROUNDOFF
            floor = 1.0 + np.finfo(float).eps ** 0.5 / self.norm.rtol
            calm = 3

        times, rule = state.t + h * self.tab.c, self._rule(h, state)
        last, greatest, pencil = np.inf, 0.0, None
        for k in range(2 * self.settings.max_iterations):  # at a singular position each halves the error
            points = self._stages(h, state, xi, v, mult)
            residual = self.eq.left_of(times, points, rule)
            fresh = pencil is None
            pencil = pencil or self._own_pencil(h, state, points)
            change, dmult = pencil.solve(*residual)
            dxi, dv = np.split(change, 2, axis=1)
            xi, v, mult = xi + dxi, v + dv, mult + dmult
            self.eq.follow(dxi, rule)
            size = self.size(h, dxi, dv, dmult)
            self.count(1)

            if not np.isfinite(size):
                return "Newton diverged"
            greatest = max(size, greatest)
            small = size <= floor or (not self.adaptive and size <= FALLEN * greatest)
            calmed = k > calm and size > 0.3 * last
            fast = size <= KEPT * last
            if (size <= enough and (fresh or fast)) or (calmed and (small or self.still)):
                self.done, self.theta = k + 1, 1.0
                if not self.adaptive and strayed(self.system, xi[-1], predicted[0][-1]):
                    return OTHER_SOLUTION
                return self._finished(h, state, xi, v, mult)
            pencil = pencil if fast else None
            last = size
        return "Newton too slow"

    def _own_pencil(self, h: float, state: State, points: Points) -> WholePencil | CoupledStages:
        """One large matrix of all stages, with a tangent at each; of fields its action."""
        times = state.t + h * self.tab.c
        if not self.eq.dense:
            self._refresh(h, state, (points.xi, points.v, points.mult))
            self.factor(h)
            return CoupledStages(self.eq, times, points, self._rule(h, state), self.pencil, self.judge)
        each = zip(times, points.xi, points.v, points.vd, points.mult, strict=True)
        tangents = [self.eq.tangent_at(float(t), *values) for t, *values in each]
        self.factorisations += 1
        return self.eq.whole_pencil(tangents, self.tab.W / h, self.judge)
