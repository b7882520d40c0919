"""Steps of generalized-alpha: predictor, first step, acceptance, error, states within a step. Equations are those of
:mod:`.generalized_alpha`.

The smooth solution of (1)..(3) along a constrained motion has A_n = a(t_n + (alpha_m - alpha_f) h) and velocities that miss
the velocity constraints by h^2 G (c v'' + v x v' / 12) with c = 1/6 - beta - (alpha_m - alpha_f) / 2 (the product acts on
rotations in space). Starting with exact values instead excites a transient that leaves q and v of second order but makes
lambda of first order until rho^n is small. The first step therefore starts from A_0 = a_0 + (alpha_m - alpha_f) h a'_0 and
from v_0 + dv with M dv + G^T mu = 0 and G dv equal to that expression (Arnold, Bruels and Cardona,
doi:10.1007/s00211-014-0633-1). The recorded state at the start stays exact.

By the same amount c h^2 v'' + h^2 v x v' / 12, in all directions, velocities differ from the derivatives of the places that (1)
gives: the values within a step are those of the cubic with slopes that are less by it, with v'' = (A_n+1 - A_n) / h, and joints
are then closed by the least motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ....errors import ConvergenceError, LinearSolveError
from ....linear.blocks.incompressibility import volume_push
from ....linear.condensation import StepSolver
from ....linear.redundancy import least
from ....polynomials import lagrange
from ....rotations import Array
from ....system.compiled.declarations import constants
from ....system.impossible_shapes import over_barrier
from ....system.layout import State, States
from ....system.serialisation import Memory, plain
from ....system.speed_rows import speed_rows
from ....system.system import System
from ...consistent import widest
from ...dae import GGL
from ...dense_output import cubic, place_within, state_within
from ...newton import Newton, crushed, grew, not_converged, strayed
from ...stepping import Observers, TimeStepper
from .alpha_step import PATIENCE, AlphaStep, Rule, StepStart
from .damped_start import LEAST, LEFT, LEFT_BEHIND, MOST, damped_acceleration, eased, on_constraints, stages
from .jerk import jerk, spin_of_acceleration
from .stretch import SAME

if TYPE_CHECKING:
    from ....linear.blocks.field_blocks import Weights
    from .generalized_alpha import GeneralizedAlpha

(LEAP,) = constants("onestep/alpha.c", "LEAP")  # of the length of the model
CLOSINGS = 3  # iterations that close joints within a step
SHUT = 1e-12  # lengths of the model by which they may stay open


def _keep_counters(m: Memory, name: str, counters: Any) -> dict[str, float]:
    """Counts; a compiled step may be there on one rank only."""
    return {**counters, **m(name, counters)}


def _led(points: list[tuple[float, Array, Array]], t: float) -> tuple[Array, Array]:
    """a and lambda at t by the polynomial through those of states."""
    weights = lagrange(np.array([p[0] for p in points]), t)
    a, lam = (sum(w * p[k] for w, p in zip(weights, points, strict=True)) for k in (1, 2))
    return a, lam


def _leaps(points: list[tuple[float, Array, Array]], much: Array) -> Array:
    """Whether the newest a is farther from where the others lead than they are large, by more than ``much``, each entry: steps do
    not resolve such motion, and where all lead is far off.
    """
    newest, *others = points
    miss = newest[1] - _led(others, newest[0])[0]
    return np.abs(miss) > np.maximum(np.abs([a for _, a, _ in points]).max(axis=0), much)


class AlphaStepper(TimeStepper):
    """Advances a consistent state; holds the algorithmic acceleration and the history of the predictor."""

    keeps: ClassVar = {
        "state": Memory.state,
        "A": Memory.like_v,
        "fresh": plain(),
        "damped": plain(),
        "local_error": plain(),
        "counters": _keep_counters,
        "_past": Memory.past,
        "slopes": plain(),
    }
    counters: dict[str, float] = {}
    slopes: Array | None = None  # of forces in Python, where steps go on with earlier ones
    damps = True  # starts that steps do not resolve, where anything pushes by itself

    def __init__(
        self, scheme: GeneralizedAlpha, system: System, solver: StepSolver, newton: Newton, state: State
    ) -> None:
        self.scheme, self.system, self.solver, self.newton = scheme, system, solver, newton
        self.stabilised = isinstance(scheme.form, GGL)  # velocities are rows, too
        self.counters = {}
        pushes = system.parts or system.elements or system.forces
        if not pushes:
            self.damps = False
        self._begin_from(state)

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past."""
        self.state = state
        self.A = state.a.copy()
        self.fresh = True  # the next step is the first after a consistent start
        self.damped = 0  # steps that have damped it
        self._looked: tuple[float, State, Array | None] | None = None  # at a start for steps of a size (s)
        self._past: list[tuple[float, Array, Array]] = []
        self._begun: tuple[State, Array, Array] | None = None  # state, v and A as the last step took them
        self.size = 0.0  # of the last step, s
        self.local_error = 0.0

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """As :meth:`TimeStepper.begin_anew`."""
        self._begin_from(start())
        return True

    def go_on_from(self, state: State, A: Array | None = None) -> None:
        """Take a state, and an algorithmic acceleration, in the place of its own; the past stays."""
        A = self.A if A is None else A
        past = self._past
        self.state, self.A, self._past = state, A, past

    @property
    def held(self) -> tuple[State, Array, list[tuple[float, Array, Array]], bool]:
        """What the next step begins with, to be kept and put back."""
        return self.state, self.A.copy(), list(self._past), self.fresh

    @held.setter
    def held(self, kept: tuple[State, Array, list[tuple[float, Array, Array]], bool]) -> None:
        self.state, self.A, self._past, self.fresh = kept

    def _predict(self, rule: Rule, *, evens: bool = True) -> tuple[Array, Array]:
        """a and lambda by the parabola through the last steps (less at the start); where a of bodies with an energy leaps, places
        go on with v.
        """
        s = self.state
        points = [(s.t, s.a, s.lam), *self._past]
        a, lam = _led(points, s.t + rule.h)
        if evens and self._past and any(part.foretells for _, part in self.system.fields):
            much = LEAP * self.system.length / (rule.weights.ck * self.system.units)
            much[: self.system.slices[1][0].start] = np.inf  # frames
            a = np.where(_leaps(points, much), rule.even(s.a, self.A), a)
        return a, lam

    def _first(self, rule: Rule) -> StepStart:
        """v_0 and A_0 without a transient (see the module), and a, lambda predicted for the end of the first step."""
        system, s, h = self.system, self.state, rule.h
        ahead = rule.alpha_m - rule.alpha_f
        ev = self.system.at(s.t, s.q, s.v)
        s = eased(ev, s, self.solver, rule) if system.fields else s
        rate, lam_rate, volume = jerk(ev, s, self.solver, rule.weights, h)
        if self.damped:
            self.solver.elastic.keep(1)  # the matrix of the steps that come

        v = s.v
        if (system.n_lam or volume) and not self.stabilised:
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
        return StepStart(self.state, self.state.v, self.A, *self._predict(rule))

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when Newton fails; the state is then unchanged."""
        rule = self.scheme.rule(h)
        if self.damps and (damped := self._damped(rule)) is not None:
            return self._damp(h, damped)
        start = self._predicted(rule)
        pressures = self.solver.pressures
        for begun in self._beginnings(rule, start):
            try:
                return self._step(rule, begun, PATIENCE)
            except (ConvergenceError, LinearSolveError) as error:
                self.solver.pressures, failed = pressures, error
        if self.system.fields:
            raise failed
        # once more with a tangent for each iteration, before the step is made in parts
        self.newton.theta = 0.5
        return self._step(rule, start, 0)  # stiff springs that turn need Newton's own tangent

    def _beginnings(self, rule: Rule, start: StepStart) -> Iterator[StepStart]:
        """What a step may begin with, the next where it has failed with one; collective."""
        yield start
        if not self.fresh and self.system.fields:
            plain = replace(start, a=self._predict(rule, evens=False)[0])
            if self.system.max_abs(plain.a - start.a) > 0.0:
                yield plain  # leaps may be where a body snaps through
        if not self.newton.account.otherwise and any(part.begins_anew for _, part in self.system.fields):
            self.newton.account.failed()
            yield start

    def _damped(self, rule: Rule) -> Array | None:
        """Accelerations that a step which damps begins with, where this is a start for one; else None. Collective."""
        if not self.fresh:
            return None
        if 0 < self.damped < LEAST:
            return self.state.a
        return self._look(rule) if self.damped < MOST else None

    def _look(self, rule: Rule) -> Array | None:
        """What a step leaves of the acceleration that it begins with, where this is an unresolved start; else None."""
        s, known = self.state, self._looked
        if known is None or known[0] != rule.h or known[1] is not s:
            ev, nothing = self.system.at(s.t, s.q, s.v), self.newton.small(self.system, np.inf)
            left = LEFT_BEHIND if self.damped else LEFT
            self._looked = known = rule.h, s, damped_acceleration(ev, s, self.solver, rule, nothing, left)
        return known[2]

    def _damp(self, h: float, a: Array) -> State:
        """A step of size h (s) of :mod:`.damped_start`, with accelerations predicted; the next one is a first step again."""
        s, count = self.state, self.damped + 1
        begin, end = stages(h)
        self.solver.elastic.keep(2)  # looks take the matrix of usual steps
        stage = self._solved(begin, StepStart(s, s.v, np.zeros_like(a), a, s.lam), PATIENCE, stabilised=True).end
        step = self._solved(end, StepStart(s, s.v, stage.A, stage.a, stage.lam), PATIENCE, stabilised=True)
        found = on_constraints(step.found, self.solver, end)
        self._begin_from(replace(found, lam=least(self.solver, found.t, found.q, found.lam)))
        self.damped, self.local_error = count, self._indicator(step)
        self.counters["damped_steps"] = self.counters.get("damped_steps", 0.0) + 1.0
        return self.state

    @property
    def is_driven(self) -> bool:
        """Whether compiled code may make the next step by :meth:`controlled`."""
        return False

    def controlled(self, h: float, steps: int, control: Any, observers: Observers) -> int:
        """Up to so many steps under error control in one call of compiled code; none here."""
        return 0

    def _step(self, rule: Rule, start: StepStart, patience: int) -> State:
        """The step by Newton's iteration, accepted."""
        return self._accept(self._solved(rule, start, patience, stabilised=self.stabilised))

    def _solved(self, rule: Rule, start: StepStart, patience: int, *, stabilised: bool) -> AlphaStep:
        """The step by Newton's iteration, its first ``patience`` iterations with one tangent."""
        step = AlphaStep(rule, start, self.solver, self.newton, patience=patience, stabilised=stabilised)
        try:
            converged, history = step.solve()
        finally:
            self._count(step)
        if not converged or (patience == 0 and strayed(self.system, step.end.xi, step.begun.xi)):
            raise self._failure(step, history)
        if grew(history):
            self._stays(start.state, step.t, step.found.q)
        return step

    def _stays(self, before: State, t: float, q: Array) -> None:
        """Raise ConvergenceError where the end of a step, at t (s), lies over an energy barrier; collective."""
        if body := over_barrier(self.system, before, q):
            raise crushed(t, t - before.t, body)

    def _count(self, step: AlphaStep) -> None:
        """Iterations on the exact tangent, where one is taken."""
        if step.tangent is not None:
            self.counters["tangent_iterations"] = self.counters.get("tangent_iterations", 0.0) + step.tangent_iterations

    def _failure(self, step: AlphaStep, history: list[float]) -> ConvergenceError:
        """The error of a step whose iteration failed: where, and what to try."""
        where = widest(self.system, step.gaps)
        tolerance = self.newton.tolerance
        damping = ", or a smaller rho_inf" if self.scheme.rho_inf > 0.8 else ""
        looser = f", or a larger Newton tolerance than {tolerance:g}" if tolerance < 1e-6 else ""
        return not_converged(step.t, step.rule.h, history, f"{where}. Try a smaller dt{damping}{looser}.")

    def _accept(self, step: AlphaStep) -> State:
        """The end of a step becomes the state."""
        s = step.start.state
        h = step.rule.h
        A = step.end.A
        self.local_error = self._indicator(step)
        # two earlier states and the newest one make the parabola of the predictor
        self._past = [(s.t, s.a, s.lam), *self._past][:2]
        self.A, self.fresh = A, False
        self._begun, self.size = (s, step.start.v, step.start.A), h

        found = step.found
        if step.lost:
            self.solver.note_lost_gaps(self.system.at(found.t, found.q))
        self.state = replace(found, lam=least(self.solver, found.t, found.q, found.lam))
        return self.state

    def _indicator(self, step: AlphaStep) -> float:
        """The error of the places at the end of a step (m), by how much A has changed."""
        rule, jump = step.rule, step.end.A - step.start.A
        return rule.h * rule.h * abs(rule.beta - 1.0 / 6.0) * self.system.max_abs(jump)

    @property
    def begun(self) -> tuple[State, Array, Array] | None:
        """The state that the last step began with, v and A as it took them; None before the first one."""
        return self._begun

    def error(self, h: float, weights: Weights | None = None) -> Array:
        """The error of the last step, of size h (s), as :mod:`.variable_alpha` defines it, (n_v,), filtered by the matrix of the
        step or by that of other weights; collective.
        """
        s, scale, jump, span = self._of_error(h)
        ev = self.system.at(s.t, s.q, s.v)
        # M times the jump of accelerations: times h^2, it would be lost beside those of short steps
        change = ev.balance(s.a + jump, s.lam) - ev.balance(s.a, s.lam)
        self.solver.prepare(ev, weights or self.scheme.rule(h).weights)

        free = ev.jacobian.times(scale * jump)
        across = span * ev.opening() if span else free
        held = speed_rows(self.system)  # rows on velocities hold no places
        across[held] = free[held]
        return self.solver.solve(scale * change, across)[0]

    def unfiltered(self, h: float) -> Array:
        """The error of the places of the last step, of size h (s), without a filter, (n_v,)."""
        _, scale, jump, _ = self._of_error(h)
        return scale * jump

    def missed_speeds(self, h: float) -> Array | None:
        """What the last step, of size h (s), misses of velocities by (3) of :mod:`.variable_alpha`, not filtered, (n_v,); None
        where no two states lead to its end.
        """
        past, s = self._past, self.state
        if len(past) < 2:
            return None
        return h * h / (6.0 * (s.t - past[1][0])) * (s.a - _led(past, s.t)[0])

    def filtered(self, h: float, missed: Array, s: State) -> Array:
        """Velocities without vibrations that a step of size h (s) damps by what is stiff at a state, (n_v,); collective."""
        ev = self.system.at(s.t, s.q, s.v)
        scale = self.system.max_abs(missed)
        change = ev.balance(s.a + missed / scale, s.lam) - ev.balance(s.a, s.lam)
        self.solver.prepare(ev, self.scheme.rule(h).weights)
        return self.solver.solve(scale * change, ev.jacobian.times(missed))[0]

    def _of_error(self, h: float) -> tuple[State, float, Array, float]:
        """The newest state, h^2 (beta - 1/6), the jump of A, and how long velocities open constraints (s), 0 where they hold."""
        assert self.begun is not None
        scale = h * h * (self.scheme.parameters[3] - 1.0 / 6.0)
        return self.state, scale, self.A - self.begun[2], 0.0 if self.stabilised else 0.5 * h

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step; None before the first one."""
        if self.begun is None or t < self.begun[0].t:
            return None
        before, v, A = self.begun
        ends = States.of([replace(before, v=v)]), States.of([self.state])
        found = self._cubics(*ends, np.array([[t]]), (A[None], self.A[None]))
        return replace(found, q=self._all_shut(found, self._weights_of(*ends))).state(0)

    def _weights_of(self, before: States, after: States) -> list[Weights]:
        """Those of the matrices of steps; of times that are the same but for roundoff those of the newest step."""
        return [
            self.scheme.rule(self.size if abs(h - self.size) <= SAME * self.size else h).weights
            for h in np.ravel(after.t - before.t).tolist()
        ]

    def _cubics(self, before: States, after: States, t: Array, A: tuple[Array, Array]) -> States:
        """The states at times t (k, 1) s within steps: q, v by cubics with the slopes of (1) to (3), a and lambda by straight
        lines; q may leave constraints open. ``A``: at the beginnings and ends.
        """
        h, jump, system = after.t - before.t, A[1] - A[0], self.system
        rule = self.scheme.rule(1.0)

        # by how much velocities exceed the derivatives of places; not in the stabilised form
        miss = np.zeros_like(jump)
        if not self.stabilised:
            miss = h * h * (rule.miss * jump / h + spin_of_acceleration(system, before.v, before.a) / 12)
        q = place_within(system, before, after, t, (before.v - miss, after.v - miss))

        # A is that of a time t + ahead h
        ahead = (rule.alpha_m - rule.alpha_f) * jump
        v = cubic((t - before.t) / h, h, (before.v, after.v), (A[0] - ahead, A[1] - ahead))
        return replace(state_within(before, after, t, q), v=v)

    def _all_shut(self, states: States, weights: list[Weights]) -> Array:
        """Configurations within steps, (k, n_q), joints closed by the least motion for the matrices of the steps; collective.

        What drives prescribe is not the cubic through the ends of a step: a crank was off by ten times the error of its ends.
        """
        system, found = self.system, []
        for s, own in zip(states.each(), weights, strict=True) if system.n_lam else ():
            q = s.q
            for _ in range(CLOSINGS):
                ev = system.at(s.t, q, s.v)
                gap = ev.constraint()
                gap[speed_rows(system)] = 0.0  # rows on velocities hold no places
                if np.abs(system.row_units * gap).max() <= SHUT * system.length:
                    break
                self.solver.prepare(ev, own)
                q = system.compose(q, self.solver.solve(np.zeros_like(s.v), -gap)[0])
            found.append(q)
        return np.array(found) if found else states.q
