"""Radau IIA with two, three, five or seven stages: variable steps, simplified Newton iteration, any form of the constraints.

In local coordinates y = (xi, v) about the step's start, collocation at the nodes c_i (c_s = 1) with A^-1 = (w_ij) reads

    y'_i = (1 / h) sum_j w_ij (y_j - y_n),        the equations of motion hold at (t_n + c_i h, y_i, y'_i)        (1)

so the scheme is stiffly accurate: the last stage is the new state, and it satisfies the constraints. Orders for q, v, lambda:
index 3: 2s-1, s, s-1; index 2 and GGL: 2s-1, 2s-1, s; index 1 and state space: 2s-1 in all.

One Newton iteration solves the stages together: the eigenvectors of A^-1 decouple them into one system for each complex pair
(and, for an odd number of stages, a real one) with the frequencies gamma / h. Stages are evaluated in one call. Tangent and
factors are kept while Newton converges fast and the step changes little. The local error is estimated by an embedded formula of
order s, filtered by the real matrix gamma_0 / h.

Sources: Hairer and Wanner, Solving ODEs II, sections IV.8 and VII.4, doi:10.1007/978-3-642-05221-7; Hairer, Lubich and Roche,
doi:10.1007/BFb0093947; local coordinates: Munthe-Kaas, doi:10.1007/BF02510919.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from ...errors import CallbackError, ConvergenceError, LinearSolveError, require
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...linear.residual import Judge
from ...linear.saddle.pencil import Pencil, Tangent, stacked
from ...rotations import Array
from ...system.serialisation import Memory, plain
from ...system.system import State, System
from ..consistent import accelerations, project
from ..control import (
    ROUNDOFF,
    STAGNATION,
    StepControl,
    check_controlled,
    first_step,
    lands,
    moves,
    turn_limit,
    turns_too_far,
)
from ..dae import GGL, Form, OfForm, Points
from ..implicit_stepper import ImplicitStepper
from ..newton import Newton
from .collocation import lagrange, tableau

CAUTIOUS = 0.05  # with constant steps no rate below this is believed


@dataclass(frozen=True)
class Radau(OfForm):
    """Scheme data.

    Args:
        stages: 2, 3, 5 or 7; more stages pay at tight tolerances, five from about 1e-7 on.
        form: of the constraints, :class:`~fmbd_fenicsx.GGL` by default.
        rtol: relative tolerance of the local error; None for constant steps dt without error control.
        atol: absolute tolerance of coordinates (m, rad or own units); None: from the sizes in the model.
    """

    stages: int = 3
    form: Form = field(default_factory=GGL)
    rtol: float | None = 1e-6
    atol: float | None = None

    def __post_init__(self) -> None:
        check_controlled(self)
        require(self.stages in (2, 3, 5, 7), f"Radau: stages = {self.stages} must be 2, 3, 5 or 7.")

    @property
    def order(self) -> int:
        """Classical order."""
        return 2 * self.stages - 1

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"Radau IIA({self.stages}), {self.form.name}"

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Stepper:
        """A run's worker, from a consistent state."""
        return Stepper(self, system, solver, newton, state)


class Stepper(ImplicitStepper):
    """Advances a consistent state; holds tangent, factors, the last collocation polynomial and the step control."""

    what = "a Radau step"
    keeps: ClassVar = {**ImplicitStepper.keeps, **dict.fromkeys(("mult", "_trouble", "_eta"), plain())}

    def __init__(self, scheme: Radau, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state)
        self.tab = tableau(scheme.stages)
        self.control = StepControl(scheme.stages + 1.0)
        self.mult: Array = np.zeros(self.eq.levels * system.n_lam)
        self._reset_multipliers()

        self._filter: Any = None  # of the error estimate
        self._h_factor = 0.0  # size of the step that the factor is for, s
        self._trouble = 0  # two for each failure of Newton's iteration, less one for each step
        self._eta = 1.0
        self._last: tuple[float, Array, Array, Points] | None = None
        self.eq.weigh(state)

    def remember(self, m: Memory) -> None:
        """With the last collocation polynomial and the tangent, whose factors are made again."""
        if self.eq.dense:
            self._last, self._tangent = m("last", (self._last, self._tangent), Points, Tangent)
        else:  # every step takes its own derivatives
            self._last = self.eq.remember_points(m.inside("last"), self._last)
        made = m("made", (self._pencil is not None, self._filter is not None))
        self.judge, self._h_factor = m("judge", (self.judge, self._h_factor), Judge)
        if m.reading:
            self._pencil = self._filter = None
            if self._tangent is not None and made[0]:
                self._prepare(self._h_factor)
                self._filter = self._error_filter(self._h_factor) if made[1] else None
        super().remember(m)

    # -- one accepted step --------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One accepted step. Constant steps: of size h. Error control: of at most h (s), which is then hit exactly at the end.

        Raises ConvergenceError when steps would have to be too small.
        """
        return self._controlled(h) if self.adaptive else self._constant(h)

    def _constant(self, h: float) -> State:
        """A step of size h; where the tangent of the step fails, and ever after, with one for each stage."""
        self.norm.update(self.state, h)
        self.eq.begin(self.state)
        point = "full" if self._full else self._newton(h)
        if isinstance(point, str):
            self._tangent, self._full = None, True
            point = self._full_newton(h)
        if isinstance(point, str):
            raise self._failure(h, point)
        return self._accept(h, point)

    def _controlled(self, limit: float) -> State:
        """A step of at most ``limit`` (s) that passes the error test."""
        s = self.state
        self.control.span = max(self.control.span, limit)
        farthest = turn_limit(self.system, s)
        if self.proposed is None:
            self.norm.update(s, limit)
            self.proposed = first_step(self.norm, s, self.control.order, limit)

        while True:
            h = lands(min(self.proposed, farthest), limit)
            moves(s.t, h)
            self.norm.update(s, h)
            self.eq.begin(s)
            point = self._newton(h)
            if not isinstance(point, str) and turns_too_far(self.system, point.xi):
                point = "turns too far"
            if isinstance(point, str):
                cause, error = point, np.inf
                stale = self._tangent is not None and not self._fresh
                self._tangent = None
                if stale:
                    continue  # once more with a new tangent
                self._trouble += 2
                # on the way through a singular configuration smaller steps fail alike
                if self._trouble > 4:
                    point = self._own_tangents(h)
            if not isinstance(point, str):
                error, cause = self._estimate(h, point), "error estimate"
                if error <= 1.0:
                    break
                self._theta = max(self._theta, 1e-3)
            self.stats.rejected[cause] += 1
            self.proposed = self.control.rejected(s.t, h, error, cause)

        # the next step: smaller where Newton's iteration had to work hard
        self.local_error = error
        most = 2 * self.newton.max_iterations
        effort = (most + 1) / (most + self._iterations)
        new = self.control.accepted(h, error, effort)
        if self._theta < 1e-2 and 1.0 <= new / h <= 1.2:
            new = h  # keep the factors
        self.proposed = new if h < limit or new < limit else max(new, self.proposed)
        return self._accept(h, point)

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, by its collocation polynomial; None after a new start."""
        if self._last is None:
            return None
        h, q0, v0, points = self._last
        # where in the step, 0 to 1
        x = 1.0 - (self.state.t - t) / h
        k = len(self.tab.c)
        m = self.system.n_lam

        # values and slopes of the polynomial through the start and the stages
        powers = x ** np.arange(k + 1)
        slopes = np.arange(k + 1) * np.concatenate(([0.0], powers[:-1])) / h
        values = (powers @ self.tab.basis)[1:]
        rates = (slopes @ self.tab.basis)[1:]

        change = points.v - v0
        lam = self.state.lam
        if self.eq.levels:
            lam = (powers[:-1] @ self.tab.stage_basis @ points.mult)[:m]
        return State(t, self.system.compose(q0, values @ points.xi), v0 + values @ change, rates @ change, lam)

    def restart(self, t: float) -> None:
        """Forget the past: the solution has a kink at t. Accelerations and multipliers behind the kink are solved for."""
        self.state = accelerations(self.system, replace(self.state, t=t), self.solver)
        self._reset_multipliers()
        self._last, self._tangent, self.proposed, self.control.h_old = None, None, None, 0.0

    def _reset_multipliers(self) -> None:
        self.mult = np.zeros_like(self.mult)
        if self.eq.levels:
            self.mult[: self.system.n_lam] = self.state.lam

    def _accept(self, h: float, points: Points) -> State:
        s, m = self.state, self.system.n_lam
        t = s.t + h
        if m and self.eq.levels and self.solver.core.redundant:
            points = self._least(h, points)

        # stiffly accurate: the last stage is the new state
        self._last = (h, s.q, s.v, points)
        self.mult = points.mult[-1]
        lam = self.mult[:m] if self.eq.levels else s.lam
        self.state = State(t, self.system.compose(s.q, points.xi[-1]), points.v[-1], self._acceleration, lam)
        if self.scheme.form.projected:
            self.state = project(self.system, self.state, self.solver)

        self.stats.steps += 1
        self._trouble = max(self._trouble - 1, 0)
        self._fresh = False
        if self._theta > 1e-2 or not self.eq.dense:
            self._tangent = None
        return self.state

    def _least(self, h: float, points: Points) -> Points:
        """The stages with multipliers that are the smallest with their forces, so that predictions of them stay small."""
        s = self.state
        m = self.system.n_lam
        mult = points.mult.copy()
        for i, share in enumerate(self.tab.c):
            ev = self.system.at(float(s.t + share * h), self.system.compose(s.q, points.xi[i]))
            for level in range(self.eq.levels):
                rows = slice(level * m, (level + 1) * m)
                mult[i, rows] = least(self.solver, ev, mult[i, rows])
        return replace(points, mult=mult)

    # -- Newton -------------------------------------------------------------------------------------------------
    def _refresh(self, h: float) -> None:
        """Tangent in the middle of the step as predicted, where it serves all stages best."""
        s, W = self.state, self.tab.W
        xi, v, mult = self._predict(h)
        weights = lagrange(np.concatenate(([0.0], self.tab.c)), np.array([0.5]))[0, 1:]
        vd = (W @ (v - s.v) / h).mean(axis=0)
        lam = mult.mean(axis=0)[: self.system.n_lam] if self.eq.levels else s.lam
        q = self.system.compose(s.q, weights @ xi)
        self._tangent = self.eq.refresh(State(s.t + 0.5 * h, q, s.v + weights @ (v - s.v), vd, lam))
        self._fresh = True
        self._pencil = None

    def _prepare(self, h: float) -> None:
        if self._tangent is None:
            self._refresh(h)
        if self._pencil is not None and self._h_factor == h:
            return
        assert self._tangent is not None
        self._h_factor = h
        self._pencil = self.eq.pencil(self._tangent, self.tab.values / h, self.judge)
        self.stats.factorisations += len(self.tab.values)
        self._filter = None

    def _newton(self, h: float) -> Points | str:
        """The stages of a step of size h, or the cause of failure."""

        def iterate() -> Points | str:
            self._prepare(h)
            return self._iterate(h)

        return self._found(iterate)

    def _iterate(self, h: float) -> Points | str:
        xi, v, mult = self._predict(h)
        tolerance = self._newton_tolerance()
        theta = max(self._eta, 1e-16) ** 0.8  # of the step before, a little worse
        last = 0.0
        times = self.state.t + h * self.tab.c

        for k in range(self.newton.max_iterations):
            kin, low = self.eq.residual(times, self._stages(h, xi, v, mult))
            dxi, dv, dmult = self._solve(kin, low)
            xi, v, mult = xi + dxi, v + dv, mult + dmult
            self.newton.iterations += 1
            self.stats.newton_iterations += 1
            size = self._size(h, dxi, dv, dmult)
            if not np.isfinite(size):
                return "Newton diverged"

            # the rate of convergence; increments that no longer fall are roundoff, or divergence
            if k > 0:
                ratio = size / last if last > 0 else 0.0
                self._theta = ratio if k == 1 else np.sqrt(ratio * max(self._theta, 1e-10))
                if self.adaptive and ratio > 0.5 and size <= ROUNDOFF and max(size, last) <= 10 * ROUNDOFF:
                    size = 0.0  # increments no longer fall: roundoff, harmless against the tolerance
                elif not self.adaptive and k > 2 and ratio > 0.3 and size <= STAGNATION:
                    size = 0.0
                elif self._theta >= 0.99 and size > tolerance and (self.adaptive or k > 3):
                    return "Newton diverged"
                theta = self._theta / (1 - min(self._theta, 0.99))
                if not self.adaptive:  # the first rate flatters: fast components go first
                    theta = max(theta, CAUTIOUS)
                left = self.newton.max_iterations - 1 - k
                if self.adaptive and k > 1 and theta * size * self._theta**left > tolerance and size > tolerance:
                    return "Newton too slow"

            last = size
            if theta * size <= tolerance or size <= 1e-2 * tolerance:
                self._eta, self._iterations = theta, k + 1
                self.newton.note(theta * size)
                return self._finished(h, xi, v, mult)
        return "Newton too slow"

    def _finished(self, h: float, xi: Array, v: Array, mult: Array) -> Points:
        points = self._stages(h, xi, v, mult)
        self._acceleration = self.eq.accelerations(points)[-1]
        return points

    def _own_tangents(self, h: float) -> Points | str:
        """Newton's iteration with a tangent for each stage where one for all has failed at falling step sizes: on the way through
        a singular configuration directions of constraint forces turn within any step, however small.
        """
        try:
            self._prepare(h)  # the error estimate needs a tangent in the middle
            return self._full_newton(h)
        except (LinearSolveError, CallbackError, ConvergenceError, np.linalg.LinAlgError):
            return "linear solve failed"

    def _full_newton(self, h: float) -> Points | str:
        """The stages by Newton's iteration with a tangent of its own for each stage.

        For stiff springs that turn: with a frozen direction the iteration converges for h omega sqrt(k / m) h << 1 only (Lubich,
        doi:10.1007/BF01385643); constant steps have no other way out. For singular configurations too.
        """
        if not self.eq.dense:
            return "Newton too slow"
        n = self.system.n_v
        m = self.system.n_lam
        stages = len(self.tab.c)
        xi, v, mult = self._predict(h)
        coupling = np.kron(self.tab.W / h, np.eye(n))
        last = np.inf

        # what is small enough, and what is as small as roundoff permits, after so many iterations
        enough, floor, calm = 1.0, STAGNATION, 1
        if self.adaptive:  # roundoff eps of a constraint leaves sqrt(eps) of the motion at a singular position
            enough = ROUNDOFF
            floor = 1.0 + np.finfo(float).eps ** 0.5 / self.norm.rtol
            calm = 3
        times = self.state.t + h * self.tab.c
        cuts = [0, *range(n, n + self.eq.levels * m + 1, m)] if m else [0, n]

        for k in range(2 * self.newton.max_iterations):  # at a singular position each halves the error
            points = self._stages(h, xi, v, mult)
            kin, low = self.eq.residual(times, points)
            tangents = [self.eq.tangent_at(float(times[i]), xi[i], v[i], points.vd[i], mult[i]) for i in range(stages)]

            # rows of all stages: balance, then the constraints level by level
            pencil = Pencil(stacked(tangents), coupling, self.judge, self.solver.core.redundant)
            below = np.concatenate([low[:, i:j].ravel() for i, j in pairwise(cuts)])
            change, by_level = pencil.solve(kin.reshape(1, -1), below[None])
            dxi, dv = change.reshape(2, stages, n)
            dmult = by_level.reshape(self.eq.levels, stages, m).swapaxes(0, 1).reshape(stages, -1)
            xi, v, mult = xi + dxi, v + dv, mult + dmult

            self.newton.iterations += 1
            self.stats.newton_iterations += 1
            self.stats.factorisations += 1
            size = self._size(h, dxi, dv, dmult)
            if not np.isfinite(size):
                return "Newton diverged"
            if size <= enough or (k > calm and size <= floor and size > 0.3 * last):
                self._iterations, self._theta = k + 1, 1.0
                return self._finished(h, xi, v, mult)
            last = size
        return "Newton too slow"

    def _stages(self, h: float, xi: Array, v: Array, mult: Array) -> Points:
        W = self.tab.W / h
        return Points(xi, W @ xi, v, W @ (v - self.state.v), mult)

    def _solve(self, kin: Array, low: Array) -> tuple[Array, Array, Array]:
        """Decoupled solves: y = Re(vectors z), z of the real eigenvalue and of one of each complex pair."""
        tab, n = self.tab, self.system.n_v
        assert self._pencil is not None
        z = np.concatenate(self._pencil.solve(tab.inverse @ kin, tab.inverse @ low), axis=1)
        y = (tab.vectors @ z).real
        return y[:, :n], y[:, n : 2 * n], y[:, 2 * n :]

    def _predict(self, h: float) -> tuple[Array, Array, Array]:
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

    # -- error --------------------------------------------------------------------------------------------------
    def _error_filter(self, h: float) -> Any:
        assert self._tangent is not None
        return self.eq.pencil(self._tangent, np.array([self.tab.gamma / h]), self.judge)

    def _estimate(self, h: float, points: Points) -> float:
        s = self.state
        tab = self.tab
        m = self.system.n_lam
        assert self._tangent is not None
        if self._filter is None:
            self._filter = self._error_filter(h)
            self.stats.factorisations += 1

        # what the start of the step leaves of the constraints is no error of the step
        dq, v, a = self.eq.consistent_start(s)
        moved, change = points.xi - dq, points.v - v
        if self.scheme.form.index == 3:  # its velocities follow all increments of the stages
            change = change - np.outer(tab.W.sum(axis=1) / h, dq)
        kin = v + tab.error @ moved / h - self.eq.corrections(self.mult[None], 1)[0]
        push = a + tab.error @ change / h

        # filtered: components that the step does not resolve would be overestimated
        no_rows = np.zeros(self.eq.levels * m)
        low = np.concatenate((-self.eq.inertia(self._tangent, push), no_rows))
        errors, e_m = self._filter.solve(-kin[None], low[None])
        e_q, e_v = errors.reshape(2, -1)
        pushed = self.eq.pushes(e_m)
        return self.norm(h, e_q, e_v, None if pushed is None else pushed[0])
