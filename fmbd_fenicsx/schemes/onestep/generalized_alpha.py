"""Generalized-alpha on a Lie group, index-3 form.

    q_n+1 = q_n o exp(h v_n + h^2 ((1/2 - beta) A_n + beta A_n+1))                                        (1)
    v_n+1 = v_n + h ((1 - gamma) A_n + gamma A_n+1)                                                       (2)
    (1 - alpha_m) A_n+1 + alpha_m A_n = (1 - alpha_f) a_n+1 + alpha_f a_n                                 (3)
    M a + h + G^T lambda = 0,   g = 0     at t_n+1                                                        (4)

A is the algorithmic acceleration; the alphas weight the *old* value. alpha_m = (2 rho - 1) / (rho + 1), alpha_f = rho / (rho
+ 1), gamma = 1/2 + alpha_f - alpha_m, beta = (gamma + 1/2)^2 / 4 with rho the spectral radius at infinite frequency. Newton
solves for increments of q with the balance (4) multiplied by s = beta h^2 (1 - alpha_f) / (1 - alpha_m): the matrix is M +
.. + s K and the multiplier s lambda, so its condition does not depend on h (Bottasso, Dopico and Trainelli,
doi:10.1007/s11044-007-9051-9).

The smooth solution of (1)..(3) along a constrained motion has A_n = a(t_n + (alpha_m - alpha_f) h) and velocities that miss
the velocity constraints by h^2 G (c v'' + v x v' / 12) with c = 1/6 - beta - (alpha_m - alpha_f) / 2 (the product acts on
rotations in space). Starting with exact values instead excites a transient that leaves q and v of second order but makes
lambda of first order until rho^n is small. The first step therefore starts from A_0 = a_0 + (alpha_m - alpha_f) h a'_0 and
from v_0 + dv with M dv + G^T mu = 0 and G dv equal to that expression (Arnold, Bruels and Cardona,
doi:10.1007/s00211-014-0633-1). The recorded state at the start stays exact.

By the same amount c h^2 v'' + h^2 v x v' / 12, in all directions, velocities differ from the derivatives of the places that (1)
gives: the values within a step are those of the cubic with slopes that are less by it, with v'' = (A_n+1 - A_n) / h, and joints
are then closed by the least motion.

The stabilised form, ``form=GGL()``, demands both levels: G v + g_t = 0 at t_n+1 goes with lambda, and (1) gains a correction
-M^-1 G^T mu that closes g = 0. Velocities are then exact on their level, the start needs A_0 only, and rho_inf = 1 stays stable.
One iteration costs a second solve with the same factor.

Sources: Chung and Hulbert, doi:10.1115/1.2900803; Bruels, Cardona and Arnold, doi:10.1016/j.mechmachtheory.2011.07.017;
Arnold and Bruels, doi:10.1007/s11044-007-9084-0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from ...errors import ConvergenceError, LinearSolveError, require
from ...linear.blocks.incompressibility import volume_push
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...rotations import Array
from ...system.serialisation import Memory, plain
from ...system.speed_rows import speed_rows
from ...system.system import State, System
from ..consistent import jerk, spin_of_acceleration, worst_block
from ..control import check_controlled
from ..dae import GGL, Form, Index3
from ..dense_output import cubic, place_within, state_within
from ..newton import Newton, not_converged, strayed
from ..stepping import TimeStepper
from .alpha_step import PATIENCE, AlphaStep, Rule, StepStart

CLOSINGS, SHUT = (
    3,
    1e-12,
)  # iterations that close joints within a step; lengths of the model by which they may stay open


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Scheme data: ``rho_inf`` in [0, 1), 1 is no damping at high frequencies, 0 the most; ``form``: Index3() or GGL().

    rho_inf = 1 is refused: with index-3 constraints it is weakly unstable, roundoff in the multipliers grows until the run
    fails (Cardona and Geradin, doi:10.1016/0045-7949(89)90050-9).

    ``rtol``, ``atol``: error control, see :class:`.Radau`: the scheme chooses its steps (:mod:`.variable_alpha`); with
    rtol = None it takes steps of a given size.

    ``compiled`` = False keeps to NumPy where a compiled step exists (see :mod:`.alpha_driver`).
    """

    rho_inf: float = 0.8
    compiled: bool = True
    form: Form = field(default_factory=Index3)
    rtol: float | None = None
    atol: float | None = None

    def __post_init__(self) -> None:
        check_controlled(self)
        require(
            isinstance(self.form, Index3 | GGL),
            f"GeneralizedAlpha takes form=Index3() or GGL(), found {self.form!r}. BDF and Radau take all forms.",
        )
        require(
            0.0 <= self.rho_inf < 1.0 or (self.rho_inf == 1.0 and isinstance(self.form, GGL)),
            f"rho_inf = {self.rho_inf} is not usable: it must lie in [0, 1). At 1 the index-3 multipliers are weakly unstable "
            "and grow until the run fails; 0.9 damps little. form=GGL() permits 1.",
        )

    order = 2

    @property
    def carries_pressure(self) -> bool:
        """Whether bodies may have a pressure that is an unknown."""
        return isinstance(self.form, Index3)

    @property
    def turn_limit(self) -> float | None:
        """Angle (rad) by which constraints on positions may turn in a step: :mod:`~fmbd_fenicsx.run.judges.turning_rows`."""
        fixed = self.rtol is None and isinstance(self.form, Index3)
        return 0.7 * (1.0 - self.rho_inf) if fixed else None

    @property
    def name(self) -> str:
        """Name in reports."""
        stabilised = ", GGL" if isinstance(self.form, GGL) else ""
        controlled = f", rtol={self.rtol:g}" if self.rtol is not None else ""
        return f"generalized-alpha(rho_inf={self.rho_inf:g}{stabilised}{controlled})"

    @property
    def parameters(self) -> tuple[float, float, float, float]:
        """alpha_m, alpha_f, gamma, beta."""
        rho = self.rho_inf
        am = (2 * rho - 1) / (rho + 1)
        af = rho / (rho + 1)
        gamma = 0.5 + af - am
        return am, af, gamma, 0.25 * (gamma + 0.5) ** 2

    def rule(self, h: float) -> Rule:
        """The scheme for steps of size h (s)."""
        return Rule(h, *self.parameters)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Any:
        """Time stepper from a consistent state."""
        if self.rtol is not None:
            from .variable_alpha import VariableAlpha

            return VariableAlpha(self, system, solver, newton, state)

        return self.steps((self, system, solver, newton, state))

    def steps(self, given: Given, *, alone: bool = True) -> AlphaStepper:
        """Time stepper for constant steps. ``alone``: nobody else solves for the system between them, so that the tables of who
        evaluates it in compiled code may serve.
        """
        newton = given[3]
        made = self._compiled_stepper(given, alone) if self.compiled and newton.tangent is None else None
        return AlphaStepper(*given) if made is None else made

    def _compiled_stepper(self, given: Given, alone: bool) -> AlphaStepper | None:
        """Steps in compiled code; None where NumPy has to make them."""
        _, system, solver, _, _ = given
        redundant = solver.core.redundant

        if system.fields:
            # NumPy shares reactions among dependent rows to the last digits
            if redundant:
                return None
            from .alpha_driver import drivable
            from .field_stepper import FieldStepper

            return None if drivable(system) is None else FieldStepper(given, None)

        from .alpha_driver import alpha_driver
        from .compiled_stepper import CompiledAlphaStepper

        driver = alpha_driver(system, redundant=redundant, alone=alone)
        return None if driver is None else CompiledAlphaStepper(given, driver)


Given = tuple[GeneralizedAlpha, System, StepSolver, Newton, State]


def _keep_past(m: Memory, name: str, past: Any) -> list[tuple[float, Array, Array]]:
    """The past of the predictor: times, accelerations, multipliers."""
    return [(i("t", t), i.like_v("a", a), i("lam", lam)) for i, (t, a, lam) in m.each(name, past, 3)]


def _keep_counters(m: Memory, name: str, counters: Any) -> dict[str, float]:
    """Counts; a compiled step may be there on one rank only."""
    return {**counters, **m(name, counters)}


class AlphaStepper(TimeStepper):
    """Advances a consistent state; holds the algorithmic acceleration and the history of the predictor."""

    keeps: ClassVar = {
        "state": Memory.state,
        "A": Memory.like_v,
        "fresh": plain(),
        "local_error": plain(),
        "counters": _keep_counters,
        "_past": _keep_past,
        "slopes": plain(),
    }
    counters: dict[str, float] = {}
    slopes: Array | None = None  # of forces in Python, where steps go on with earlier ones

    def __init__(
        self, scheme: GeneralizedAlpha, system: System, solver: StepSolver, newton: Newton, state: State
    ) -> None:
        self.scheme, self.system, self.solver, self.newton = scheme, system, solver, newton
        self.counters = {}
        self._begin_from(state)

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past."""
        self.state = state
        self.A = state.a.copy()
        self.fresh = True  # the next step is the first after a consistent start
        self._past: list[tuple[float, Array, Array]] = []
        self._begun: tuple[State, Array, Array] | None = None  # state, v and A as the last step took them
        self.size = 0.0  # of the last step, s
        self.local_error = 0.0

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """As :meth:`TimeStepper.begin_anew`."""
        self._begin_from(start())
        return True

    def _predict(self, h: float) -> tuple[Array, Array]:
        """a and lambda extrapolated by the parabola through the last steps (less at the start)."""
        s = self.state
        t = s.t + h
        points = [(s.t, s.a, s.lam), *self._past]
        a, lam = np.zeros_like(s.a), np.zeros_like(s.lam)
        for i, (ti, ai, li) in enumerate(points):
            # Lagrange's weights of the newest three states
            w = float(np.prod([(t - tj) / (ti - tj) for j, (tj, _, _) in enumerate(points) if j != i]))
            a += w * ai
            lam += w * li
        return a, lam

    def _first(self, rule: Rule) -> StepStart:
        """v_0 and A_0 without a transient (see the module), and a, lambda predicted for the end of the first step."""
        system, s, h = self.system, self.state, rule.h
        ahead = rule.alpha_m - rule.alpha_f
        ev = self.system.at(s.t, s.q, s.v)
        rate, lam_rate, volume = jerk(ev, s, self.solver, rule.weights, h)

        v = s.v
        if (system.n_lam or volume) and not isinstance(self.scheme.form, GGL):
            c = rule.miss
            miss = h * h * (c * rate + spin_of_acceleration(system, s.v, s.a) / 12)
            push = volume_push(self.solver, {k: h * h * c * x for k, x in volume.items()})
            across = ev.jacobian.times(miss)
            across[speed_rows(system)] = 0.0  # rows on velocities are held there, not missed
            v = v + self.solver.solve(push, across)[0]
        return StepStart(s, v, s.a + ahead * h * rate, s.a + h * rate, s.lam + h * lam_rate)

    def _predicted(self, rule: Rule) -> StepStart:
        """What the next step begins with, and the prediction of its end."""
        if self.fresh:
            return self._first(rule)
        return StepStart(self.state, self.state.v, self.A, *self._predict(rule.h))

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then unchanged."""
        rule = self.scheme.rule(h)
        start = self._predicted(rule)
        pressures = self.solver.pressures
        try:
            return self._step(rule, start, PATIENCE)
        except (ConvergenceError, LinearSolveError):
            self.solver.pressures = pressures
            if self.system.fields:
                raise
        # once more with a tangent for each iteration, before the step is made in parts
        self.newton.theta = 0.5
        return self._step(rule, start, 0)  # stiff springs that turn need Newton's own tangent

    def controlled(self, h: float, steps: int, control: Any, watch: Any = None, tape: Any = None) -> int:
        """Up to so many steps under error control in one call of compiled code; none here."""
        return 0

    def _step(self, rule: Rule, start: StepStart, patience: int) -> State:
        """The step by Newton's iteration, its first ``patience`` iterations with one tangent."""
        stabilised = isinstance(self.scheme.form, GGL)
        step = AlphaStep(rule, start, self.solver, self.newton, patience=patience, stabilised=stabilised)
        try:
            converged, history = step.solve()
        finally:
            self._count(step)
        if not converged or (patience == 0 and strayed(self.system, step.end.xi, step.begun.xi)):
            raise self._failure(step, history)
        return self._accept(step)

    def _count(self, step: AlphaStep) -> None:
        """Iterations on the exact tangent, where one is taken."""
        if step.tangent is not None:
            self.counters["tangent_iterations"] = self.counters.get("tangent_iterations", 0.0) + step.tangent_iterations

    def _failure(self, step: AlphaStep, history: list[float]) -> ConvergenceError:
        """The error of a step whose iteration failed: where, and what to try."""
        where = f"; the largest open constraint is {worst_block(self.system, step.gaps)}" if step.gaps.size else ""
        tolerance = self.newton.tolerance
        damping = ", or a smaller rho_inf" if self.scheme.rho_inf > 0.8 else ""
        looser = f", or a larger Newton tolerance than {tolerance:g}" if tolerance < 1e-6 else ""
        return not_converged(step.t, step.rule.h, history, f"{where}. Try a smaller dt{damping}{looser}.")

    def _accept(self, step: AlphaStep) -> State:
        """The end of a step becomes the state."""
        s = self.state
        h = step.rule.h
        A = step.end.A
        self.local_error = h * h * abs(step.rule.beta - 1.0 / 6.0) * self.system.max_abs(A - step.start.A)
        # two earlier states and the newest one make the parabola of the predictor
        self._past = [(s.t, s.a, s.lam), *self._past][:2]
        self.A, self.fresh = A, False
        self._begun, self.size = (s, step.start.v, step.start.A), h

        found = step.found
        if step.lost:
            self.solver.note_lost_gaps(self.system.at(found.t, found.q))
        self.state = replace(found, lam=self._reactions(found.t, found.q, found.lam))
        return self.state

    @property
    def begun(self) -> tuple[State, Array, Array] | None:
        """The state that the last step began with, v and A as it took them; None before the first one."""
        return self._begun

    @property
    def miss(self) -> Array:
        """By how much velocities exceed the derivatives of places in the last step, (n_v,); none in the stabilised form."""
        assert self.begun is not None
        before, v, A = self.begun
        if isinstance(self.scheme.form, GGL):
            return np.zeros_like(v)
        rule = self.scheme.rule(self.state.t - before.t)
        turning = spin_of_acceleration(self.system, v, before.a)
        return rule.h * rule.miss * (self.A - A) + rule.h**2 / 12 * turning

    def error(self, h: float) -> Array:
        """The error of the last step, of size h (s), as :mod:`.variable_alpha` defines it, (n_v,); collective."""
        s, scale, jump, span = self._of_error(h)
        ev = self.system.at(s.t, s.q, s.v)
        # M times the jump of accelerations: times h^2, it would be lost beside those of short steps
        change = ev.balance(s.a + jump, s.lam) - ev.balance(s.a, s.lam)
        self.solver.prepare(ev, self.scheme.rule(h).weights)

        free = ev.jacobian.times(scale * jump)
        across = span * ev.opening() if span else free
        held = speed_rows(self.system)  # rows on velocities hold no places
        across[held] = free[held]
        return self.solver.solve(scale * change, across)[0]

    def _of_error(self, h: float) -> tuple[State, float, Array, float]:
        """The newest state, h^2 (beta - 1/6), the jump of A, and how long velocities open constraints (s), 0 where they hold."""
        assert self.begun is not None
        scale = h * h * (self.scheme.parameters[3] - 1.0 / 6.0)
        return self.state, scale, self.A - self.begun[2], 0.0 if isinstance(self.scheme.form, GGL) else 0.5 * h

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step: q, v by cubics with the slopes of (1) to (3), a and lambda by straight
        lines; q closes its constraints.
        """
        if self.begun is None or t < self.begun[0].t:
            return None
        (before, v, A), after = self.begun, self.state
        rule, jump = self.scheme.rule(after.t - before.t), self.A - A
        h, ahead, miss = rule.h, rule.alpha_m - rule.alpha_f, self.miss
        q = place_within(self.system, before, after, t, (v - miss, after.v - miss))

        # A is that of a time t + ahead h
        slopes = A - ahead * jump, self.A - ahead * jump
        v = cubic((t - before.t) / h, h, (v, after.v), slopes)
        return replace(state_within(before, after, t, self._shut(t, q, v)), v=v)

    def _shut(self, t: float, q: Array, v: Array) -> Array:
        """A configuration within the last step, joints closed by the least motion for the matrix of that step; collective.

        What drives prescribe is not the cubic through the ends of a step: a crank was off by ten times the error of its ends.
        """
        system = self.system
        for _ in range(CLOSINGS if system.n_lam else 0):
            ev = system.at(t, q, v)
            gap = ev.constraint()
            gap[speed_rows(system)] = 0.0  # rows on velocities hold no places
            if np.abs(system.row_units * gap).max() <= SHUT * system.length:
                break
            self.solver.prepare(ev, self.scheme.rule(self.size).weights)
            q = system.compose(q, self.solver.solve(np.zeros_like(v), -gap)[0])
        return q

    def _reactions(self, t: float, q: Array, lam: Array) -> Array:
        """Multipliers of a configuration; of those with the same forces the smallest."""
        if not self.solver.core.redundant:
            return lam
        return least(self.solver, self.system.at(t, q), lam)
