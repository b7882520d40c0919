"""Stages of implicit schemes for systems with elastic fields: Newton's matrix by its action, preconditioned by real factors.

A stage system of frequency s (real, or one of a complex pair of the scheme's coefficients) reads, with D = s - d rate/d xi,

    dv = D dxi + r_kin + N dc,       da = s dv + N de                                                              (1)
    d balance [dxi, dv, da] + G^T dlambda = -r_low,        d rows [dxi, dv, da] = -r_rows                          (2)

The brackets are directional derivatives at one motion in the middle of the step: one more evaluation of the forces, inertia of
the deformed body, gyroscopic terms and turned reactions included. N c is the motion with G N c = c that is least in the metric
of P below, where derivatives are taken: a floating body has no mass matrix that could be inverted, but this motion is always
determined, so the multipliers of corrections are replaced by the slips c, e that they close; and it is smooth, where the
least motion by the mass alone would dent a stiff body at its joint. As G N = 1, c and e follow after dxi.

How (2) is solved: :mod:`.stage_krylov`. States are evaluated in compiled code where that knows the fields.
Source of the forms: :mod:`..dae`. Newton-Krylov methods: Knoll and Keyes, doi:10.1016/j.jcp.2003.08.010.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.frequency_solvers import DECADE, FrequencySolver, FrequencySolvers
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.field_stages import FieldStageRoom
from ...system.compiled.states.points import PointsTold
from ...system.compiled.states.stages import StageRule
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.serialisation import Remembering, plain, worker
from ...system.system import System
from ..consistent import MASS
from ..dae import Form, Points
from .equations import Equations, Start
from .field_renewals import FieldRenewals
from .field_tangent import FieldTangent
from .stage_krylov import FieldStages
from .stage_pressures import StagePressures
from .whole_steps import WholeFieldSteps

COLUMNS = 64  # multipliers for which N is kept as a matrix
ROUNDED_UP = 1.1  # what a step may be longer than the one proposed, whose safety allows it
ROUNDOFF = 1e-14  # of rates, over their largest


class ClosingMotions(Remembering):
    """The motions N of one step with G N = 1, N c least of all such motions in the ``metric`` of the step's matrix.
    Collective.
    """

    keeps: ClassVar = {"metric": plain(Weights)}

    def __init__(self, solver: StepSolver) -> None:
        self.solver = solver
        self.metric = MASS
        self._begun: State | None = None
        self._at: Evaluation | None = None
        self._known: tuple[Evaluation, Weights, Array] | None = None  # N, and what it is taken for

    def begin(self, state: State) -> None:
        """N is that of the state at which a step begins."""
        self._begun, self._at = state, None

    def take(self, ev: Evaluation) -> None:
        """N is that of where derivatives are taken."""
        self._at = ev

    def _taken(self) -> Evaluation:
        if self._at is None:
            assert self._begun is not None
            self._at = self.solver.system.at(self._begun.t, self._begun.q)
        return self._at

    @property
    def columns(self) -> Array:
        """N, (n_v, n_lam), solved for once."""
        ev, known = self._taken(), self._known
        if known is None or known[0] is not ev or known[1] != self.metric:
            self.solver.prepare_once(ev, self.metric)
            self._known = known = ev, self.metric, self.solver.closing(np.eye(self.solver.system.n_lam))
        return known[2]

    def times(self, slips: Array) -> Array:
        """N c of slips (k, n_lam), (k, n_v); complex ones by their parts."""
        if slips.shape[1] <= COLUMNS:
            return slips @ self.columns.T

        self.solver.prepare_once(self._taken(), self.metric)
        closing = self.solver.closing
        if np.iscomplexobj(slips):
            return np.asarray(closing(slips.real.T).T + 1j * closing(slips.imag.T).T)
        return closing(slips.T).T


class FieldEquations(Equations):
    """Those of systems with elastic fields, whose tangents are known by their action.

    Multipliers of the second and third level are the slips c (m/s) and e (m/s^2) of (1).
    """

    keeps: ClassVar = {
        **dict.fromkeys(("residuals", "jacobians", "krylov", "trusted", "size_anchor", "_equal", "estimates"), plain()),
        "solvers": worker,
        "_last_metric": plain(Weights),
        **dict.fromkeys(("closing", "renewals"), worker),
    }
    dense = False

    def __init__(self, system: System, form: Form, solver: StepSolver) -> None:
        super().__init__(system, form, solver)
        self.krylov = 0
        self.solvers = FrequencySolvers(system, solver)
        self.trusted = True  # whether exact factors of a frequency need no iteration

        self.size_anchor: float | None = None  # first step of the grid, s
        self._equal = False  # whether all steps, of which none was made so far, are to have one size
        self.estimates = False  # whether steps end with :meth:`consistent_start`

        self.closing = ClosingMotions(solver)
        self._begun: State | None = None
        self._room: FieldStageRoom | None = None
        self.pressures = StagePressures(solver)
        self.renewals = FieldRenewals(system)
        self.left_motions: Array = np.zeros((1, 0))  # of frequencies, what iterations have left, as pressures see it

        self.whole = WholeFieldSteps(self)

    @property
    def counters(self) -> dict[str, float]:
        """Iterations of the stage systems."""
        return {"stage_iterations": self.krylov}

    # -- residuals ----------------------------------------------------------------------------------------------
    def begin(self, state: State, *, closed: bool = True) -> None:
        """Local coordinates about the state; ``closed``: with :meth:`consistent_start`, where that is asked for."""
        self.pressures.begin(known=self._begun is state)
        if self._begun is state:
            self.renewals.begin_again()
        else:
            self._begun = state
            self.renewals.begin()
            self.closing.begin(state)
            self._last_metric = self.closing.metric
            if self.estimates and closed:  # while the matrix is at hand
                self.consistent_start(state)
        self.origin = state.q

    def keep_sizes(self, *, equal: bool) -> None:
        """Steps keep to a few sizes, as :meth:`step_size` does, or to that of the first one: factors of these pay."""
        self.solvers.settles, self._equal = True, equal

    def step_size(self, h: float) -> float:
        """The largest step of a geometric grid that is hardly above h (s): few sizes, whose factors are kept."""
        if self.size_anchor is None:
            self.size_anchor = h
        places = np.floor(DECADE * np.log10(ROUNDED_UP * h / self.size_anchor))
        return float(self.size_anchor * 10.0 ** (places / DECADE))

    @property
    def size_grid(self) -> dict[str, float]:
        """As :meth:`Equations.size_grid`."""
        return {"first": self.size_anchor or 0.0, "places_of_decade": DECADE, "longer": ROUNDED_UP}

    @property
    def frequency_grid(self) -> dict[str, float]:
        """As :meth:`Equations.frequency_grid`."""
        return {"anchor": self.solvers.anchor or 0.0, "places_of_decade": DECADE}

    def expect(self, s: Array) -> None:
        """As :meth:`Equations.expect`."""
        self.solvers.settles = True
        self.solvers.expect(s)

    def metric_of(self, h: float, s: Array) -> Weights:
        """The real one of those that the step was solved with; one at hand may be of another step of the same march."""
        real = s.real[s.imag == 0]
        return self.solvers.at_hand(float(real[0])) if len(real) else self.closing.metric

    def residual(self, t: Array, p: Points) -> tuple[Array, Array]:
        """r_kin (k, n_v) and r_low (k, n_v + levels n_lam) at the times t (k,); behind it, where bodies carry pressures, the
        share of these in the balance.
        """
        s, m = self.system, self.system.n_lam
        self.residuals += len(t)
        told = self._told(t, p)

        if told is not None:
            low, rates = self.form.lower(told.sums, told, p.vd), told.rates
        else:
            q, a, lam = s.compose(self.origin, p.xi), self.accelerations(p), p.mult[:, :m]
            ev = s.batch(t, q, p.v)
            rates = s.rate(p.xi, p.v)
            if self.pressures.fields:
                balance, pushes = self.pressures.balances(
                    [s.at(float(t[i]), q[i], p.v[i]) for i in range(len(t))], a, lam
                )
                low = np.concatenate((self.form.lower(balance, ev, a), pushes), axis=1)
            else:
                low = self.form.lower(ev.balance(a, lam), ev, a)

        self.left = low[-1, s.n_v : s.n_v + m]
        return self._lacking(p, rates), low

    def _told(self, t: Array, p: Points) -> PointsTold | None:
        """All of it in one compiled call, where the form asks for places and velocities only; None where it is found in parts."""
        states = self.system.evaluator
        if not isinstance(states, DriverStates) or not self._known or self.pressures.fields:
            return None
        return states.points(t, self.origin, (p.xi, p.v, p.vd), (p.mult[:, : self.system.n_lam], None, None))

    def aligned(self, t: Array, W: Array, p: Points) -> Points:
        """Foretold stages at the times t (k,) with velocities and multipliers that go with their places; d rate = W dxi."""
        v, mult = p.v + self._lacking(p, self.system.rate(p.xi, p.v)), p.mult
        if self.levels > 1:  # what rows of velocities ask for where places do not close
            m = self.system.n_lam
            ev = self.system.batch(t, self.system.compose(self.origin, p.xi), v)
            slips = W @ ev.constraint() - ev.opening()
            v, mult = v + self.closing.times(slips), mult.copy()
            mult[:, m : 2 * m] += slips
        return replace(p, v=v, vd=p.vd + W @ (v - p.v), mult=mult)

    def _lacking(self, p: Points, rates: Array) -> Array:
        """What velocities (k, n_v), whose rates of xi are given, lack to be those of the places: r_kin, without roundoff."""
        slips = self._slips(p.mult, 1)
        left = p.rate - rates if slips is None else p.rate - rates + self.system.rate(p.xi, self.closing.times(slips))
        return np.where(np.abs(left) > ROUNDOFF * self.system.largest(p.rate), left, 0.0)

    def _slips(self, mult: Array, level: int) -> Array | None:
        """The slips (k, n_lam) of one level among multipliers (k, levels n_lam); None without any."""
        m = self.system.n_lam
        slips = mult[:, level * m : (level + 1) * m]
        return slips if self.levels > level and slips.any() else None

    def corrections(self, mult: Array, level: int) -> Array:
        """N c of the multipliers (k, levels n_lam) of one level, (k, n_v); zero where the form has no such level."""
        slips = self._slips(mult, level)
        return np.zeros((len(mult), self.system.n_v)) if slips is None else self.closing.times(slips)

    def stage_room(self, frequencies: int, points: int, square: Array) -> FieldStageRoom | None:
        """Room of compiled code for increments of so many points, their lengths squared by these weights; None without any."""
        states, shape = self.system.evaluator, (frequencies, points)
        if not self.covered or not isinstance(states, DriverStates):
            return None
        if self._room is None or self._room.states is not states or self._room.shape != shape:
            self._room = FieldStageRoom(states, self.form.levels, shape, square)
        return self._room

    @property
    def covered(self) -> bool:
        """Whether compiled code adds increments of these forms."""
        return self.system.n_lam <= COLUMNS and self._known

    @property
    def _known(self) -> bool:
        """Whether compiled code evaluates points of these forms."""
        return self.form.by_levels and 2 not in self.form.levels

    def solvers_of(self, s: Array) -> list[FrequencySolver]:
        """Who solves for the frequencies s (p,)."""
        if self._equal:
            self.solvers.expect(s)
            self._equal = False
        return self.solvers.of_all(s)

    def follow(self, dxi: Array, rule: StageRule) -> None:
        """As :meth:`Equations.follow`: pressures move along, and take what iterations have left of the balance."""
        self.renewals.count(1, rule.relax)
        if self.pressures.fields:
            self.pressures.move(dxi + rule.relax * (rule.vectors @ self.left_motions).real, rule.relax)

    def taken_at(self, tangent: FieldTangent) -> Evaluation:
        """As :meth:`Equations.taken_at`."""
        return tangent.ev

    def accelerations(self, p: Points) -> Array:
        """a = v' + N e, (k, n_v)."""
        slips = self._slips(p.mult, 2)
        return p.vd if slips is None else p.vd + self.closing.times(slips)

    def end_acceleration(self, t: float, p: Points) -> Array:
        """As :meth:`Equations.end_acceleration`."""
        return self.accelerations(p)[-1]

    def consistent_start(self, state: State) -> Start:
        """With the matrix of the step, which is at hand when the next one begins."""
        self.estimates = True
        return super().consistent_start(state)

    # -- derivatives --------------------------------------------------------------------------------------------
    def refresh(self, state: State, mult: Array) -> FieldTangent:
        """Derivatives at a state with multipliers (n_mult,) from now on."""
        self.jacobians += 1
        state = replace(state, lam=mult[: self.system.n_lam])
        ev = self.evaluation(state)
        self.closing.take(ev)
        with self.pressures.held(self.pressures.start):
            self.renewals.take(ev, self.origin)
            self.pressures.turn(ev)
            low = self.form.lower(ev.balance(state.a, state.lam), ev, state.a)
        return FieldTangent(self.system, self.form, state, ev, low, self.pressures)

    def evaluation(self, state: State) -> Evaluation:
        """The system in a state with its accelerations and multipliers, whose stresses tangents take."""
        ev = self.system.at(state.t, state.q, state.v)
        ev.forces = state.a, state.lam
        return ev

    def renew(self) -> bool:
        """As :meth:`Equations.renew`."""
        return self.renewals.ask()

    def tangent_at(self, t: float, xi: Array, v: Array, vd: Array, mult: Array) -> FieldTangent:
        """As :meth:`Equations.tangent_at`: with new tangents of the fields."""
        self.renewals.ask(again=True)
        return self.refresh(State(t, self.system.compose(self.origin, xi), v, vd, mult[: self.system.n_lam]), mult)

    def inertia(self, tangent: FieldTangent, a: Array) -> Array:
        """M a at the tangent's motion."""
        zero = np.zeros_like(a)
        return tangent.along(zero, zero, a)[: self.system.n_v]

    def pencil(self, tangent: FieldTangent, s: Array, judge: Judge, points: int = 1) -> FieldStages:
        """Solver of (2) for the frequencies s, (p,)."""
        return FieldStages(self, tangent, s, self.solvers_of(s), judge, points)
