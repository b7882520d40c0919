"""The stages of an implicit Runge-Kutta step by Newton's iteration: one tangent for all of them, or one for each.

With one tangent the stages decouple in the eigenvectors of the scheme's coefficients (:mod:`.collocation`): a real solve and one
of each complex pair, in place of one of all stages at once. Where the forces of a step turn too much for one tangent, constant
steps and steps through singular positions take one for each stage.

Source: Hairer and Wanner, Solving ODEs II, section IV.8, doi:10.1007/978-3-642-05221-7 (the iteration and when it ends).
"""

from __future__ import annotations

import numpy as np

from ...errors import CallbackError, ConvergenceError, LinearSolveError
from ...linear.implicit.whole_pencil import WholePencil
from ...rotations import Array
from ...system.compiled.states.stages import StageRule
from ...system.element_memory import lead_memories
from ...system.layout import State
from ..control import FALLEN, ROUNDOFF, STAGNATION
from ..dae import Points
from ..implicit.coupled_stages import CoupledStages
from ..newton import OTHER_SOLUTION, strayed
from .stage_march import LEAST_SHARE, LONGER, RATES, StageMarch

Stages = tuple[Array, Array, Array]  # xi, v and multipliers of each
KEPT = 0.05  # rate up to which stages go on with the tangents that each has


class StageNewton(StageMarch):
    """Newton's iteration of :class:`.Radau`."""

    def _refresh(self, h: float, predicted: Stages) -> None:
        """Tangent in the middle of the step as predicted, where it serves all stages best."""
        lead_memories(self.system, float(1.0 / abs(self.tab.frequencies(h)[0])))
        t, xi, v, vd, mult = self._middle(h, *predicted)
        at = State(t, self.system.compose(self.state.q, xi), v, vd, self.state.lam)
        self._tangent = self.eq.refresh(at, mult)
        self._fresh = True
        self._pencil = None

    def _middle(self, h: float, xi: Array, v: Array, mult: Array) -> tuple[float, Array, Array, Array, Array]:
        """t, xi, v, v' and multipliers in the middle of the step by these stages."""
        s, tab, count = self.state, self.tab, len(self.tab.c)
        change = v - s.v
        vd = np.add.reduce(tab.W @ change, axis=0) / (h * count)
        return s.t + 0.5 * h, tab.middle @ xi, s.v + tab.middle @ change, vd, np.add.reduce(mult, axis=0) / count

    def _prepare(self, h: float, predicted: Stages) -> None:
        """Tangent and factors for a step of size h (s) with these stages."""
        if self._tangent is None:
            self._refresh(h, predicted)
        self._factor(h)

    def _factor(self, h: float) -> None:
        """Factors for a step of size h (s)."""
        if self._pencil is not None and self._h_factor == h:
            return
        assert self._tangent is not None
        self._h_factor = h
        self._pencil = self.eq.pencil(self._tangent, self.tab.frequencies(h), self.judge, len(self.tab.c))
        self.stats.factorisations += len(self.tab.values)
        self._filter = None

    def _newton(self, h: float) -> Points | str:
        """The stages of a step of size h, or the cause of failure."""

        def iterate() -> Points | str:
            predicted = self._predict(h)
            self._prepare(h, predicted)
            return self._iterate(h, predicted)

        return self._found(iterate)

    def _iterate(self, h: float, predicted: Stages) -> Points | str:
        """With one tangent for all stages, as long as it converges."""
        tab = self.tab
        rule = self._rule(h)
        times = self.state.t + h * tab.c
        stages = self.eq.aligned(times, rule.couple, self._stages(h, *predicted))
        iteration = self._iteration(h, times, stages, rule)
        convergence = self._convergence(h, RATES[self.adaptive], self._first_share(h))
        if failed := self._iterated(h, iteration, convergence, convergence.most):
            return failed

        self._eta, self._iterations = convergence.share, convergence.done
        self._h_rate = h if convergence.done > 1 else max(h, self._h_rate)
        self.newton.note(convergence.share * convergence.size)
        return self._finished(h, iteration.points)

    def _rule(self, h: float) -> StageRule:
        """Of the points of a step of size h (s)."""
        W = self.tab.W / h
        past, begun = -W.sum(axis=1, keepdims=True), np.array([self.state.t])
        return StageRule(W, self.tab.inverse, self.tab.vectors, past=past, ends=begun)

    def _first_share(self, h: float) -> float:
        """What one increment leaves of the error, over its size, by the rate of the step before.

        Rates grow with the step, by any power of it where motions turn far: those of shorter steps promise nothing, nor does that
        of a step at rest, which leaves roundoff.
        """
        return float(max(self._eta, LEAST_SHARE) ** 0.8) if h <= LONGER * self._h_rate else 1.0  # a little worse

    def _finished(self, h: float, found: Points) -> Points:
        points = self._stages(h, found.xi, found.v, found.mult)
        self.eq.collocate(self.state.t + h * self.tab.c, points, self._rule(h))
        self._acceleration = self.eq.end_acceleration(self.state.t + h, points)
        return points

    def _own_tangents(self, h: float) -> Points | str:
        """Newton's iteration with a tangent for each stage where one for all has failed at falling step sizes: on the way through
        a singular configuration directions of constraint forces turn within any step, however small.
        """
        try:
            self._prepare(h, self._predict(h))  # the error estimate needs a tangent in the middle
            return self._full_newton(h)
        except (LinearSolveError, CallbackError, ConvergenceError, np.linalg.LinAlgError):
            return "linear solve failed"

    def _full_newton(self, h: float) -> Points | str:
        """The stages by Newton's iteration with a tangent of its own for each stage.

        For stiff springs that turn: with a frozen direction the iteration converges for h omega sqrt(k / m) h << 1 only (Lubich,
        doi:10.1007/BF01385643); constant steps have no other way out. For singular configurations too. Tangents of an iteration
        serve the next ones of the step while these converge fast.
        """
        if self.adaptive and not self.eq.dense:
            return "Newton too slow"
        xi, v, mult = predicted = self._predict(h)
        self._allow(h)

        # what is small enough, and what is as small as roundoff permits, after so many iterations
        enough, floor, calm = 1.0, STAGNATION, 1
        if self.adaptive:  # roundoff eps of a constraint leaves sqrt(eps) of the motion at a singular position
            enough = ROUNDOFF
            floor = 1.0 + np.finfo(float).eps ** 0.5 / self.norm.rtol
            calm = 3

        times, rule = self.state.t + h * self.tab.c, self._rule(h)
        last, greatest, pencil = np.inf, 0.0, None
        for k in range(2 * self.newton.max_iterations):  # at a singular position each halves the error
            points = self._stages(h, xi, v, mult)
            residual = self.eq.left_of(times, points, rule)
            fresh = pencil is None
            pencil = pencil or self._own_pencil(h, points)
            change, dmult = pencil.solve(*residual)
            dxi, dv = np.split(change, 2, axis=1)
            xi, v, mult = xi + dxi, v + dv, mult + dmult
            self.eq.follow(dxi, rule)
            size = self._size(h, dxi, dv, dmult)
            self._count(1)

            if not np.isfinite(size):
                return "Newton diverged"
            greatest = max(size, greatest)
            small = size <= floor or (not self.adaptive and size <= FALLEN * greatest)
            calmed = k > calm and size > 0.3 * last
            fast = size <= KEPT * last
            if (size <= enough and (fresh or fast)) or (calmed and (small or self._still)):
                self._iterations, self._theta = k + 1, 1.0
                if not self.adaptive and strayed(self.system, xi[-1], predicted[0][-1]):
                    return OTHER_SOLUTION
                return self._finished(h, self._stages(h, xi, v, mult))
            pencil = pencil if fast else None
            last = size
        return "Newton too slow"

    def _own_pencil(self, h: float, points: Points) -> WholePencil | CoupledStages:
        """One large matrix of all stages, with a tangent at each; of fields its action."""
        times = self.state.t + h * self.tab.c
        if not self.eq.dense:
            self._refresh(h, (points.xi, points.v, points.mult))
            self._factor(h)
            return CoupledStages(self.eq, times, points, self._rule(h), self._pencil, self.judge)
        each = zip(times, points.xi, points.v, points.vd, points.mult, strict=True)
        tangents = [self.eq.tangent_at(float(t), *values) for t, *values in each]
        self.stats.factorisations += 1
        return self.eq.whole_pencil(tangents, self.tab.W / h, self.judge)

    def _stages(self, h: float, xi: Array, v: Array, mult: Array) -> Points:
        W = self.tab.W / h
        return Points(xi, W @ xi, v, W @ (v - self.state.v), mult)

    def _predict(self, h: float) -> Stages:
        """Stages on the polynomial of the last step, or on the parabola at the start."""
        s, c = self.state, self.tab.c
        if self._last is None:
            x = (c * h)[:, None]
            xi = x * s.v + 0.5 * x * x * s.a
            v = s.v + x * s.a
            return xi, v, np.repeat(self.mult[None], len(c), axis=0)
        h0, q0, v0, points = self._last
        powers = (1.0 + c * h / h0)[:, None] ** np.arange(len(c) + 1)
        basis = (powers @ self.tab.basis)[:, 1:]
        ahead = basis @ points.xi
        moved = self.system.difference(s.q, self.system.compose(q0, ahead), near=ahead - points.xi[-1])
        return moved, v0 + basis @ (points.v - v0), powers[:, :-1] @ self.tab.stage_basis @ points.mult
