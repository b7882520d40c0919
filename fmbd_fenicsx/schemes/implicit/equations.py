"""What the equations of an implicit step answer to a scheme, whoever evaluates and solves them."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.stages import StageRule
from ...system.control.memory_points import PointRule
from ...system.element_memory import collocate, collocated
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.serialisation import Remembering
from ...system.system import System
from ...system.tangents.creep import creeps, laws_that_bend
from ..consistent import MASS
from ..dae import Form, Points, Unconstrained
from .whole_steps import WholeSteps

Start = tuple[Array, Array, Array]  # an increment of q, v and a


class Equations(Remembering):
    """(1), (2) of :mod:`..dae` in the local coordinates of one step: ``begin`` sets their origin, ``refresh`` the tangent,
    ``residual`` evaluates. What is not said otherwise is that of equations without ties, whose matrices are not kept. Collective.
    """

    dense: ClassVar[bool]  # whether a tangent is a matrix, which serves several steps
    whole: WholeSteps  # in compiled code

    def __init__(self, system: System, form: Form, solver: StepSolver) -> None:
        self.system, self.solver = system, solver
        self.form = form if system.n_lam else Unconstrained()
        self.levels = len(self.form.levels)
        self.n_mult = self.levels * system.n_lam
        self.residuals = self.jacobians = 0
        self.left: Array = np.zeros(system.n_lam)  # the first rows of the form at the last point
        self.origin: Array = np.zeros(0)
        self._last_metric = MASS  # of the step before: its errors across the constraints are of least size in it
        self._closed: State | None = None
        self._start: Start = (self.origin,) * 3

    @property
    def counters(self) -> dict[str, float]:
        """Work of their own kind."""
        return {}

    def begin(self, state: State) -> None:
        """Local coordinates about the state."""
        raise NotImplementedError

    def keep_sizes(self, *, equal: bool) -> None:
        """Steps keep to a few sizes, those of :meth:`step_size`, or to that of the first one."""

    def step_size(self, h: float) -> float:
        """The size (s) that a step of about h has."""
        return h

    @property
    def size_grid(self) -> dict[str, float]:
        """The sizes that steps keep to, as own_steps.c has them; none: any size will do."""
        return {}

    @property
    def frequency_grid(self) -> dict[str, float]:
        """The frequencies (1/s) that have factors, as bdf.c has them; none: any one has."""
        return {}

    def expect(self, s: Array) -> None:
        """Frequencies s (p,) come often: where factors are kept they get their own at once."""

    def metric_of(self, h: float, s: Array) -> Weights:
        """The matrix of a step of h (s) for frequencies s (p,), in which motions are least that do not bend what is stiff."""
        return Weights(1.0, h, h * h)

    def weigh(self, state: State) -> None:
        """Take the mass matrix of a state for the normal directions, where they need it."""

    # -- residuals ----------------------------------------------------------------------------------------------
    @property
    def looks_between(self) -> bool:
        """Whether accelerations are known at any instant of a step: memories are at its points alone, as efforts of ties are."""
        return self.dense and self.n_mult == self.levels * self.system.n_lam and not collocated(self.system)

    def residual(self, t: Array, p: Points) -> tuple[Array, Array]:
        """r_kin (k, n_v) and r_low (k, n_v + n_mult) of (1), (2) at the times t (k,)."""
        raise NotImplementedError

    def left_of(self, t: Array, p: Points, rule: StageRule) -> tuple[Array, Array]:
        """:meth:`residual`, with the memories of elements at the points."""
        self.collocate(t, p, rule)
        return self.residual(t, p)

    def collocate(self, t: Array, p: Points, rule: StageRule) -> None:
        """Find the memories of elements at points."""
        if collocated(self.system):
            points = PointRule(t, rule.couple, rule.past, rule.ends)
            collocate(self.system, points, self.system.compose(self.origin, p.xi), p.v)

    def follow(self, dxi: Array, rule: StageRule) -> None:
        """Move what is eliminated from them along with increments (k, n_v) of the points of :meth:`residual`."""

    def creeps(self, tangent: Any, t: Array, p: Points, dxi: Array, dv: Array) -> bool:
        """Whether increments (k, n_v) to points at the times t (k,) moved on by slopes that laws have at the tangent alone."""
        if not laws_that_bend(self.system):
            return False
        q = self.system.compose(self.origin, p.xi)
        points = ((self.system.at(float(t[i]), q[i], p.v[i]), dxi[i], dv[i]) for i in range(len(t)))
        return creeps(self.system, self.taken_at(tangent), points)

    def taken_at(self, tangent: Any) -> Evaluation:
        """The system where the newest tangent was taken."""
        raise NotImplementedError

    def aligned(self, t: Array, W: Array, p: Points) -> Points:
        """Foretold stages at the times t (k,) as an iteration wants to begin; d rate = W dxi."""
        return p

    def end_acceleration(self, t: float, p: Points) -> Array:
        """a of the last of the points, which is at t, (n_v,), corrected along the constraints."""
        raise NotImplementedError

    # -- multipliers --------------------------------------------------------------------------------------------
    def multipliers(self, state: State) -> Array:
        """Those that a state begins with, (n_mult,)."""
        mult = np.zeros(self.n_mult)
        mult[: self.system.n_lam] = state.lam
        return mult

    def corrections(self, mult: Array, level: int) -> Array:
        """How multipliers (k, n_mult) of one level correct velocities or accelerations, (k, n_v); zero without such a level."""
        raise NotImplementedError

    def pushes(self, mult: Array) -> Array | None:
        """Accelerations that multipliers (k, n_mult) cause, (1 or 2 k, n_v), where they are known."""
        return None

    def pulls(self, mult: Array) -> Array | None:
        """Accelerations that the efforts of ties in the multipliers (k, n_mult) cause, (k, n_v); None without ties."""
        return None

    # -- ends of steps ------------------------------------------------------------------------------------------
    def close_ties(self, h: float, state: State, mult: Array) -> State:
        """The end of a step of h (s) with places and velocities that give ties the efforts among the multipliers (n_mult,)."""
        return state

    def along_ties(self, pencil: Any, v: Array) -> Array:
        """The part of velocities (k, n_v) that ties hold in a step with these factors."""
        return np.zeros_like(v)

    def consistent_start(self, state: State) -> Start:
        """What closes the constraints of a step's start: increments of q, the velocity on G v + g_t = 0, its acceleration.

        Above index 1 schemes leave errors of lower order across the constraints in a (index 3: in v too), and what Newton's
        tolerance permits in all of them. The next step forgets these; an error estimate must not take them for its own: they do
        not fall with the step.
        """
        if self.form.index == 1:
            return np.zeros(self.system.n_v), state.v, state.a
        if self._closed is not state:
            self._start, self._closed = self._closed_start(state), state
        return self._start

    def _closed_start(self, state: State) -> Start:
        """Moved across the constraints alone, accelerations too: the balance that a step has ended with is not asked again."""
        s, zero = self.system, np.zeros(self.system.n_v)
        ev = s.at(state.t, state.q, state.v)
        self.solver.prepare_once(ev, self._last_metric)

        def closed(gap: Array) -> Array:
            return self.solver.solve(zero, -gap)[0]

        dq = closed(ev.constraint()) if 0 in self.form.levels else zero
        q = s.compose(state.q, dq)  # rows turn by dq
        v = state.v + closed(s.at(state.t, q, state.v).opening())
        ev = s.at(state.t, q, v)
        a = state.a + closed(ev.jacobian.times(state.a) + ev.gamma())
        return dq, v, a

    # -- tangents -----------------------------------------------------------------------------------------------
    def refresh(self, state: State, mult: Array) -> Any:
        """The tangent at a state with multipliers (n_mult,)."""
        raise NotImplementedError

    def tangent_at(self, t: float, xi: Array, v: Array, vd: Array, mult: Array) -> Any:
        """The tangent at a point of the local coordinates, for a full Newton iteration."""
        raise NotImplementedError

    def renew(self) -> bool:
        """Whether the next :meth:`refresh` takes what serves many steps anew, for a step that has failed without."""
        return False

    def inertia(self, tangent: Any, a: Array) -> Array:
        """M a at the tangent's motion."""
        raise NotImplementedError

    def pencil(self, tangent: Any, s: Array, judge: Judge, points: int = 1) -> Any:
        """Solver of so many stages for the frequencies s, (p,)."""
        raise NotImplementedError
