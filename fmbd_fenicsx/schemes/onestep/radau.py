"""Radau IIA with two, three, five or seven stages: variable steps, simplified Newton iteration, any form of the constraints.

In local coordinates y = (xi, v) about the step's start, collocation at the nodes c_i (c_s = 1) with A^-1 = (w_ij) reads

    y'_i = (1 / h) sum_j w_ij (y_j - y_n),        the equations of motion hold at (t_n + c_i h, y_i, y'_i)        (1)

so the scheme is stiffly accurate: the last stage is the new state, and it satisfies the constraints. Orders for q, v, lambda:
index 3: 2s-1, s, s-1; index 2 and GGL: 2s-1, 2s-1, s; index 1 and state space: 2s-1 in all.

One Newton iteration solves the stages together: the eigenvectors of A^-1 decouple them into one system for each complex pair
(and, for an odd number of stages, a real one) with the frequencies gamma / h. Stages are evaluated in one call. Tangent and
factors are kept while Newton converges fast and the step changes little. The local error is estimated by an embedded formula of
order s, filtered by the real matrix gamma_0 / h; and once more, but for elastic fields, ties and laws with a memory, by what the
motion leaves of the equations between two stages, which is as large where that is smooth.

Sources: Hairer and Wanner, Solving ODEs II, sections IV.8 and VII.4, doi:10.1007/978-3-642-05221-7; Hairer, Lubich and Roche,
doi:10.1007/BFb0093947; local coordinates: Munthe-Kaas, doi:10.1007/BF02510919.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...errors import CallbackError, ConvergenceError, LinearSolveError, require
from ...linear.condensation import StepSolver
from ...linear.frequency_solvers import often
from ...rotations import Array
from ...system.compiled.implicit import WORK, ImplicitRoom
from ...system.compiled.march import March
from ...system.compiled.own_steps import OwnRoom
from ...system.compiled.states.convergence import Convergence
from ...system.compiled.states.stages import StageRule
from ...system.layout import State, States
from ...system.serialisation import plain
from ...system.system import System
from ..consistent import arrived
from ..control import DEARLY, ESTIMATE, StepControl, moves, turn_limit, turns_too_far
from ..dae import GGL, Form, OfForm, Points
from ..error_norm import check_controlled, worst
from ..implicit.implicit_stepper import ImplicitStepper
from ..newton import Newton
from .collocation import Tableau, controlled, tableau
from .last_step import LastStep, StageStart, keep_last
from .stage_newton import LEAST_SHARE, LONGER, RATES, StageNewton

if TYPE_CHECKING:
    from ...system.compiled.kept import KeptSteps

TROUBLED = 4  # trouble beyond which stages that have failed take a tangent each


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
    takes_given: ClassVar[bool] = True
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


class RadauStepper(ImplicitStepper):
    """Advances a consistent state; holds the multipliers at its end, (levels n_lam,), the last step and the step control."""

    maker = "RADAU"
    slow = 1e-2
    iteration: StageNewton
    keeps: ClassVar = {**ImplicitStepper.keeps, "_last": keep_last, **dict.fromkeys(("mult", "_trouble"), plain())}

    def __init__(self, scheme: Radau, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        super().__init__(scheme, system, solver, newton, state)
        self.tab = self._coefficients()
        self.control = StepControl(scheme.stages + 1.0, dear=not self.eq.dense)
        self.iteration = StageNewton(self.eq, self.norm, newton, self.tab, adaptive=self.adaptive)
        self.mult: Array = self.eq.multipliers(state)
        self._last: LastStep | None = None
        self._trouble = 0  # two for each failure of Newton's iteration, less one for each step
        self.eq.weigh(state)
        self.eq.keep_sizes(equal=not self.adaptive)

    def _coefficients(self) -> Tableau:
        """With a real frequency, where errors are filtered, or fields close joints on two levels."""
        real = self.adaptive or (self.eq.levels > 1 and not self.eq.dense)
        return (controlled if real else tableau)(self.scheme.stages)

    def _begin_from(self, state: State) -> None:
        super()._begin_from(state)
        self.mult, self._last, self.control.h_old = self.eq.multipliers(state), None, 0.0

    def take_given(self, sizes: Array) -> None:
        """As :meth:`OwnMarch.take_given`: those that come often have factors from their first step on."""
        super().take_given(sizes)
        for h in often(sizes):
            self.eq.expect(self._frequencies(h))

    @property
    def _turning(self) -> int:
        """By how much less than others steps may turn: many stages share one tangent that long."""
        return 2 if self.scheme.form.frozen or self.scheme.stages > 3 else 1

    @property
    def _start(self) -> StageStart:
        """Where the next step begins."""
        return StageStart(self.state, self.mult, self._last)

    # -- one accepted step --------------------------------------------------------------------------------------
    def _constant(self, h: float) -> State:
        """A step of size h; where the tangent of the step fails, with one for each stage."""
        s, start, iteration = self.state, self._start, self.iteration
        self.eq.begin(s)
        found = "full" if iteration.full else iteration.with_new_tangent(s, lambda: iteration.find(h, start))
        if isinstance(found, str):
            if not iteration.full:
                iteration.begin_spell()
            self.eq.begin(s)
            found = iteration.found(s, lambda: iteration.iterate_full(h, start))
        if isinstance(found, str):
            iteration.full = False  # parts of the step begin like others
            raise iteration.failure(s.t + h, h, found)
        return self._accept(h, found)

    def _controlled(self, limit: float) -> State:
        """A step of at most ``limit`` (s) that passes the error test."""
        s = self.state
        self.control.span = max(self.control.span, limit)
        # coordinates on the tangent space of the start end after a quarter turn; many stages share one tangent that long
        farthest = turn_limit(self.system, s, steps=self._turning)
        if self.proposed is None:
            self.proposed = self._first_size(self.control.order, limit)
        self.proposed = self.control.proposal(self.proposed, limit)

        h, points, error = self._passing(limit, farthest)
        self.local_error = error
        self.proposed = self._next_size(h, limit, error)
        return self._accept(h, points)

    def _passing(self, limit: float, farthest: float) -> tuple[float, Points, float]:
        """The first step, of ever smaller ones, that passes the error test: its size (s), stages and error."""
        s, start, iteration = self.state, self._start, self.iteration
        assert self.proposed is not None
        while True:
            h = self._landing(self.eq.step_size(min(self.proposed, farthest)), limit)
            moves(s.t, h)
            self.solver.near_singular.begin_trial()
            self.norm.update(s, h)
            self.eq.begin(s)

            points = iteration.find(h, start)
            if not isinstance(points, str) and turns_too_far(self.system, points.xi):
                points = "turns too far"
            if isinstance(points, str):
                cause, error = points, np.inf
                if iteration.renews():
                    continue  # once more with a new tangent
                self._trouble += 2
                # on the way through a singular configuration smaller steps fail alike
                if self._trouble > TROUBLED:
                    points = iteration.find_singular(h, start)
                    # masses and directions of constraints are those of stages that ran away
                    if isinstance(points, str):
                        iteration.tangent = None
                    else:
                        self.control.rejections.append((s.t, h, DEARLY))

            if not isinstance(points, str):
                error, cause = self._estimate(h, points), ESTIMATE
                if self.control.passes(error):
                    self.solver.near_singular.accept_trial()
                    return h, points, error
                iteration.theta = max(iteration.theta, 1e-3)
            self.stats.rejected[cause] += 1
            self.control.fault = iteration.fault
            self.proposed = self.control.rejected(s.t, h, error, cause)

    def _next_size(self, h: float, limit: float, error: float) -> float:
        """The size (s) that is proposed after a step of size h: smaller where Newton's iteration had to work hard."""
        most = 2 * self.newton.max_iterations
        effort = (most + 1) / (most + self.iteration.done)
        new = self.control.accepted(h, error, effort)
        if self.iteration.theta < 1e-2 and 1.0 <= new / h <= 1.2:
            new = h  # keep the factors

        # a step cut short by the end tells nothing of the next one
        cut_short = h >= limit and new >= limit
        assert self.proposed is not None
        return max(new, self.proposed) if cut_short else new

    def _accept(self, h: float, points: Points) -> State:
        s, m = self.state, self.system.n_lam
        t = s.t + h
        acceleration = self.eq.end_acceleration(t, points)
        if self.solver.core.redundant:
            mult = points.mult.copy()
            for i, share in enumerate(self.tab.c):
                q = self.system.compose(s.q, points.xi[i])
                mult[i] = self._smallest(float(s.t + share * h), q, mult[i])
            points = replace(points, mult=mult)

        # stiffly accurate: the last stage is the new state
        strays = self._start.strays(self.system, self.tab, h, points.xi)
        self._last = LastStep(h, s.q, s.v, points, strays)
        self.mult = points.mult[-1]
        end = State(t, self.system.compose(s.q, points.xi[-1]), points.v[-1], acceleration, self.mult[:m])
        self.state = self._ended(h, end, self.mult)
        self._trouble = max(self._trouble - 1, 0)
        if self.iteration.theta > self.slow or not self.eq.dense:
            self.iteration.tangent = None
        return self.state

    # -- error --------------------------------------------------------------------------------------------------
    def _estimate(self, h: float, points: Points) -> float:
        s, tab = self.state, self.tab

        # what the start of the step leaves of the constraints is no error of the step
        dq, v, a = self.eq.consistent_start(s)
        moved, change = points.xi - dq, points.v - v
        if self.scheme.form.index == 3:  # its velocities follow all increments of the stages
            change = change - np.outer(tab.W.sum(axis=1) / h, dq)
        kin = v + tab.error @ moved / h - self.eq.corrections(self.mult[None], 1)[0]
        push = a + tab.error @ change / h

        error = worst(self._filtered_size(h, -kin, push), self._memory_error(h))
        left = self._left_between(h, (dq, moved), (v, change), points.mult) if self.eq.looks_between else None
        return error if left is None else worst(error, self._filtered_size(h, *left))

    def _filtered_size(self, h: float, kin: Array, push: Array) -> float:
        """The norm of errors by what is left of the rates of xi and by accelerations that are missing, like v. Filtered:
        components that the step does not resolve would be overestimated.
        """
        iteration = self.iteration
        pencil = iteration.filter()
        low = np.concatenate((-self.eq.inertia(iteration.tangent, push), np.zeros(self.eq.n_mult)))
        errors, _ = pencil.solve(kin[None], low[None])
        e_q, e_v = errors.reshape(2, -1)
        # what forces are off by pushes; multipliers turn with their joints, whose errors light bodies would tell as huge ones
        pushed = push - self.tab.gamma / h * e_v if self.eq.levels and self.eq.dense else None
        return self._error_size(h, pencil, e_q, e_v, pushed)

    def _left_between(
        self, h: float, places: tuple[Array, Array], speeds: tuple[Array, Array], mult: Array
    ) -> tuple[Array, Array] | None:
        """What the motion through the stages leaves of the equations between two of them, None where these have no solution:
        a force that bends within a step may leave nothing of one such sum by luck, hardly of two.

        ``places``, ``speeds``: those of the start, and changes from there to the stages.
        """
        system, eq, origin = self.system, self.eq, self.state
        (dq, moved), (v, change) = places, speeds
        (at, alike), (values, rates, levels) = self.tab.between[:2], self.tab.between[2:].reshape(3, -1)
        xi, faster = dq + values @ moved, rates @ change / h
        there = State(origin.t + at * h, system.compose(origin.q, xi), v + values @ change, faster, origin.lam)
        try:
            there = arrived(system, there, self.solver, places=False)
        except (CallbackError, ConvergenceError, LinearSolveError, np.linalg.LinAlgError):
            return None
        fast = there.v - eq.corrections((levels @ mult)[None], 1)[0]
        missed = rates @ moved / h - system.rate(xi[None], fast[None])[0]
        return alike * missed, alike * (there.a - faster)

    def _memory_error(self, h: float) -> float:
        """The same of the memories of elements."""
        weights, begun = self.tab.error / h, np.array([self.state.t])
        return self.norm.of_memories(weights, -weights.sum(keepdims=True), begun, 1.0, self.tab.gamma / h)

    # -- what a march begins with -----------------------------------------------------------------------------------
    def _lend(self) -> ImplicitRoom:
        tab = self.tab
        coefficients = {name: getattr(tab, name) for name in ("c", "W", "values", "middle", "basis", "stage_basis")}
        stages = self.eq.whole.room(len(tab.values), len(tab.c))
        own = None
        if self.adaptive:
            own = self._own_room(
                error=tab.error, between=tab.between if self.eq.looks_between else None,
                places=0 in self.scheme.form.levels, turning=self._turning, most=2.0 * self.newton.max_iterations,
                troubled=TROUBLED if self.eq.dense else 0, **self.eq.size_grid,
            )  # fmt: skip
        room = ImplicitRoom(stages, coefficients, own=own)
        room.c.longer, room.c.least_share = LONGER, LEAST_SHARE
        return room

    def _settings(self) -> tuple[Convergence, StageRule]:
        tab = self.tab
        return self.iteration.convergence(0.0, RATES[self.adaptive], 1.0), StageRule(tab.W, tab.inverse, tab.vectors)

    def _memory(self) -> Array:
        s, k, control, twin, iteration = self.state, len(self.tab.c), self.control, self._twin, self.iteration
        none: Array = np.zeros((k, len(s.v)))
        last = self._last or LastStep(0.0, s.q, s.v, Points(none, none, none, none, np.tile(self.mult, k)))
        found, kept = (iteration.eta, iteration.h_rate), (control.h_old, control.error_old)
        head = *found, self.proposed or 0.0, *kept, float(last.strays), last.h
        q, v, xi, vs = twin.configurations(last.q), *map(twin.velocities, (last.v, last.points.xi, last.points.v))
        return np.concatenate((head, q, v, xi.ravel(), vs.ravel(), last.points.mult.ravel()))

    def _factored_for(self) -> float:
        return self.iteration.h_factor

    def _frequencies(self, h: float) -> Array:
        return self.tab.frequencies(h)

    def _solved_for(self, h: float) -> Array:
        return self._frequencies(h)

    def _lend_matrices(self, h: float) -> None:
        assert self._lent is not None
        self.eq.whole.lend_matrices(self._lent.stages, self.state, self._frequencies(h))

    # -- what it leaves ---------------------------------------------------------------------------------------------
    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        self._trouble = self._trouble if self.adaptive else max(self._trouble - made, 0)

    def _lend_own(self, own: OwnRoom) -> None:
        super()._lend_own(own)
        own.c.trouble = self._trouble

    def _take_own(self, own: OwnRoom, made: int) -> None:
        super()._take_own(own, made)
        self._trouble = int(own.c.trouble)
        self.iteration.judge.solves += int(own.c.filtered)  # of the estimates

    def _recall(self, kept: Array, factored: float) -> None:
        head, last = self._told(kept)
        iteration, control = self.iteration, self.control
        iteration.eta, iteration.h_rate, proposed, h_old, error_old = map(float, head[:-2])
        iteration.take_factors(factored)
        if self.adaptive:
            self.proposed, control.h_old, control.error_old = proposed, h_old, error_old
        self._last, self.mult = replace(last, h=float(last.h), strays=bool(last.strays)), last.points.mult[-1]

    def _told(self, kept: Array) -> tuple[Array, LastStep]:
        """Numbers, and the step, of what the end of one keeps; of many likewise."""
        assert self._lent is not None
        twin, k = self._twin, len(self.tab.c)
        n, n_q = self._lent.stages.c.n, twin.system.n_q
        ends = accumulate((7, n_q, n, k * n, k * n, kept.shape[-1]), initial=0)
        head, q, v, *stages = (kept[..., i:j] for i, j in pairwise(ends))
        xi, vs, mult = (x.reshape(*kept.shape[:-1], k, -1) for x in stages)
        q, (v, xi, vs) = twin.places(q), map(twin.forces, (v, xi, vs))
        strays, h = head[..., -2], head[..., -1]
        W = self.tab.W / h[..., None, None]
        return head, LastStep(h, q, v, Points(xi, W @ xi, vs, W @ (vs - v[..., None, :]), mult), strays)

    # -- states within steps ----------------------------------------------------------------------------------------
    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, by its collocation polynomial; None after a new start."""
        last = self._last
        if last is None:
            return None
        x = np.array(1.0 - (self.state.t - t) / last.h)
        return self._held(last.h, State(t, *last.at(self.system, self.tab, x)[:4]))

    def divided(self, parts: int) -> tuple[States, Array]:
        """The states at the beginnings of equal parts of the last step, the newest first, and all multipliers (parts, n_mult)."""
        assert self._last is not None
        last, shares = self._last, 1.0 - np.arange(1, parts + 1) / parts
        *found, mult = last.at(self.system, self.tab, shares)
        t = self.state.t - (1.0 - shares) * last.h
        return self._all_held(np.full(parts, last.h), States(t[:, None], *found)), mult

    @property
    def last_size(self) -> float:
        """Of the last step, s."""
        assert self._last is not None
        return float(self._last.h)

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`."""
        _, made = self._told(steps.own[:, WORK:])
        x = 1.0 - (steps.after.t - steps.t)[:, 0] / made.h
        return self._all_held(made.h, States(steps.t, *made.at(self.system, self.tab, x)[:4]))
