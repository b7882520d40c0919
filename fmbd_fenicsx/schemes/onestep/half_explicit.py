"""A half-explicit Runge-Kutta method of order four for the velocity form: five stages, no iteration on forces; non-stiff motion.

    xi_i = h sum_j a_ij rate(xi_j, v_j),     v_i = v_n + h sum_j a_ij a_j                                           (1)
    M a_j + f(q_j, v_j) + G_j^T lambda_j = 0,     G_j+1 v_j+1 + g_t = 0                                             (2)

Each stage is linear in (a_j, lambda_j): the multiplier of stage j is what makes the next stage's velocity (for the last
stage, the new velocity) satisfy the constraints. Positions are closed by a projection in the mass metric at the end of the
step. An embedded formula that meets the conditions of order three, freed of its share across the constraints, gives the error
estimate; it falls like h^3 or faster. Orders of q and v: 4; the recorded a and lambda solve the
accelerations at the new state and have the same order.

Sources: Brasey and Hairer, doi:10.1137/0730025 (half-explicit methods, the coefficients HEM4); Hairer and Wanner, Solving
ODEs II, section VII.6, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from ...checks import check_fields
from ...errors import BalanceError, CallbackError, ConvergenceError, LawError, LinearSolveError
from ...linear.condensation import StepSolver, Weights
from ...rotations import Array
from ...system.serialisation import Memory, plain, worker
from ...system.system import State, System
from ..consistent import accelerations, project
from ..control import ErrorNorm, Statistics, StepControl, check_tolerance, first_step, lands, turn_limit, turns_too_far
from ..newton import Newton
from ..stepping import TimeStepper
from .explicit_limit import StepLimit

MASS = Weights(1.0, 0.0, 0.0)
MOVES_NOTHING = 1e-14  # of the model's length in a step


@lru_cache
def coefficients() -> tuple[Array, Array, Array]:
    """Nodes c (6,), rows a (6, 5) with the weights b last, and the embedded weights minus b, (5,)."""
    r = float(np.sqrt(6))
    c = np.array([0.0, 0.3, (4 - r) / 10, (4 + r) / 10, 1.0, 1.0])
    a = np.zeros((6, 5))
    a[1, 0] = 0.3
    a[2, :2] = (1 + r) / 30, (11 - 4 * r) / 30
    a[3, :3] = (-79 - 31 * r) / 150, (-1 - 4 * r) / 30, (24 + 11 * r) / 25
    a[4, :4] = (14 + 5 * r) / 6, (-8 + 7 * r) / 6, (-9 - 7 * r) / 4, (9 - r) / 4
    a[5] = 0.0, 0.0, (16 - r) / 36, (16 + r) / 36, 1 / 9
    # the embedded method: along the null vector of the order conditions
    conditions = np.array([np.ones(5), c[:5], c[:5] ** 2, a[:5] @ c[:5]])
    free = np.linalg.svd(conditions)[2][-1]  # leaves the conditions of order three untouched
    return c, a, 0.1 * free / np.abs(free).max()


def amplification(z: float, damping: float) -> Array:
    """The matrix of one step for x'' + c x' + w^2 x = 0, z = h w and damping = h c, over (x, h x'), (2, 2)."""
    return amplified(coefficients()[1], z, damping)


def amplified(A: Array, z: float, damping: float) -> Array:
    """The same of any explicit method with the rows A, (stages + 1, stages)."""
    x, v = np.eye(2)
    places, speeds, pushes = [x], [v], []
    for row in A[1:]:
        # x'' at the newest stage
        pushes.append(-(z * z * places[-1] + damping * speeds[-1]))
        known = row[: len(pushes)]
        places.append(x + known @ np.array(speeds))
        speeds.append(v + known @ np.array(pushes))
    return np.array([places[-1], speeds[-1]])


@dataclass(frozen=True)
class HalfExplicit:
    """Scheme data. ``rtol``: relative tolerance of the local error, None for constant steps; ``atol`` as in Radau.

    Constant steps that do not resolve the fastest vibration are refused.
    """

    rtol: float | None = 1e-6
    atol: float | None = None
    order = 4
    name = "half-explicit Runge-Kutta (4)"

    def __post_init__(self) -> None:
        check_fields(self)
        check_tolerance(self.rtol, self.atol, "HalfExplicit")

    holds = (0, 1)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Stepper:
        """A run's worker, from a consistent state."""
        return Stepper(self, system, solver, newton, state)


class Stepper(TimeStepper):
    """Advances a consistent state."""

    keeps: ClassVar = {
        "state": Memory.state,
        "control": plain(StepControl),
        "stats": plain(Statistics),
        "proposed": plain(),
        "local_error": plain(),
        "norm": worker,
    }

    def __init__(self, scheme: Any, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.scheme, self.system, self.solver, self.newton, self.state = scheme, system, solver, newton, state
        self.norm = ErrorNorm(system, scheme.rtol or newton.tolerance, scheme.atol, 1)
        self.control, self.stats = StepControl(float(scheme.order)), Statistics()
        self.proposed: float | None = None
        self.local_error = 0.0
        self.before: State | None = None  # at the start of the last step
        self.limit = StepLimit("The half-explicit scheme", system, solver, amplification)

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, for the counters of a run."""
        return self.stats.as_dict()

    def restart(self, t: float) -> None:
        """Accelerations and multipliers behind a kink at t."""
        self.state = accelerations(self.system, replace(self.state, t=t), self.solver)
        self.proposed, self.control.h_old, self.before = None, 0.0, None

    def advance(self, h: float) -> State:
        """One accepted step: of size h, or with error control of at most h (s); collective."""
        return self._accept(self._constant(h) if self.scheme.rtol is None else self._controlled(h))

    def _constant(self, h: float) -> State:
        """The state after a step of size h (s), before projection."""
        self.limit.look(self.state, h)
        try:
            return self._step(h)[0]
        except (CallbackError, LawError) as fault:
            if not isinstance(fault, BalanceError) and not self._has_forces(h):
                raise
            raise self.limit.blame(self.state, h, fault) from fault

    def _has_forces(self, h: float) -> bool:
        """Whether all laws have values, up to the end of a step of size h, where it begins: a step without has run away."""
        s = self.state
        try:
            for t in (s.t, s.t + h):
                self.system.at(t, s.q, s.v).balance(s.a, s.lam)
        except (CallbackError, LawError):
            return False
        return True

    def _controlled(self, limit: float) -> State:
        """The same after a step of at most ``limit`` (s) that passes the error test."""
        self.control.span = max(self.control.span, limit)
        if self.proposed is None:
            self.norm.update(self.state, limit)
            self.proposed = first_step(self.norm, self.state, self.control.order, limit)

        farthest = turn_limit(self.system, self.state)
        while True:
            h = lands(min(self.proposed, farthest), limit)
            made, error, cause = self._attempt(h)
            if made is not None and error <= 1.0:
                break
            self.stats.rejected[cause] += 1
            self.proposed = self.control.rejected(self.state.t, h, error, cause)

        # a step cut short by the end tells nothing of the next one
        new = self.control.accepted(h, error)
        self.proposed = new if h >= self.proposed or new < h else self.proposed
        self.local_error = error
        return made

    def _attempt(self, h: float) -> tuple[State | None, float, str]:
        """A step of size h: the state, if there is one, the error over the tolerance, and the cause of a rejection."""
        self.norm.update(self.state, h)
        try:
            made, errors = self._step(h)
            error = self._size(h, errors)
            moved = self.system.difference(self.state.q, made.q, near=h * made.v)
        except (ConvergenceError, LinearSolveError):
            return None, np.inf, "constraints not closed"
        except CallbackError as fault:
            self.control.fault = str(fault)
            return None, np.inf, "forces not finite"
        if turns_too_far(self.system, moved):
            return None, np.inf, "turns too far"
        return made, error, "error estimate"

    def _size(self, h: float, errors: tuple[Array, Array]) -> float:
        """What :meth:`_step` told of the errors of xi and v, over the tolerance."""
        return self.norm(h, *errors)

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, of the order of the scheme; None after a new start; collective.

        Positions are those of the polynomial of degree 4 through both ends with their velocities and the first acceleration, in
        the local coordinates of the step's start; velocities those of the cubic through both ends with their accelerations;
        accelerations and multipliers are solved for. Hairer, Norsett, Wanner, doi:10.1007/978-3-540-78862-1, II.6.
        """
        if self.before is None:
            return None
        system, a, b = self.system, self.before, self.state
        h = b.t - a.t
        x = (t - a.t) / h
        moved = system.difference(a.q, b.q)

        # what the parabola of the start leaves open at the end, in place and rate
        gap = moved - h * a.v - 0.5 * h * h * a.a
        turn = h * (system.rate(moved, b.v) - a.v - h * a.a)
        xi = x * h * a.v + 0.5 * (x * h) ** 2 * a.a + x**3 * ((4 - 3 * x) * gap + (x - 1) * turn)
        change = b.v - a.v
        first = h * a.a
        last = h * b.a
        v = a.v + x * x * (3 - 2 * x) * change + x * (1 - x) ** 2 * first - x * x * (1 - x) * last
        return accelerations(system, State(t, system.compose(a.q, xi), v, a.a, a.lam), self.solver)

    def _accept(self, made: State) -> State:
        self.before = self.state
        self.state = accelerations(self.system, project(self.system, made, self.solver), self.solver)
        self.stats.steps += 1
        return self.state

    def _step(self, h: float) -> tuple[State, tuple[Array, Array]]:
        """(1), (2): the new state before projection, and the errors of xi and v."""
        system, s = self.system, self.state
        c, A, difference = coefficients()
        xi = np.zeros_like(s.v)
        v = s.v
        lam = s.lam
        rates: list[Array] = []
        pushes: list[Array] = []
        a = s.a
        for i in range(5):
            rates.append(system.rate(xi, v))
            q = system.compose(s.q, xi)
            xi = h * (A[i + 1, : i + 1] @ np.array(rates))
            known = s.v + h * (A[i + 1, :i] @ np.array(pushes)) if i else s.v
            end = system.compose(s.q, xi)
            a, lam = self._stage(s.t + h * c[i : i + 2], (q, v, end, known), h * A[i + 1, i], (a, lam))
            pushes.append(a)
            v = known + h * A[i + 1, i] * a
        # stage multipliers are of low order: their share of the difference lies across the constraints and is projected out
        errors = h * (difference @ np.array(rates)), h * (difference @ np.array(pushes))
        if system.n_lam and self.scheme.rtol is not None:
            after = system.at(s.t + c[5] * h, end, known)
            self.solver.prepare(after, MASS)
            zero = np.zeros_like(v)
            e_q, e_v = (e + self.solver.solve(zero, -after.jacobian.times(e))[0] for e in errors)
            errors = e_q, e_v
        return State(s.t + h, system.compose(s.q, xi), v, a, lam), errors

    def _stage(
        self, times: Array, given: tuple[Array, ...], h: float, guess: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """(2) for one stage: G_j gives the force, G_j+1 the constraint; solved with the symmetric matrix of the stage, repeated.

        ``given``: q_j, v_j, q_j+1, and v_j+1 without this stage, which adds h a.
        """
        self.stats.residuals += 1
        self.stats.factorisations += 1
        nothing = MOVES_NOTHING * self.system.length / (h * h)  # a body that is held has roundoff only
        driver = self.solver.driver
        found = None if driver is None else driver.half_stage(self.state, times, (h, nothing), given, guess)
        if found is None:
            return self._iterated_stage(times, given, (h, nothing), guess)
        self.stats.solves += found[2]
        return found[:2]

    def _iterated_stage(
        self, times: Array, given: tuple[Array, ...], sizes: tuple[float, float], guess: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """The same in parts."""
        (q, v, end, known), (h, nothing), (a, lam), n = given, sizes, guess, self.system.n_lam
        ev = self.system.at(float(times[0]), q, v)
        after = self.system.at(float(times[1]), end, known)  # drives ask for velocities
        self.solver.prepare(ev, MASS)
        rate = after.constraint_rate() if n else np.zeros(0)

        last = np.inf
        for _ in range(50):
            r = ev.balance(a, lam)
            slip = (after.jacobian.times(known + h * a) + rate) / h if n else np.zeros(0)
            da, dlam = self.solver.solve(-r, -slip)
            self.stats.solves += 1
            a, lam = a + da, lam + dlam

            size = self.system.max_abs(da)
            scale = max(self.system.max_abs(a), 1e-300)
            stalled = size >= 0.5 * last and size <= 1e-9 * scale
            if stalled or size <= max(1e-13 * scale, nothing):
                return a, lam
            if not np.isfinite(size) or size > 2 * last:
                break
            last = size
        raise ConvergenceError(
            f"A half-explicit stage at t = {ev.t:.6g} s did not close its constraints: take a smaller dt."
        )
