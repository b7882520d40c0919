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

The stabilised form, ``form=GGL()``, demands both levels: G v + g_t = 0 at t_n+1 goes with lambda, and (1) gains a correction
-M^-1 G^T mu that closes g = 0. Velocities are then exact on their level, the start needs A_0 only, and rho_inf = 1 stays stable.
One iteration costs a second solve with the same factor.

Sources: Chung and Hulbert, doi:10.1115/1.2900803; Bruels, Cardona and Arnold, doi:10.1016/j.mechmachtheory.2011.07.017;
Arnold and Bruels, doi:10.1007/s11044-007-9084-0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from ...errors import ConvergenceError, LinearSolveError, require
from ...linear.blocks.incompressibility import volume_push
from ...linear.condensation import StepSolver, Weights
from ...linear.redundancy import least
from ...rotations import Array
from ...system.serialisation import Memory, plain
from ...system.speed_rows import gaps, speed_rows
from ...system.system import State, System
from ..consistent import jerk, spin_of_acceleration, worst_block
from ..control import check_controlled
from ..dae import GGL, Form, Index3
from ..exact_tangent import exact_increment
from ..newton import Newton, above_roundoff, known_gaps, not_converged, strayed
from ..stepping import TimeStepper

# of the model's length: after a larger increment, rows and the core's matrix are taken where it led
FAR = 1e-4
# rate above which force elements get a new tangent: a stiff spring has its true tension, and with it its
# stiffness across, only after the first increment
SLOW_TURN = 0.01
SLOW = 0.1  # rate above which gaps of roundoff may be what keeps increments from falling
PATIENCE = 4  # iterations with the tangent of the first one, where a new tangent is cheap


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
        """Angle (rad) by which constraints on positions may turn in a step: :mod:`~fmbd_fenicsx.run.turning_rows`."""
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
        am, af = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        gamma = 0.5 + af - am
        return am, af, gamma, 0.25 * (gamma + 0.5) ** 2

    def prepare(self, solver: StepSolver) -> None:
        """Let the driver make the start where it makes the steps."""
        system = solver.system
        if self.rtol is not None or not self.compiled or system.fields:
            return
        from ...linear.driver_solver import DriverSolver
        from ...system.compiled.evaluation import driver_states

        states = driver_states(system)
        solver.driver = None if states is None else DriverSolver(states)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Any:
        """Time stepper from a consistent state."""
        if self.rtol is not None:
            from .variable_alpha import VariableAlpha

            return VariableAlpha(self, system, solver, newton, state)
        compiled = self.compiled and newton.tangent is None
        plain = compiled and isinstance(self.form, Index3)
        rolls = speed_rows(system).size > 0
        if system.fields:
            if plain and not solver.core.redundant:  # NumPy shares reactions among dependent rows to the last digits
                from .alpha_driver import drivable
                from .field_stepper import FieldStepper

                if drivable(system) is not None:
                    return FieldStepper((self, system, solver, newton, state), None)
        elif plain or (compiled and not solver.core.redundant and not rolls):
            from .alpha_driver import alpha_driver
            from .compiled_stepper import CompiledStepper

            states = None if solver.driver is None else solver.driver.states
            driver = alpha_driver(system, redundant=solver.core.redundant, states=states)
            if driver is not None:
                return CompiledStepper((self, system, solver, newton, state), driver)
        return Stepper(self, system, solver, newton, state)


def _keep_past(m: Memory, name: str, past: Any) -> list[tuple[float, Array, Array]]:
    """The past of the predictor: times, accelerations, multipliers."""
    return [(i("t", t), i.like_v("a", a), i("lam", lam)) for i, (t, a, lam) in m.each(name, past, 3)]


def _keep_counters(m: Memory, name: str, counters: Any) -> dict[str, float]:
    """Counts; a compiled step may be there on one rank only."""
    return {**counters, **m(name, counters)}


class Stepper(TimeStepper):
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
        self.state = state
        self.A = state.a.copy()
        self.fresh = True  # the next step is the first after a consistent start
        self._past: list[tuple[float, Array, Array]] = []
        self.local_error = 0.0
        self.counters = {}

    def _predict(self, h: float) -> tuple[Array, Array]:
        """a and lambda extrapolated by the parabola through the last steps (less at the start)."""
        s = self.state
        t = s.t + h
        points = [(s.t, s.a, s.lam), *self._past]
        a, lam = np.zeros_like(s.a), np.zeros_like(s.lam)
        for i, (ti, ai, li) in enumerate(points):
            w = float(np.prod([(t - tj) / (ti - tj) for j, (tj, _, _) in enumerate(points) if j != i]))
            a += w * ai
            lam += w * li
        return a, lam

    def _first(self, h: float, weights: Weights) -> tuple[Array, Array, Array, Array]:
        """v_0 and A_0 without a transient (see the module), and a, lambda predicted for the end of the first step."""
        system, s = self.system, self.state
        am, af, _, beta = self.scheme.parameters
        ev = self.solver.at(s.t, s.q, s.v)
        rate, lam_rate, volume = jerk(ev, s, self.solver, weights, h)
        v = s.v
        if (system.n_lam or volume) and not isinstance(self.scheme.form, GGL):
            c = 1 / 6 - beta - 0.5 * (am - af)
            miss = h * h * (c * rate + spin_of_acceleration(system, s.v, s.a) / 12)
            push = volume_push(self.solver, {k: h * h * c * x for k, x in volume.items()})
            across = ev.jacobian.times(miss)
            across[speed_rows(system)] = 0.0  # rows on velocities are held there, not missed
            v = v + self.solver.solve(push, across)[0]
        return v, s.a + (am - af) * h * rate, s.a + h * rate, s.lam + h * lam_rate

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then unchanged."""
        weights, motion = self._predicted(h)
        pressures = self.solver.pressures
        try:
            return self._newton(h, weights, motion, PATIENCE)
        except (ConvergenceError, LinearSolveError):
            self.solver.pressures = pressures
            if self.system.fields:
                raise
        self.newton.theta = 0.5
        return self._newton(h, weights, motion, 0)  # stiff springs that turn need Newton's own tangent

    def _predicted(self, h: float) -> tuple[Weights, tuple[Array, Array, Array, Array]]:
        """Weights of the step's matrix; v and A at its start, a and lambda predicted for its end."""
        weights = self._weights(h)
        if self.fresh:
            return weights, self._first(h, weights)
        return weights, (self.state.v, self.A, *self._predict(h))

    def _weights(self, h: float) -> Weights:
        """Weights of the matrix of a step of size h (s)."""
        am, af, gamma, beta = self.scheme.parameters
        share = (1 - af) / (1 - am)
        return Weights(1.0, h * gamma * share, beta * h * h * share)

    def _newton(self, h: float, weights: Weights, motion: tuple[Array, Array, Array, Array], patience: int) -> State:
        """The step by Newton's iteration, its first ``patience`` iterations with one tangent."""
        system, s = self.system, self.state
        am, af, gamma, beta = self.scheme.parameters
        v0, A0, a, lam = motion
        t, scale = s.t + h, weights.ck  # dq = scale da
        share = h * beta / gamma  # dq = share dv
        fixed_a, fixed_v = h * v0 + h * h * (0.5 - beta) * A0, v0 + h * (1 - gamma) * A0

        A = ((1 - af) * a + af * s.a - am * A0) / (1 - am)
        xi = fixed_a + h * h * beta * A
        tolerance = self._tolerance(scale, a)
        done, far, lost = 0, True, False
        stiff = any(loads.stiff for loads in system.forces)
        last: Array = np.zeros(0)
        newest: Array | None = None
        stabilised = bool(system.n_lam) and isinstance(self.scheme.form, GGL)

        tangent = None if stabilised else self.newton.tangent

        def moved(d: Array) -> tuple[Array, Array]:
            d = system.rate(xi, d)
            ev = system.at(t, system.compose(s.q, xi + d), fixed_v + h * gamma * (A + d / (h * h * beta)))
            return scale * ev.balance(a + d / scale, lam), gaps(ev, share)

        def increment() -> float:
            nonlocal a, lam, A, xi, done, last, far, lost, newest
            q = system.compose(s.q, xi)
            v = fixed_v + h * gamma * A
            ev = system.at(t, q, v)
            g = gaps(ev, share)
            if done > 2 and self.newton.theta > SLOW:
                g, all_of_them = known_gaps(ev, g), g
                lost = lost or bool((g != all_of_them).any())
            r = ev.balance(a, lam)
            turning = stiff and done > 0 and (done == 1 or self.newton.theta > SLOW_TURN)
            new = far or tangent is not None or turning or (done > patience and not system.fields)
            self.solver.prepare(ev, weights, keep=not new)
            done += 1
            if stabilised:
                slip = ev.opening()
                dq, dlam = self.solver.solve(-scale * r, -scale / weights.cd * slip)
                open_after = -g - ev.jacobian.times(dq)
                open_after[speed_rows(system)] = 0.0  # these have no g: the correction rolls
                closing, _ = self.solver.solve(np.zeros_like(dq), open_after)
                xi = xi + system.rate(xi, closing)
            elif tangent is not None:
                dq, dlam, count = exact_increment(tangent, system, self.solver.solve, moved, (-scale * r, -g))
                closing = np.zeros_like(dq)
                self.counters["tangent_iterations"] = self.counters.get("tangent_iterations", 0.0) + count
            else:
                dq, dlam = self.solver.step(-scale * r, -g)
                closing = np.zeros_like(dq)
            lam = lam + dlam / scale
            d_xi = system.rate(xi, dq)
            xi = xi + d_xi
            A = A + d_xi / (h * h * beta)
            a = a + d_xi / scale
            last, newest = g, dq
            size = max(system.max_abs(dq), system.max_abs(closing))
            far = size > FAR * system.length
            if done > 2 and size > tolerance and not stabilised:
                size = system.max_abs(dq * above_roundoff(ev, lam - dlam / scale, r, g))
            return size / tolerance

        def look() -> None:
            ev = system.at(t, system.compose(s.q, xi), fixed_v + h * gamma * A)
            ev.balance(a, lam)
            self.solver.prepare(ev, weights, keep=True)
            self.solver.increment = newest

        begun, foretells = xi, any(part.foretells for _, part in system.fields)
        converged, history = self.newton.solve(increment, look if foretells else None)
        if not converged or (patience == 0 and strayed(system, xi, begun)):
            where = f"; the largest open constraint is {worst_block(system, last)}" if last.size else ""
            damping = ", or a smaller rho_inf" if self.scheme.rho_inf > 0.8 else ""
            looser = (
                f", or a larger Newton tolerance than {self.newton.tolerance:g}" if self.newton.tolerance < 1e-6 else ""
            )
            raise not_converged(t, h, history, f"{where}. Try a smaller dt{damping}{looser}.")
        self.local_error = h * h * abs(beta - 1.0 / 6.0) * system.max_abs(A - A0)
        self._past = [(s.t, s.a, s.lam), *self._past][:2]
        self.A, self.fresh = A, False
        q, v = system.compose(s.q, xi), fixed_v + h * gamma * A
        if lost:
            self.solver.note_lost_gaps(system.at(t, q))
        self.state = State(t, q, v, a, self._reactions(t, q, lam))
        return self.state

    def _reactions(self, t: float, q: Array, lam: Array) -> Array:
        """Multipliers of a configuration; of those with the same forces the smallest."""
        if not self.solver.core.redundant:
            return lam
        return least(self.solver, self.system.at(t, q), lam)

    def _tolerance(self, scale: float, a: Array) -> float:
        """Size of a position increment that changes accelerations by Newton's relative tolerance, above roundoff."""
        s = self.system
        floor = 64 * np.finfo(float).eps * s.length
        return max(self.newton.tolerance * scale * s.typical(a), floor)
