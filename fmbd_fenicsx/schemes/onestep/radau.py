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
from typing import Any, ClassVar

import numpy as np

from ...errors import require
from ...linear.condensation import StepSolver
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.residual import Judge
from ...rotations import Array
from ...system.control.memory_points import StepError
from ...system.element_memory import memory_error
from ...system.layout import State
from ...system.serialisation import Memory, plain
from ...system.system import System
from ...system.tangents.step_tangent import StepTangent
from ..control import StepControl, moves, turn_limit, turns_too_far
from ..dae import GGL, Form, OfForm, Points
from ..error_norm import check_controlled
from ..implicit.implicit_stepper import ImplicitStepper
from ..newton import Newton
from .collocation import Tableau, controlled, tableau
from .stage_newton import StageNewton


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
    ends_ahead: ClassVar[bool] = True
    corrects: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_controlled(self)
        require(self.stages in (2, 3, 5, 7), f"Radau: stages = {self.stages} must be 2, 3, 5 or 7.")

    @property
    def order(self) -> int:
        """Classical order."""
        return 2 * self.stages - 1

    @property
    def orders(self) -> tuple[int, int, int]:
        """Of positions, velocities, and accelerations with multipliers, of stages: Hairer et al., doi:10.1007/BFb0093947."""
        s, full, levels = self.stages, self.order, self.form.levels
        if 2 in levels:
            return full, full, full
        return (full, full, s) if 1 in levels else (full, s, s - 1)

    @property
    def name(self) -> str:
        """Name in reports."""
        return f"Radau IIA({self.stages}), {self.form.name}"

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> RadauStepper:
        """The time stepper of a run, from a consistent state."""
        return RadauStepper(self, system, solver, newton, state)


class RadauStepper(StageNewton):
    """Advances a consistent state; holds tangent, factors, the last collocation polynomial and the step control."""

    what = "a Radau step"
    keeps: ClassVar = {**ImplicitStepper.keeps, **dict.fromkeys(("mult", "_trouble", "_eta", "_h_rate"), plain())}

    def __init__(self, scheme: Radau, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state)
        self.tab = self._coefficients()
        self.control = StepControl(scheme.stages + 1.0)
        self.mult: Array = self.eq.multipliers(state)

        self._filter: Any = None  # of the error estimate
        self._h_factor = 0.0  # size of the step that the factor is for, s
        self._trouble = 0  # two for each failure of Newton's iteration, less one for each step
        self._eta, self._h_rate = 1.0, 0.0
        self._last: tuple[float, Array, Array, Points] | None = None
        self.eq.weigh(state)
        self.eq.keep_sizes(equal=not self.adaptive)

    def _coefficients(self) -> Tableau:
        """With a real frequency, where errors are filtered, or fields close joints on two levels."""
        real = self.adaptive or (self.eq.levels > 1 and not self.eq.dense)
        return (controlled if real else tableau)(self.scheme.stages)

    def remember(self, m: Memory) -> None:
        """With the last collocation polynomial and the tangent, whose factors are made again."""
        if self.eq.dense:
            self._last, self._tangent = m("last", (self._last, self._tangent), Points, StepTangent)
        else:  # every step takes its own derivatives
            self._last = self.eq.remember_points(m.inside("last"), self._last)
        made = m("made", (self._pencil is not None, self._filter is not None))
        self.judge, self._h_factor = m("judge", (self.judge, self._h_factor), Judge)
        if m.reading:
            self._pencil = self._filter = None
            if self._tangent is not None and made[0]:
                self._factor(self._h_factor)
                self._filter = self._error_filter(self._h_factor) if made[1] else None
        super().remember(m)

    # -- one accepted step --------------------------------------------------------------------------------------
    def _constant(self, h: float) -> State:
        """A step of size h; where the tangent of the step fails, with one for each stage."""
        self.eq.begin(self.state)
        point = "full" if self._full else self._with_new_tangent(lambda: self._newton(h))
        if isinstance(point, str):
            if not self._full:
                self._begin_spell()
            self.eq.begin(self.state)
            point = self._found(lambda: self._full_newton(h))
        if isinstance(point, str):
            self._full = False  # parts of the step begin like others
            raise self._failure(h, point)
        return self._accept(h, point)

    def _controlled(self, limit: float) -> State:
        """A step of at most ``limit`` (s) that passes the error test."""
        s = self.state
        self.control.span = max(self.control.span, limit)
        # coordinates on the tangent space of the start end after a quarter turn; many stages share one tangent that long
        farthest = turn_limit(self.system, s, steps=self.turning)
        if self.proposed is None:
            self.proposed = self._first_size(self.control.order, limit)

        h, points, error = self._passing(limit, farthest)
        self.local_error = error
        self.proposed = self._next_size(h, limit, error)
        return self._accept(h, points)

    def _passing(self, limit: float, farthest: float) -> tuple[float, Points, float]:
        """The first step, of ever smaller ones, that passes the error test: its size (s), stages and error."""
        s = self.state
        assert self.proposed is not None
        while True:
            h = self._landing(self.eq.step_size(min(self.proposed, farthest)), limit)
            moves(s.t, h)
            self.solver.near_singular.begin_trial()
            self.norm.update(s, h)
            self.eq.begin(s)

            points = self._newton(h)
            if not isinstance(points, str) and turns_too_far(self.system, points.xi):
                points = "turns too far"
            if isinstance(points, str):
                cause, error = points, np.inf
                stale = self._tangent is not None and not self._fresh
                self._tangent = None
                if stale or self.eq.renew():
                    continue  # once more with a new tangent
                self._trouble += 2
                # on the way through a singular configuration smaller steps fail alike
                if self._trouble > 4:
                    points = self._own_tangents(h)
                    # masses and directions of constraints are those of stages that ran away
                    if isinstance(points, str):
                        self._tangent = None

            if not isinstance(points, str):
                error, cause = self._estimate(h, points), "error estimate"
                if error <= 1.0:
                    self.solver.near_singular.accept_trial()
                    return h, points, error
                self._theta = max(self._theta, 1e-3)
            self.stats.rejected[cause] += 1
            self.proposed = self.control.rejected(s.t, h, error, cause)

    def _next_size(self, h: float, limit: float, error: float) -> float:
        """The size (s) that is proposed after a step of size h: smaller where Newton's iteration had to work hard."""
        most = 2 * self.newton.max_iterations
        effort = (most + 1) / (most + self._iterations)
        new = self.control.accepted(h, error, effort)
        if self._theta < 1e-2 and 1.0 <= new / h <= 1.2:
            new = h  # keep the factors

        # a step cut short by the end tells nothing of the next one
        cut_short = h >= limit and new >= limit
        assert self.proposed is not None
        return max(new, self.proposed) if cut_short else new

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, by its collocation polynomial; None after a new start."""
        if self._last is None:
            return None
        h, q, v, points = self._last
        x = 1.0 - (self.state.t - t) / h
        return self._held(h, State(t, *self._polynomial(np.array(x), np.array(h), (q, v), points)))

    def _begin_from(self, state: State) -> None:
        super()._begin_from(state)
        self.mult, self._last, self.control.h_old = self.eq.multipliers(state), None, 0.0

    def _accept(self, h: float, points: Points) -> State:
        s, m = self.state, self.system.n_lam
        t = s.t + h
        if self.solver.core.redundant:
            mult = points.mult.copy()
            for i, share in enumerate(self.tab.c):
                q = self.system.compose(s.q, points.xi[i])
                mult[i] = self._smallest(float(s.t + share * h), q, mult[i])
            points = replace(points, mult=mult)

        # stiffly accurate: the last stage is the new state
        self._last = (h, s.q, s.v, points)
        self.mult = points.mult[-1]
        end = State(t, self.system.compose(s.q, points.xi[-1]), points.v[-1], self._acceleration, self.mult[:m])
        self.state = self._ended(h, end, self.mult)
        self._trouble = max(self._trouble - 1, 0)
        if self._theta > self.slow or not self.eq.dense:
            self._tangent = None
        return self.state

    # -- error --------------------------------------------------------------------------------------------------
    def _error_filter(self, h: float) -> Any:
        """The solver for gamma_0 / h, the first of the frequencies."""
        assert self._tangent is not None
        if isinstance(self._pencil, SparsePencil) and self._h_factor == h:
            return self._pencil
        self.stats.factorisations += 1
        return self.eq.pencil(self._tangent, np.array([self.tab.gamma / h]), self.judge)

    def _estimate(self, h: float, points: Points) -> float:
        s = self.state
        tab = self.tab
        assert self._tangent is not None
        if self._filter is None:
            self._filter = self._error_filter(h)

        # what the start of the step leaves of the constraints is no error of the step
        dq, v, a = self.eq.consistent_start(s)
        moved, change = points.xi - dq, points.v - v
        if self.scheme.form.index == 3:  # its velocities follow all increments of the stages
            change = change - np.outer(tab.W.sum(axis=1) / h, dq)
        kin = v + tab.error @ moved / h - self.eq.corrections(self.mult[None], 1)[0]
        push = a + tab.error @ change / h

        # filtered: components that the step does not resolve would be overestimated
        no_rows = np.zeros(self.eq.n_mult)
        low = np.concatenate((-self.eq.inertia(self._tangent, push), no_rows))
        errors, _ = self._filter.solve(-kin[None], low[None])
        e_q, e_v = errors.reshape(2, -1)
        # what forces are off by pushes; multipliers turn with their joints, whose errors light bodies would tell as huge ones
        pushed = push - tab.gamma / h * e_v if self.eq.levels and self.eq.dense else None
        return max(self._error_size(h, self._filter, e_q, e_v, pushed), self._memory_error(h))

    def _memory_error(self, h: float) -> float:
        """The same of the memories of elements."""
        weights, begun = self.tab.error / h, np.array([self.state.t])
        of_step = StepError(weights, -weights.sum(keepdims=True), begun, 1.0, self.tab.gamma / h, *self.norm.tolerances)
        return memory_error(self.system, of_step)
