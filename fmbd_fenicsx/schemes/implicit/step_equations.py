"""The equations of an implicit step of a system without elastic fields, in any form of its constraints.

They are (1), (2) of :mod:`..dae`, with efforts of stiff springs as unknowns beside the multipliers
(:mod:`~...system.tangents.stiff_ties`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from ...linear.condensation import StepSolver
from ...linear.implicit.pencil import Pencil
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.implicit.whole_pencil import WholePencil
from ...linear.redundancy import least_forces
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.couplings import Couplings
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.points import PointsTold
from ...system.compiled.states.stage_patterns import StageStructure
from ...system.evaluation import Evaluation
from ...system.evaluation_batch import EvaluationBatch
from ...system.layout import State
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ...system.tangents.stiff_ties import stiff_ties
from ..consistent import arrived
from ..dae import Form, Points
from .equations import Equations, Start
from .step_tangents import DenseTangents, RestingTangents, SparseTangents
from .whole_steps import WholeMatrixSteps

CLOSINGS = 2  # corrections that bring an elongation from Newton's tolerance to roundoff


class StepEquations(Equations):
    """Those of systems without elastic fields: tangents are matrices. Others have :class:`.field_stages.FieldEquations`."""

    keeps: ClassVar = dict.fromkeys(("residuals", "jacobians", "origin"), plain()) | {"tangents": worker}
    dense = True

    def __init__(self, system: System, form: Form, solver: StepSolver, acceleration: float = 0.0) -> None:
        """``acceleration``: of the start, see :func:`.stiff_ties`."""
        super().__init__(system, form, solver)
        self.stiff = stiff_ties(system, acceleration)
        self.tied = len(self.stiff) > 0
        self.n_mult += len(self.stiff)

        self.tangents: DenseTangents | SparseTangents = DenseTangents(system, self.form, self.stiff)
        self.resting: RestingTangents | None = None  # where parts rest on the ground
        self.whole = WholeMatrixSteps(self)
        self._chosen: Any = None  # who evaluated the system when these were chosen
        self._weighed: State | None = None  # whose masses are to be taken
        self._tangent_at: State  # of the newest tangent
        self._evaluated: tuple[Array, Points]  # times and points whose residual is the newest

    def remember(self, m: Memory) -> None:
        """With the tangents of the kind that the system has."""
        self.make_ready()
        super().remember(m)

    def _structure(self) -> StageStructure | None:
        """Patterns of the equations where compiled code knows them, and solves sparse stage systems; else None."""
        states, form = self.system.evaluator, self.form
        if not isinstance(states, DriverStates) or not form.by_levels or (self.tied and not states.same_rows):
            return None
        couplings = Couplings(states.tables)
        return StageStructure(couplings, states, form.levels, self.stiff, pulls=form.pulls, frozen=form.frozen)

    def make_ready(self) -> None:
        """Tangents of the kind that belongs to who evaluates the system by now, with the masses that were to be weighed."""
        if not isinstance(self.tangents, SparseTangents) and self._chosen is not self.system.evaluator:
            self._choose_tangents()
        if self._weighed is not None:
            state, self._weighed = self._weighed, None
            self.tangents.weigh(self.solver.masses(self.system.at(state.t, state.q, state.v)))

    def _choose_tangents(self) -> None:
        structure, self._chosen = self._structure(), self.system.evaluator
        if structure is not None and structure.states.same_rows:
            self.tangents = SparseTangents(self.system, structure, self.stiff)
        elif structure is not None:
            self.resting = RestingTangents(self.system, structure)

    def begin(self, state: State) -> None:
        """Local coordinates about the state."""
        self.make_ready()
        self.origin = state.q
        if self.form.frozen:
            self.tangents.direct(self.system.at(state.t, state.q, state.v).jacobian.core)

    def residual(self, t: Array, p: Points) -> tuple[Array, Array]:
        """r_kin and r_low of (1), (2), with what ties leave behind the rows of the form."""
        s, m = self.system, self.system.n_lam
        self.residuals += len(t)
        self._evaluated = t, p
        told = self._told(t, p)
        if told is not None:
            low = self.lower(told, p.vd, p.mult)
            self.left = low[-1, s.n_v : s.n_v + m]
            return p.rate - told.rates, low

        ev = self._batch(t, p)
        v, a = p.v, p.vd
        # more levels than one: positions or accelerations are corrected along M^-1 G^T
        if self.levels > 1:
            normal = self._normal_at(ev)
            v = v - _along(normal, p.mult[:, m : 2 * m])
            if self.levels > 2:
                a = a + _along(normal, p.mult[:, 2 * m : 3 * m])

        low = self.lower(ev, a, p.mult)
        self.left = low[-1, s.n_v : s.n_v + m]
        return p.rate - s.rate(p.xi, v), low

    def _batch(self, t: Array, p: Points) -> EvaluationBatch:
        """The system at these points."""
        return self.stiff.system.batch(t, self.system.compose(self.origin, p.xi), p.v)

    def _told(self, t: Array, p: Points) -> PointsTold | None:
        """All of it in one compiled call, where the form asks for places and velocities only; None where it is found in parts."""
        m, states = self.system.n_lam, self.system.evaluator
        own = not self.form.by_levels or 2 in self.form.levels
        if not isinstance(states, DriverStates) or own or self.tied:
            return None
        lam, mu = p.mult[:, :m], p.mult[:, m:]
        corrected = (mu, self.tangents.metric()) if self.levels > 1 else (None, None)
        return states.points(t, self.origin, (p.xi, p.v, p.vd), (lam, *corrected))

    def lower(self, ev: EvaluationBatch | PointsTold, a: Array, mult: Array) -> Array:
        """The balance, the constraints of all levels, and the efforts of ties: (k, n_v + n_mult)."""
        m, ties = self.system.n_lam, self.stiff
        lam, efforts = mult[:, :m], mult[:, self.levels * m :]
        if not self.tied:
            return self.form.lower(ev.balance(a, lam), ev, a)

        balance = ev.balance(a, ties.forces(lam, efforts))
        joints = [rows[:, ties.joints] for rows in self.form.rows(ev, a)]
        return np.concatenate((balance, *joints, ties.residual(ev.constraint(), ev.opening(), efforts)), axis=1)

    def multipliers(self, state: State) -> Array:
        """With the efforts of ties behind them."""
        mult = super().multipliers(state)
        if self.tied:
            mult[-len(self.stiff) :] = self.stiff.efforts(self.system.at(state.t, state.q, state.v))
        return mult

    def _normal_at(self, ev: EvaluationBatch) -> Array:
        """U at configurations, (k, n_v, n_lam), or that which the step keeps, (n_v, n_lam)."""
        if self.form.frozen:
            return self.tangents.directions()
        G = ev.jacobian.core[:, self.stiff.joints] if len(self.stiff) else ev.jacobian.core
        return np.asarray(self.tangents.matrix() @ G.swapaxes(1, 2))

    def end_acceleration(self, t: float, p: Points) -> Array:
        """a = v' + U tau at the last of the points."""
        m, a = self.system.n_lam, p.vd[-1]
        if self.levels < 3:
            return a
        q = self.system.compose(self.origin, p.xi[-1:])
        normal = self._normal_at(self.stiff.system.batch(np.array([t]), q, p.v[-1:]))
        return np.asarray(a + _along(normal, p.mult[-1:, 2 * m : 3 * m])[0])

    def corrections(self, mult: Array, level: int) -> Array:
        """U times the multipliers (k, levels n_lam) of one level, (k, n_v); zero where the form has no such level."""
        m = self.system.n_lam
        if self.levels <= level:
            return np.zeros((len(mult), self.system.n_v))
        return self.tangents.normally(mult[:, level * m : (level + 1) * m])

    def pushes(self, mult: Array) -> Array | None:
        """Accelerations U lambda, U tau that the multipliers (k, n_mult) cause, (1 or 2 k, n_v); None without constraints.

        Where rows depend, by the directions of the points evaluated last: forces between joints that cancel there do not by those
        of the tangent, and nothing else bounds them.
        """
        if not self.levels:
            return None
        m = self.system.n_lam
        accelerating = (0,) if self.levels < 3 else (0, 2)
        parts = [mult[:, level * m : (level + 1) * m] for level in accelerating]

        if self.solver.core.redundant and not self.form.frozen:
            normal = self._normal_at(self._batch(*self._evaluated))
            caused = [_along(normal, part) for part in parts]
        else:
            caused = [self.tangents.normally(part) for part in parts]
        return np.concatenate(caused) if len(caused) > 1 else caused[0]

    def pulls(self, mult: Array) -> Array | None:
        """Accelerations that the efforts of ties in the multipliers (k, n_mult) cause, (k, n_v); None without ties."""
        if not self.tied:
            return None
        return self.tangents.pulls(mult[:, self.n_mult - len(self.stiff) :])

    def close_ties(self, h: float, state: State, mult: Array) -> State:
        """The end of a step of h (s) with places and velocities that give ties the efforts among the multipliers (n_mult,).

        What Newton's iteration leaves of a place, times k, is no small effort, nor its square a small energy. Joints stay closed:

            R dq = (N - k (s - free) - c s') / (k + c / h),        G dq = 0,        dv = dq / h
        """
        ties = self.stiff
        if not self.tied:
            return state
        for _ in range(CLOSINGS):
            ev = ties.system.at(state.t, state.q, state.v)
            left = ties.residual(ev.constraint()[None], ev.opening()[None], mult[None, self.n_mult - len(ties) :])
            missing = ties.forces(np.zeros(self.system.n_lam), -left[0] / (ties.stiffness + ties.damping / h))
            rows = sp.csr_matrix(ev.jacobian.core)
            across = self.tangents.inverse() @ rows.T
            dq = across @ least_forces(rows @ across, missing)
            state = replace(state, q=self.system.compose(state.q, dq), v=state.v + dq / h)
        return state

    def along_ties(self, pencil: Any, v: Array) -> Array:
        """The part of velocities (k, n_v) that ties hold in a step with the factors of a real frequency s, joints closed: dv with

            M dv + G^T mu + R^T nu = 0,        G dv = 0,        R dv - nu / (c / s + k / s^2) = R v,

        all of R v where the step does not resolve the periods of ties.
        """
        ties, held = self.stiff, np.zeros_like(v)
        if not self.tied:
            return held
        n, s = self.system.n_v, pencil.s[0].real
        low, opened = np.zeros((1, n + self.n_mult)), self.tangents.of_ties(pencil.t, v)
        for i, rate in enumerate(opened):
            low[0, -len(ties) :] = -(ties.stiffness / s + ties.damping) * rate
            held[i] = pencil.solve(np.zeros((1, n)), low)[0][0, n:]
        return held

    def _closed_start(self, state: State) -> Start:
        """With accelerations anew; beside ties, whose efforts places tell to roundoff times k only, those of the step's end."""
        if self.tied:
            return super()._closed_start(state)
        s, places = self.system, 0 in self.form.levels
        made = arrived(s, state, self.solver, places=places)
        dq = s.difference(state.q, made.q) if places else np.zeros(s.n_v)
        return dq, made.v, made.a

    def refresh(self, state: State, mult: Array) -> Any:
        """The tangent of (1), (2) at a state with multipliers (n_mult,); also refreshes the metric W.

        M and G are assembled. Stiffness and damping of the balance, with the geometric stiffness (G^T lambda)_q, and the
        derivatives of the velocity and acceleration rows are directional derivatives, all directions in one evaluation.
        """
        self.jacobians += 1
        self._tangent_at = state

        def lower(at: EvaluationBatch) -> Array:
            k = len(at.q)
            return self.lower(at, np.repeat(state.a[None], k, axis=0), np.repeat(mult[None], k, axis=0))

        return self.tangents.take(state, mult, self.solver, lower)

    def taken_at(self, tangent: Any) -> Evaluation:
        """As :meth:`Equations.taken_at`."""
        return self.system.at(self._tangent_at.t, self._tangent_at.q, self._tangent_at.v)

    def tangent_at(self, t: float, xi: Array, v: Array, vd: Array, mult: Array) -> Any:
        """As :meth:`Equations.tangent_at`."""
        at = State(t, self.system.compose(self.origin, xi), v, vd, mult[: self.system.n_lam])
        return self.tangents.at_increments(self.refresh(at, mult), xi, v)

    def whole_pencil(self, tangents: list[Any], rates: Array, judge: Judge) -> WholePencil:
        """Solver of stages with a tangent each; ``rates``: d rate / d xi, (k, k)."""
        redundant = self.solver.core.redundant
        units = self.system.multiplier_units if redundant else None
        first = self.form.levels[0] if self.levels else 0
        structure, entries = self.tangents.together(tangents)
        return WholePencil(structure, entries, rates, judge, first=first, units=units, corrections=redundant)

    def inertia(self, tangent: Any, a: Array) -> Array:
        """M a at the tangent's motion."""
        return self.tangents.inertia(tangent, a)

    def pencil(self, tangent: Any, s: Array, judge: Judge, points: int = 1) -> Pencil | SparsePencil | WholePencil:
        """Solver of so many stages for the frequencies s, (p,)."""
        self.make_ready()  # a checkpoint asks before any step
        return self.tangents.pencil(tangent, s, judge, redundant=self.solver.core.redundant, points=points)

    def weigh(self, state: State) -> None:
        """Take the mass matrix of a state for the normal directions, see :meth:`make_ready`."""
        self._weighed = state


def _along(normal: Array, mult: Array) -> Array:
    """U times multipliers (k, n_lam), for one U (n_v, n_lam) or one of each."""
    return np.asarray(mult @ normal.T if normal.ndim == 2 else (normal @ mult[..., None])[..., 0])


def step_equations(system: System, form: Form, solver: StepSolver, acceleration: float) -> Any:
    """The equations of a step: with dense tangents, or by their action where there are elastic fields; ``acceleration``: of the
    start (m/s^2).
    """
    if not system.fields:
        return StepEquations(system, form, solver, acceleration)
    from .field_stages import FieldEquations

    return FieldEquations(system, form, solver)
