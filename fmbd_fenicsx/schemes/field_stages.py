"""Stages of implicit schemes for systems with elastic fields: Newton's matrix by its action, preconditioned by real factors.

A stage system of frequency s (real, or one of a complex pair of the scheme's coefficients) reads, with D = s - d rate/d xi,

    dv = D dxi + r_kin + N dc,       da = s dv + N de                                                              (1)
    d balance [dxi, dv, da] + G^T dlambda = -r_low,        d rows [dxi, dv, da] = -r_rows                          (2)

The brackets are directional derivatives at one motion in the middle of the step: one more evaluation of the forces, inertia of
the deformed body, gyroscopic terms and turned reactions included. N c is the motion with G N c = c that is least in the metric
of P below, at the start of the step: a floating body has no mass matrix that could be inverted, but this motion is always
determined, so the multipliers of corrections are replaced by the slips c, e that they close; and it is smooth, where the
least motion by the mass alone would dent a stiff body at its joint. As G N = 1, c and e follow after dxi.

GMRES solves (2) divided by s^2. Its preconditioner is the matrix of a real step,

    P = [ M + C / |s| + K / |s|^2    G^T ]          eigenvalues of P^-1 J: on the segment from 1 to |s|^2 / s^2    (3)
        [ G                            0 ]

whatever the stiffness, so the residual falls by tan(arg(s^2) / 4) an iteration: 0.32 with two stages, 0.45 with three. All
stages and the filter of the error estimate share one elastic factor. |s| is taken from a geometric grid of three values
for a decade, whose factors are kept: the step itself may have any size.

Sources: Saad and Schultz, doi:10.1137/0907058; real preconditioners of complex symmetric systems: Axelsson and Kucherov,
doi:10.1002/1099-1506(200005)7:4<197::AID-NLA194>3.0.CO;2-S; Newton-Krylov: Knoll and Keyes, doi:10.1016/j.jcp.2003.08.010.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..errors import LinearSolveError
from ..fem.fields import rank_sum
from ..linear.condensation import StepSolver, Weights
from ..linear.residual import Judge
from ..rotations import Array
from ..system.evaluation import Evaluation
from ..system.serialisation import Memory, Remembering, plain
from ..system.system import State, System
from .dae import Form, Points

MASS = Weights(1.0, 0.0, 0.0)
SHIFT = float(np.sqrt(np.finfo(float).eps))  # of a difference quotient, over the model's length
DECADE = 3  # factors kept for a decade of step sizes
KEPT = 6  # sets of elastic factors, that of the mass included
ACCURATE = 1e-2  # share of the residual that an inner iteration leaves
LIMIT = 40  # inner iterations


@dataclass(frozen=True, eq=False)
class FieldTangent:
    """The motion at which derivatives are taken, and the balance and rows there, (n_v + levels n_lam,)."""

    form: Form
    levels: int
    state: State
    ev: Evaluation
    low: Array

    def along(self, dq: Array, dv: Array, da: Array) -> Array:
        """Derivative of balance and rows along (dq, dv, da), complex directions by their two parts; collective."""
        if np.iscomplexobj(dq) or np.iscomplexobj(dv) or np.iscomplexobj(da):
            real = self.along(dq.real, dv.real, da.real)
            return real + 1j * self.along(dq.imag, dv.imag, da.imag)  # type: ignore[no-any-return]

        system, s = self.ev.system, self.state
        # lengths: positions, and what velocities move within the time in which they change
        size = max(system.max_abs(dq), system.max_abs(dv) ** 2 / max(system.max_abs(da), 1e-300))
        if size == 0.0:
            size = system.max_abs(da) or 1.0
        eps = SHIFT * system.length / size

        ev = system.at(s.t, system.compose(s.q, eps * dq), s.v + eps * dv)
        moved = lower(self.form, self.levels, ev, s.a + eps * da, s.lam)
        return (moved - self.low) / eps

    def turning(self, d: Array) -> Array:
        """Derivative of rate(xi, v) along d at xi = 0; not collective."""
        system, k = self.ev.system, self.ev.system.n_frames * self.ev.system.motions.n_twist
        if system.motions.dim == 2 or not k:
            return np.zeros_like(d)
        if np.iscomplexobj(d):
            return self.turning(d.real) + 1j * self.turning(d.imag)  # type: ignore[no-any-return]
        size = float(np.abs(d[:k]).max(initial=0.0))
        if size == 0.0:
            return np.zeros_like(d)
        e = 1e-6 / size
        return (system.rate(e * d, self.state.v) - system.rate(-e * d, self.state.v)) / (2 * e)


def lower(form: Form, levels: int, ev: Evaluation, a: Array, lam: Array) -> Array:
    """Balance and constraint rows of one configuration, (n_v + levels n_lam,); collective."""
    balance = ev.balance(a, lam if levels else None)
    return np.concatenate((balance, form.rows(ev, a))) if levels else balance


class FieldEquations(Remembering):
    """What :class:`.StepEquations` is for small systems, for those with elastic fields; the same names. Collective.

    Multipliers of the second and third level are the slips c (m/s) and e (m/s^2) of (1).
    """

    keeps: ClassVar = {
        **dict.fromkeys(("residuals", "jacobians", "krylov", "anchor"), plain()),
        "metric": plain(Weights),
    }
    dense = False

    def __init__(self, system: System, form: Form, solver: StepSolver) -> None:
        self.system, self.form, self.solver = system, form, solver
        self.levels = len(form.levels) if system.n_lam else 0
        self.residuals = self.jacobians = self.krylov = 0
        self.origin: Array = np.zeros(0)
        self.anchor: float | None = None  # |s| of the grid's first factor, 1/s
        solver.elastic.kept = KEPT
        self.metric = MASS  # of the corrections N c: the matrix P of the step
        self._last_metric = MASS  # of the step before: its errors across the constraints are of least size in it
        self._begun: State | None = None
        self._start_ev: Evaluation | None = None
        self._closed: State | None = None
        self._start: tuple[Array, Array, Array] = (self.origin,) * 3

    @property
    def counters(self) -> dict[str, float]:
        """Work that dense systems do not have."""
        return {"stage_iterations": self.krylov}

    def remember_points(self, m: Memory, last: Any) -> Any:
        """The last step: its size, q and v at its start, and its stages, in an order that does not depend on the ranks."""
        if not m("last", last is not None):
            return None
        h, q, v, p = last or (None,) * 4
        stages = m("stages", 0 if p is None else len(p.xi))
        rows: dict[str, list[Array]] = {name: [] for name in ("xi", "rate", "v", "vd")}
        for name, made in rows.items():
            for i in range(stages):
                made.append(m.like_v(f"{name} {i}", None if p is None else getattr(p, name)[i]))
        mult = m("mult", None if p is None else p.mult)
        xi, rate, vs, vd = (np.array(x) for x in rows.values())
        points = Points(xi, rate, vs, vd, mult)
        return m("h", h), m.like_q("q", q), m.like_v("v", v), points

    # -- residuals ----------------------------------------------------------------------------------------------
    def begin(self, state: State) -> None:
        """Local coordinates about the state."""
        if self._begun is not state:
            self._begun, self._start_ev = state, None
            self._last_metric = self.metric
        self.origin = state.q

    def residual(self, t: Array, p: Points) -> tuple[Array, Array]:
        """r_kin (k, n_v) and r_low (k, n_v + levels n_lam) at the times t (k,)."""
        s, m = self.system, self.system.n_lam
        self.residuals += len(t)
        slips = self.corrections(p.mult, 1)
        pulls = self.corrections(p.mult, 2)

        kin, low = [], []
        for i, time in enumerate(t):
            v, a = p.v[i] - slips[i], p.vd[i] + pulls[i]
            ev = s.at(float(time), s.compose(self.origin, p.xi[i]), p.v[i])
            low.append(lower(self.form, self.levels, ev, a, p.mult[i, :m]))
            kin.append(p.rate[i] - s.rate(p.xi[i], v))
        return np.array(kin), np.array(low)

    def corrections(self, mult: Array, level: int) -> Array:
        """N c of the multipliers (k, levels n_lam) of one level, (k, n_v); zero where the form has no such level."""
        m = self.system.n_lam
        out = np.zeros((len(mult), self.system.n_v))
        if self.levels <= level:
            return out
        for i in range(len(mult)):
            slip = mult[i, level * m : (level + 1) * m]
            if slip.any():
                out[i] = self.closing(slip)
        return out

    def closing(self, slip: Array) -> Array:
        """N c, like v; complex slips by their parts."""
        if np.iscomplexobj(slip):
            return self.closing(slip.real) + 1j * self.closing(slip.imag)  # type: ignore[no-any-return]
        if self._start_ev is None:
            assert self._begun is not None
            self._start_ev = self.system.at(self._begun.t, self._begun.q)
        self.solver.prepare(self._start_ev, self.metric)
        return self.solver.solve(np.zeros(self.system.n_v), slip)[0]

    def accelerations(self, p: Points) -> Array:
        """a = v' + N e, (k, n_v)."""
        return p.vd + self.corrections(p.mult, 2)

    def pushes(self, mult: Array) -> Array | None:
        """Accelerations that multipliers cause: without an inverse of the mass they stay out of error norms."""
        return None

    def weigh(self, state: State) -> None:
        """Nothing: N takes the mass where it needs it."""

    def consistent_start(self, state: State) -> tuple[Array, Array, Array]:
        """What closes the constraints of a step's start, as :meth:`.StepEquations.consistent_start`."""
        if self.form.index == 1 or not self.levels:
            return np.zeros(self.system.n_v), state.v, state.a
        if self._closed is state:
            return self._start

        s, zero = self.system, np.zeros(self.system.n_v)
        ev = s.at(state.t, state.q, state.v)
        self.solver.prepare(ev, self._last_metric)

        def closed(gap: Array) -> Array:
            return self.solver.solve(zero, -gap)[0]

        dq = closed(ev.constraint()) if 0 in self.form.levels else zero
        v = state.v + closed(ev.opening())
        a = state.a + closed(ev.jacobian.times(state.a) + s.at(state.t, state.q, v).gamma())
        self._start, self._closed = (dq, v, a), state
        return self._start

    # -- derivatives --------------------------------------------------------------------------------------------
    def refresh(self, state: State) -> FieldTangent:
        """Derivatives at a state from now on."""
        self.jacobians += 1
        ev = self.system.at(state.t, state.q, state.v)
        low = lower(self.form, self.levels, ev, state.a, state.lam)
        return FieldTangent(self.form, self.levels, state, ev, low)

    def inertia(self, tangent: FieldTangent, a: Array) -> Array:
        """M a at the tangent's motion."""
        zero = np.zeros_like(a)
        return tangent.along(zero, zero, a)[: self.system.n_v]

    def pencil(self, tangent: FieldTangent, s: Array, judge: Judge) -> FieldStages:
        """Solver of (2) for the frequencies s, (p,)."""
        return FieldStages(self, tangent, s, judge)

    def weights(self, frequency: float) -> Weights:
        """The real step of (3), |s| rounded to the geometric grid."""
        if self.anchor is None:
            self.anchor = frequency
        places = round(DECADE * float(np.log10(frequency / self.anchor)))
        grid = self.anchor * 10.0 ** (places / DECADE)
        return Weights(1.0, 1.0 / grid, 1.0 / grid**2)


class FieldStages:
    """(2) solved for frequencies s, (p,) real or complex, by preconditioned GMRES; what :class:`.Pencil` is for small systems."""

    def __init__(self, equations: FieldEquations, tangent: FieldTangent, s: Array, judge: Judge) -> None:
        self.eq, self.t, self.s, self.judge = equations, tangent, s, judge
        self.weights = equations.metric = equations.weights(float(np.abs(s).max()))
        self.share = _shares(equations.system)

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """Increments dxi, dv side by side (p, 2 n_v) and multipliers (p, levels n_lam), for residuals r_kin (p, n_v) and r_low
        (p, n_v + levels n_lam).
        """
        made = [self._one(s, np.asarray(kin[i]), np.asarray(low[i])) for i, s in enumerate(self.s)]
        return np.array([x for x, _ in made]), np.array([y for _, y in made])

    def _one(self, s: Any, kin: Array, low: Array) -> tuple[Array, Array]:
        """dxi, dv side by side, and the multipliers, of one frequency."""
        if s.imag == 0:
            s, kin, low = s.real, kin.real, low.real
        eq, n, m, L = self.eq, self.eq.system.n_v, self.eq.system.n_lam, self.eq.levels

        # slips that follow from the rows alone: their motion acts on the balance
        rate = kin
        if L > 1:
            slip = s * low[n : n + m] - low[n + m : n + 2 * m] - self._rows(kin)
            rate = kin + eq.closing(slip)
        push = s * rate
        if L > 2:
            pull = s * low[n + m : n + 2 * m] - low[n + 2 * m :]
            push = push + eq.closing(pull)

        eq.solver.prepare(self.t.ev, self.weights)
        dxi, dv, dlam, left = self._motion(s, (rate, push), low)
        mult = [dlam]
        if L > 1:  # what the motion itself adds
            mult.append(slip + left[:m])
            dv = dv + eq.closing(left[:m])
        if L > 2:
            mult.append(pull + left[m:] - s * left[:m])
        return np.concatenate((dxi, dv)), np.concatenate(mult) if L else np.zeros(0)

    def _rows(self, x: Array) -> Array:
        """G x at the tangent's motion."""
        times = self.t.ev.jacobian.times
        return times(x.real) + 1j * times(x.imag) if np.iscomplexobj(x) else times(x)

    def _motion(self, s: Any, known: tuple[Array, Array], low: Array) -> tuple[Array, Array, Array, Array]:
        """dxi, dv and dlambda of one frequency for known parts of dv and da, and what the further rows leave open."""
        eq, t, (rate, push) = self.eq, self.t, known
        n, m = eq.system.n_v, eq.system.n_lam
        scale = eq.form.rows_scale(s)

        def parts(r: Array) -> tuple[Array, Array]:
            return r[:n] / s**2, r[n : n + m] / scale if eq.levels else np.zeros(0)

        def lift(d: Array) -> Array:
            return s * d - t.turning(d)

        rows: list[Array] = []

        def action(d: Array) -> tuple[Array, Array]:
            dv = lift(d)
            r = t.along(d, dv, s * dv)
            rows.append(r[n + m :])
            return self._precondition(*parts(r))

        low = low + t.along(np.zeros_like(rate), rate, push)  # on all ranks, also where this one's share is zero
        dxi, dlam, combination = self._gmres(action, self._precondition(*parts(-low)))

        left = -low[n + m :]
        for c, r in zip(combination, rows, strict=True):
            left = left - c * r
        return dxi, lift(dxi) + rate, s**2 * dlam, left

    def _precondition(self, b: Array, c: Array) -> tuple[Array, Array]:
        """P^-1 of (3), real and imaginary parts one after the other."""
        solve = self.eq.solver.solve
        self.judge.solves += 1
        if not np.iscomplexobj(b):
            return solve(b, c)
        c = c.astype(complex)
        (x, y), (u, w) = solve(b.real, c.real), solve(b.imag, c.imag)
        return x + 1j * u, y + 1j * w

    def _gmres(
        self, action: Callable[[Array], tuple[Array, Array]], first: tuple[Array, Array]
    ) -> tuple[Array, Array, Array]:
        """dxi and multiplier of P^-1 J x = ``first``, and the coefficients of the basis that make dxi."""
        x, y = first
        norm = np.sqrt(self._dot(x[None], x)[0].real)
        if not 0.0 < norm < np.inf:
            if norm == 0.0:
                return x, y, np.zeros(0)
            raise LinearSolveError(f"{self.judge.what}: the first increment is not finite.")

        basis, reactions = [x / norm], []
        H = np.zeros((LIMIT + 1, LIMIT), dtype=x.dtype)
        goal = np.zeros(LIMIT + 1)
        goal[0] = norm
        for j in range(LIMIT):
            w, reaction = action(basis[j])
            reactions.append(reaction)
            V = np.array(basis)
            for _ in range(2):  # twice is enough
                h = self._dot(V, w)
                H[: j + 1, j] += h
                w = w - h @ V
            H[j + 1, j] = np.sqrt(self._dot(w[None], w)[0].real)
            self.eq.krylov += 1

            c = np.linalg.lstsq(H[: j + 2, : j + 1], goal[: j + 2], rcond=None)[0]
            left = float(np.linalg.norm(goal[: j + 2] - H[: j + 2, : j + 1] @ c))
            if left <= ACCURATE * norm or abs(H[j + 1, j]) <= 1e-14 * norm:
                break
            if j == LIMIT - 1:
                raise LinearSolveError(
                    f"{self.judge.what}: {LIMIT} iterations of the stages left {left / norm:.1e} of the residual."
                )
            basis.append(w / H[j + 1, j])

        return c @ np.array(basis[: len(c)]), y - c @ np.array(reactions), c

    def _dot(self, V: Array, w: Array) -> Array:
        """Inner products of vectors (k, n_v) with one: mean squares of each field, sums of the core; collective."""
        system, n = self.eq.system, self.eq.system.n_core
        V, w = V.conj() * self.share, w * self.share
        core = V[:, :n] @ w[:n]
        return core + np.asarray(rank_sum(system.comm, V[:, n:] @ w[n:]))


def _shares(system: System) -> Array:
    """Weights like v that turn increments into lengths, those of a field into its root mean square."""
    if "shares" not in system.cache:
        share = system.units.copy()
        for k, part in system.fields:
            count = rank_sum(system.comm, np.array(float(part.n)))
            share[system.slices[1][k]] /= np.sqrt(max(float(count), 1.0))
        system.cache["shares"] = share
    found: Array = system.cache["shares"]
    return found
