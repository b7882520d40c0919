"""The forms of the equations of constrained motion, as arguments of a scheme, and their residuals in local coordinates.

    xi' = rate(xi, v - U mu),     v' = a - U tau,     M a + h + G^T lambda = 0,     U = W^-1 G^T                   (1)

with xi the local coordinates q = q_0 o exp(xi), W the mass matrix frozen over some steps, and constraints on the levels

    0: g = 0       1: G v + g_t = 0       2: G a + gamma = 0                                                       (2)

========================  =========  =====================================================================================
form                      levels     multipliers, what it guarantees
========================  =========  =====================================================================================
:class:`Index3`           0          lambda. Positions stay on the constraints; velocities and multipliers lose order.
:class:`Index2`           1          lambda. Velocities stay; positions drift linearly.
:class:`Index1`           2          lambda. Full order of everything; positions drift quadratically.
:class:`Baumgarte`        2          lambda, with g'' + 2 alpha g' + beta^2 g = 0: the drift is bounded, two numbers to choose.
:class:`GGL`              0, 1       lambda, mu (Gear, Gupta, Leimkuhler). No drift in positions and velocities.
:class:`Overdetermined`   0, 1, 2    lambda, mu, tau: all levels hold, mu and tau correct in mass-weighted least squares.
:class:`StateSpace`       0, 1, 2    The same, U frozen over the step: a step of the ODE in coordinates of the tangent space.
:class:`Projected`        of ``of``  After each step q, then v, are projected on (2) in the mass metric.
========================  =========  =====================================================================================

mu and tau vanish in the exact solution. The highest level goes with lambda, level 0 of several with mu, level 1 of three
with tau.

Sources: Gear, Gupta and Leimkuhler, doi:10.1016/0377-0427(85)90008-1; Baumgarte, doi:10.1016/0045-7825(72)90018-7;
Fuehrer and Leimkuhler, doi:10.1007/BF01385644 (overdetermined); Potra and Rheinboldt, doi:10.1080/08905459108905138
(tangent-space parametrisation); Eich, doi:10.1137/0730075 (projection); Hairer, Lubich and Roche, doi:10.1007/BFb0093947.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ..checks import check_fields
from ..errors import require
from ..linear.condensation import StepSolver, Weights
from ..linear.residual import Judge
from ..linear.saddle.pencil import Pencil, Tangent
from ..rotations import Array
from ..system.compiled.choice import use_driver
from ..system.evaluation_batch import EvaluationBatch
from ..system.linearise import at_once, differences
from ..system.scene.contents import Contents
from ..system.serialisation import Remembering, plain
from ..system.stiff_ties import stiff_ties
from ..system.system import State, System


CLOSINGS = 2  # corrections that bring an elongation from Newton's tolerance to roundoff


@dataclass(frozen=True)
class Form:
    """Which levels of the constraints hold. ``index`` is the differentiation index: it scales the components in error norms."""

    levels: ClassVar[tuple[int, ...]] = (0,)
    index: ClassVar[int] = 3
    frozen: ClassVar[bool] = False  # normal directions U at the start of the step
    projected: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """Name in reports and tables."""
        return type(self).__name__

    def rows(self, ev: Any, a: Array) -> Array:
        """The constraints of all levels, one after another, (k, levels n_lam), of k configurations with accelerations a."""
        made = {0: self._position, 1: self._velocity, 2: self._acceleration}
        return np.concatenate([made[level](ev, a) for level in self.levels], axis=-1)

    def rows_scale(self, s: Any) -> Any:
        """What a motion exp(s t) multiplies g by in the first of the rows, for a frequency s (1/s)."""
        return s ** self.levels[0]

    def _position(self, ev: Any, a: Array) -> Array:
        return ev.constraint()

    def _velocity(self, ev: Any, a: Array) -> Array:
        return ev.opening()

    def _acceleration(self, ev: Any, a: Array) -> Array:
        return ev.jacobian.times(a) + ev.gamma()


def positions_refused(held: Contents, name: str, levels: tuple[int, ...]) -> str:
    """Why a scheme or form ``name`` that asks for g = 0 does not take joints that hold velocities only; "" where it does."""
    if not held.rolling or 0 not in levels:
        return ""
    joint, kind = held.rolling[0]
    return (
        f'Joint "{joint}" ({kind}) holds velocities only, and {name} asks for positions. Take '
        "scheme=fmbd.GeneralizedAlpha(), fmbd.EnergyMomentum(), or BDF and Radau with form=fmbd.Index2()."
    )


class OfForm:
    """A scheme that takes the constraints in any form, but for those on positions where there are none."""

    form: Form

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return positions_refused(held, f"form={self.form.name}", self.form.levels)


@dataclass(frozen=True)
class Index3(Form):
    """Constraints on positions, g(q, t) = 0, with M a = f - G^T lambda: index 3."""


@dataclass(frozen=True)
class Index2(Form):
    """Constraints on velocities, G v + g_t = 0, with M a = f - G^T lambda: index 2.

    Positions drift from the joints, slowly; :class:`GGL` holds both.
    """

    levels = (1,)
    index = 2


@dataclass(frozen=True)
class Index1(Form):
    """Constraints on accelerations, G a + gamma = 0, with M a = f - G^T lambda: index 1, an ordinary differential equation.

    Positions and velocities drift from the joints as time goes on: for short runs, or inside of :class:`Projected`;
    :class:`Baumgarte` pulls them back.
    """

    levels = (2,)
    index = 1


@dataclass(frozen=True)
class Baumgarte(Form):
    """g'' + 2 alpha g' + beta^2 g = 0, alpha and beta in 1/s; alpha = beta is critical damping of the drift."""

    alpha: float = 10.0
    beta: float = 10.0
    levels = (2,)
    index = 1

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            self.alpha > 0 and self.beta > 0 and bool(np.isfinite(self.alpha + self.beta)),
            f"Baumgarte(alpha={self.alpha}, beta={self.beta}): both must be positive (1/s), else errors do not decay.",
        )

    @property
    def name(self) -> str:
        """With its two parameters."""
        return f"Baumgarte({self.alpha:g}, {self.beta:g})"

    def rows_scale(self, s: Any) -> Any:
        """s^2 + 2 alpha s + beta^2."""
        # of g'' + 2 alpha g' + beta^2 g for g ~ e^(s t)
        return s**2 + 2 * self.alpha * s + self.beta**2

    def _acceleration(self, ev: Any, a: Array) -> Array:
        rate = self._velocity(ev, a)
        return super()._acceleration(ev, a) + 2 * self.alpha * rate + self.beta**2 * ev.constraint()


@dataclass(frozen=True)
class GGL(Form):
    """Positions and velocities (Gear, Gupta, Leimkuhler), mass-weighted: xi' = v - M^-1 G^T mu."""

    levels = (0, 1)
    index = 2


@dataclass(frozen=True)
class Overdetermined(Form):
    """Constraints on positions, velocities and accelerations together, g = 0, G v + g_t = 0, G a + gamma = 0; what the scheme
    cannot meet exactly is corrected by least squares in the mass metric.
    """

    levels = (0, 1, 2)
    index = 2


@dataclass(frozen=True)
class StateSpace(Form):
    """The ODE in the tangent space of the constraints at the start of each step; the normal part follows from all levels."""

    levels = (0, 1, 2)
    index = 1
    frozen = True


@dataclass(frozen=True)
class Projected(Form):
    """Another form, followed by a projection of q, then v, in the mass metric after each step."""

    of: Form = field(default_factory=Index1)
    projected = True

    def __post_init__(self) -> None:
        check_fields(self)
        require(
            len(self.of.levels) == 1 and not self.of.projected,
            f"Projected({self.of.name}()): the form holds several levels by itself; project Index1 or Index2.",
        )

    @property
    def name(self) -> str:
        """With the form that is projected."""
        return f"Projected({self.of.name})"

    @property
    def levels(self) -> tuple[int, ...]:  # type: ignore[override]
        """Of the inner form."""
        return self.of.levels

    @property
    def index(self) -> int:  # type: ignore[override]
        """Of the inner form."""
        return self.of.index

    def rows(self, ev: Any, a: Array) -> Array:
        """The rows of the form that is projected."""
        return self.of.rows(ev, a)


@dataclass
class Points:
    """Instants in local coordinates: xi, xi', v, v' (k, n_v) and multipliers (k, levels n_lam)."""

    xi: Array
    rate: Array
    v: Array
    vd: Array
    mult: Array


class StepEquations(Remembering):
    """(1), (2) in the local coordinates of one step; shared by the implicit schemes. Small systems: dense.

    ``begin`` sets the origin of the coordinates, ``refresh`` the tangent, ``residual`` evaluates. Counts its work. Systems with
    elastic fields have :class:`.field_stages.FieldEquations`, with the same names.
    """

    keeps: ClassVar = dict.fromkeys(("residuals", "jacobians", "U", "normal", "origin", "_inverse_mass"), plain())
    dense = True
    counters: ClassVar[dict[str, float]] = {}

    def __init__(self, system: System, form: Form, solver: StepSolver) -> None:
        self.system, self.form, self.solver = system, form, solver
        self.levels = len(form.levels) if system.n_lam else 0
        self.stiff = stiff_ties(system)
        if "driver looked for" in system.cache:
            use_driver(self.stiff.system)
        self.n_mult = self.levels * system.n_lam + len(self.stiff)
        self.residuals = self.jacobians = 0
        self.U: Array = np.zeros((system.n_v, system.n_lam))
        self.U_ties: Array = np.zeros((system.n_v, len(self.stiff)))
        self.R: Array = self.U_ties.T  # of the last point
        self.normal: Array = self.U
        self.origin: Array = np.zeros(0)
        self._closed: State | None = None
        self._start: tuple[Array, Array, Array] = (self.origin,) * 3
        self._inverse_mass: Any = None

    def begin(self, state: State) -> None:
        """Local coordinates about the state."""
        self.origin = state.q
        if self.form.frozen and self.levels:
            ev = self.system.at(state.t, state.q, state.v)
            self.U = self._inverse_mass @ _dense(ev.jacobian.core).T

    def residual(self, t: Array, p: Points) -> tuple[Array, Array]:
        """r_kin (k, n_v) and r_low (k, n_v + n_mult) of (1), (2) at the times t (k,)."""
        s, m = self.system, self.system.n_lam
        self.residuals += len(t)

        ev = self.stiff.system.batch(t, s.compose(self.origin, p.xi), p.v)
        v, a = p.v, p.vd
        # more levels than one: positions or accelerations are corrected along M^-1 G^T
        if self.levels > 1:
            G = ev.jacobian.core[:, self.stiff.joints] if len(self.stiff) else ev.jacobian.core
            self.normal = self.U if self.form.frozen else self._inverse_mass @ G.swapaxes(1, 2)
            v = v - self._normally(p.mult[:, m : 2 * m])
            if self.levels > 2:
                a = a + self._normally(p.mult[:, 2 * m : 3 * m])

        if len(self.stiff):
            self.R = ev.jacobian.core[-1][self.stiff.ties]
        return p.rate - s.rate(p.xi, v), self._lower(ev, a, p.mult)

    def _lower(self, ev: EvaluationBatch, a: Array, mult: Array) -> Array:
        """The balance, the constraints of all levels, and the efforts of ties: (k, n_v + n_mult)."""
        m, ties = self.system.n_lam, self.stiff
        lam, efforts = mult[:, :m], mult[:, self.levels * m :]
        if not len(ties):
            balance = ev.balance(a, lam if self.levels else None)
            return np.concatenate((balance, self.form.rows(ev, a)), axis=1) if self.levels else balance

        rows = [ev.balance(a, ties.forces(lam, efforts))]
        if self.levels:
            every = self.form.rows(ev, a).reshape(len(a), self.levels, -1)
            rows.append(every[:, :, ties.joints].reshape(len(a), -1))
        rows.append(ties.residual(ev.constraint(), ev.opening(), efforts))
        return np.concatenate(rows, axis=1)

    def multipliers(self, state: State) -> Array:
        """Those that a state begins with, (n_mult,)."""
        efforts = self.stiff.efforts(self.system.at(state.t, state.q, state.v)) if len(self.stiff) else np.zeros(0)
        mult = np.zeros(self.n_mult)
        mult[: self.system.n_lam if self.levels else 0] = state.lam
        mult[self.n_mult - len(efforts) :] = efforts
        return mult

    def _normally(self, mult: Array) -> Array:
        """U times multipliers (k, n_lam), with the U of the last residual, (n_v, n_lam) or one for each of the k."""
        return mult @ self.normal.T if self.normal.ndim == 2 else (self.normal @ mult[..., None])[..., 0]

    def accelerations(self, p: Points) -> Array:
        """a = v' + U tau, (k, n_v), with the U of the last residual."""
        m = self.system.n_lam
        return p.vd + self._normally(p.mult[:, 2 * m : 3 * m]) if self.levels > 2 else p.vd

    def corrections(self, mult: Array, level: int) -> Array:
        """U times the multipliers (k, levels n_lam) of one level, (k, n_v); zero where the form has no such level."""
        m = self.system.n_lam
        return (
            mult[:, level * m : (level + 1) * m] @ self.U.T
            if self.levels > level
            else np.zeros((len(mult), self.system.n_v))
        )

    def pushes(self, mult: Array) -> Array | None:
        """Accelerations U lambda that the multipliers (k, n_mult) cause, (k, n_v); None without constraints."""
        return mult[:, : self.system.n_lam] @ self.U.T if self.levels else None

    def pulls(self, mult: Array) -> Array | None:
        """Accelerations that the efforts of ties in the multipliers (k, n_mult) cause, (k, n_v); None without ties."""
        return mult[:, self.n_mult - len(self.stiff) :] @ self.U_ties.T if len(self.stiff) else None

    def close_ties(self, t: float, q: Array, v: Array, mult: Array) -> Array:
        """A configuration whose ties have the efforts among the multipliers (n_mult,), with the least motion to it.

        What Newton's iteration leaves of a position, times k, is no small effort, and its square no small energy.
        """
        ties = self.stiff
        if not len(ties):
            return q
        for _ in range(CLOSINGS):
            ev = ties.system.at(t, q, v)
            rows = _dense(ev.jacobian.core)
            missing = np.zeros(len(rows))
            if self.form.levels[0] == 0:
                missing[ties.joints] = -ev.constraint()[ties.joints]
            left = ties.residual(ev.constraint()[None], ev.opening()[None], mult[None, self.n_mult - len(ties) :])
            missing[ties.ties] = -left[0] / ties.stiffness
            across = self._inverse_mass @ rows.T
            q = self.system.compose(q, across @ (np.linalg.pinv(rows @ across, hermitian=True) @ missing))
        return q

    def along_ties(self, h: float, v: Array) -> Array:
        """The part of velocities (n_v,) that ties hold in steps of h (s): all of it along ties of periods that h does not resolve.

            v - (M + R^T (h c + h^2 k) R)^-1 M v
        """
        ties = self.stiff
        if not len(ties):
            return np.zeros_like(v)
        held = np.diag(1.0 / (h * ties.damping + h * h * ties.stiffness)) + self.R @ self.U_ties
        return self.U_ties @ np.linalg.solve(held, self.R @ v)

    def inertia(self, tangent: Tangent, a: Array) -> Array:
        """M a at the tangent's motion."""
        return tangent.M @ a

    def pencil(self, tangent: Tangent, s: Array, judge: Judge) -> Pencil:
        """Solver of the stages for the frequencies s, (p,)."""
        return Pencil(tangent, s, judge, self.solver.core.redundant)

    def weigh(self, state: State) -> None:
        """Take the mass matrix of a state for the normal directions."""
        ev = self.system.at(state.t, state.q, state.v)
        self._inverse_mass = np.linalg.inv(_dense(self.solver.masses(ev)))

    def consistent_start(self, state: State) -> tuple[Array, Array, Array]:
        """What closes the constraints of a step's start: increments of q, the velocity on G v + g_t = 0, its acceleration.

        Above index 1 schemes leave errors of lower order across the constraints in a (index 3: in v too), and what Newton's
        tolerance permits in all of them. The next step forgets these; an error estimate must not take them for its own: they do
        not fall with the step.
        """
        if self.form.index == 1 or not self.levels:
            return np.zeros(self.system.n_v), state.v, state.a
        if self._closed is not state:
            s = self.system
            zero = np.zeros(s.n_v)
            ev = s.at(state.t, state.q, state.v)
            self.solver.prepare(ev, Weights(1.0, 0.0, 0.0))
            # positions, then velocities, then accelerations on their own levels
            dq = self.solver.solve(zero, -ev.constraint())[0] if 0 in self.form.levels else zero
            v = state.v + self.solver.solve(zero, -ev.opening())[0]
            ev = s.at(state.t, state.q, v)
            self._start = dq, v, self.solver.solve(-ev.balance(zero), -ev.gamma())[0]
            self._closed = state
        return self._start

    def refresh(self, state: State, mult: Array) -> Tangent:
        """The tangent of (1), (2) at a state with multipliers (n_mult,); also refreshes the metric W.

        M and G are assembled. Stiffness and damping of the balance, with the geometric stiffness (G^T lambda)_q, and the
        derivatives of the velocity and acceleration rows are directional derivatives, all directions in one evaluation.
        """
        s = self.system
        form = self.form
        n = s.n_v
        m = s.n_lam
        self.jacobians += 1
        q, v, a = state.q, state.v, state.a
        ev = s.at(state.t, q, v)
        M = _dense(self.solver.masses(ev))
        self._inverse_mass = np.linalg.inv(M)
        G = _dense(ev.jacobian.core)
        if not form.frozen:
            self.U = self._inverse_mass @ G.T

        def lower(at: EvaluationBatch) -> Array:
            k = len(at.q)
            return self._lower(at, np.broadcast_to(a, (k, n)), np.broadcast_to(mult, (k, self.n_mult)))

        by_q, by_v = differences(s, at_once(self.stiff.system, state.t, lower), (q, v, a))
        # known exactly: M, and G on the level of each row
        by_a = np.zeros_like(by_v)
        by_a[:n] = M
        for i, level in enumerate(form.levels[: self.levels]):
            rows = slice(n + i * m, n + (i + 1) * m)
            if level == 0:
                by_q[rows], by_v[rows] = G, 0.0
            elif level == 1:
                by_v[rows] = G
            else:
                by_a[rows] = G
        R = np.zeros((0, n))
        if ties := len(self.stiff):
            R = _dense(self.stiff.system.at(state.t, q, v).jacobian.core)[self.stiff.ties]
            self.U_ties = self._inverse_mass @ R.T
            by_q[-ties:], by_v[-ties:] = self.stiff.stiffness[:, None] * R, self.stiff.damping[:, None] * R
        return Tangent(self._turning(np.zeros(n), v)[0], M, G, self.U, by_q, by_v, by_a, R)

    def _turning(self, xi: Array, v: Array) -> tuple[Array, Array]:
        """d rate(xi, v) / d xi by differences, and the matrix T with v = T rate(xi, v)."""
        s = self.system
        eye = np.eye(s.n_v)
        if s.motions.dim == 2 or not s.n_frames:
            return np.zeros_like(eye), eye
        # rotations in space: xi' depends on xi
        J = (s.rate(xi + 1e-6 * eye, v) - s.rate(xi - 1e-6 * eye, v)).T / 2e-6
        return J, np.asarray(np.linalg.inv(s.rate(xi, eye).T))

    def tangent_at(self, t: float, xi: Array, v: Array, vd: Array, mult: Array) -> Tangent:
        """The tangent at a point of the local coordinates, for a full Newton iteration."""
        at = State(t, self.system.compose(self.origin, xi), v, vd, mult[: self.system.n_lam])
        made = self.refresh(at, mult)
        J, T = self._turning(xi, v)
        return replace(made, J=J, by_q=made.by_q @ T)


def step_equations(system: System, form: Form, solver: StepSolver) -> Any:
    """The equations of a step: with dense tangents, or by their action where there are elastic fields."""
    if not system.fields:
        return StepEquations(system, form, solver)
    from .field_stages import FieldEquations

    return FieldEquations(system, form, solver)


def _dense(A: Any) -> Array:
    return A if isinstance(A, np.ndarray) else np.asarray(A.toarray())
