"""A half-explicit Runge-Kutta method of order four for the velocity form: five stages, no iteration on forces; non-stiff motion.

    xi_i = h sum_j a_ij rate(xi_j, v_j),     v_i = v_n + h sum_j a_ij a_j                                           (1)
    M a_j + f(q_j, v_j) + G_j^T lambda_j = 0,     G_j+1 v_j+1 + g_t = 0                                             (2)

Each stage is linear in (a_j, lambda_j): the multiplier of stage j is what makes the next stage's velocity (for the last
stage, the new velocity) satisfy the constraints. Positions are closed by a projection in the mass metric at the end of the
step. An embedded formula that meets the conditions of order three, freed of its share across the constraints, gives the error
estimate, together with what the projection moves; it falls like h^3 or faster. Orders of q and v: 4; the recorded a and lambda
solve the accelerations at the new state and have the same order.

Sources: Brasey and Hairer, doi:10.1137/0730025 (half-explicit methods, the coefficients HEM4); Hairer and Wanner, Solving
ODEs II, section VII.6, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...errors import ConvergenceError
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...rotations import Array
from ...system.compiled.march import ITERATIONS, March
from ...system.compiled.states.explicit import MOVES_NOTHING, SPEEDS, Tableau
from ...system.evaluation import Evaluation
from ...system.layout import State, States
from ...system.speed_rows import speed_rows
from ...system.system import System
from ..consistent_states import accelerated
from ..dense_output import cubic
from ..newton import Newton
from .explicit_stepper import ExplicitScheme, ExplicitStepper

MASS = Weights(1.0, 0.0, 0.0)
STAGES = 5
Slopes = tuple[Array, Array, Array, Array]  # rates and accelerations (stages, n_v); xi and v at the end
Found = tuple[Array, Array, int]  # a and lambda of a stage, and how many solutions that took


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


@dataclass(frozen=True)
class HalfExplicit(ExplicitScheme):
    """Scheme data, order four; settings of :class:`.ExplicitScheme`."""

    rtol: float | None = 1e-6
    order = 4
    name = "half-explicit Runge-Kutta (4)"

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> HalfExplicitStepper:
        """Time stepper from a consistent state."""
        return HalfExplicitStepper(self, system, solver, newton, state)


class HalfExplicitStepper(ExplicitStepper):
    """Advances a consistent state."""

    what = "The half-explicit scheme"
    maker = "HALF_EXPLICIT"
    embedded = coefficients()[2]

    def _polynomial(self, before: States, after: States, t: Array, slopes: Array) -> States:
        """States of the order of the scheme.

        Positions are those of the polynomial of degree 4 through both ends with their velocities and the first acceleration, in
        the local coordinates of the step's start; velocities those of the cubic through both ends with their accelerations;
        accelerations and multipliers are solved for. Hairer, Norsett, Wanner, doi:10.1007/978-3-540-78862-1, II.6.
        """
        system, h = self.system, after.t - before.t
        x = (t - before.t) / h

        moved = system.difference(before.q, after.q)
        ends = h * before.v, h * system.rate(moved, after.v)
        xi = _quartic(x, moved, ends, h * h * before.a)
        v = cubic(x, h, (before.v, after.v), (before.a, after.a))
        made = States(t, system.compose(before.q, xi), v, before.a, before.lam)
        return accelerated(system, made, self.solver)

    def _tableau(self) -> tuple[Tableau, float]:
        return coefficients()[:2], MOVES_NOTHING * self.system.length

    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        self.stats.solves += int(march.parameters[ITERATIONS])

    def _count(self, attempts: int) -> None:
        self.stats.residuals += attempts * STAGES
        self.stats.factorisations += attempts * STAGES

    def _step(self, h: float) -> tuple[State, tuple[Array, Array]]:
        """(1), (2): the new state before projection, and the errors of xi and v."""
        system, s = self.system, self.state
        c, A, difference = coefficients()
        nothing = MOVES_NOTHING * system.length / (h * h)  # a body that is held has roundoff only
        self._count(1)

        (rates, pushes, xi, v), (a, lam, solves) = self._stages(h, nothing)
        self.stats.solves += solves

        errors: tuple[Array, Array] = h * (difference @ rates), h * (difference @ pushes)
        q = system.compose(s.q, xi)
        if system.n_lam and self.adaptive:
            errors = self._along(errors, system.at(s.t + c[-1] * h, q, v))
        return State(s.t + h, q, v, a, lam), errors

    def _along(self, errors: tuple[Array, Array], after: Evaluation) -> tuple[Array, Array]:
        """Errors of xi and v without their share across the constraints: multipliers of stages are of low order."""
        self.solver.prepare(after, MASS)
        across_q, across_v = (after.jacobian.times(e) for e in errors)
        across_q += after.constraint()  # what places miss the constraints by is an error of the step's own
        across_q[speed_rows(self.system)] = 0.0  # rows on velocities hold no places: errors of these stay
        nothing = np.zeros(self.system.n_v)
        e_q, e_v = (e - self.solver.solve(nothing, x)[0] for e, x in zip(errors, (across_q, across_v), strict=True))
        return e_q, e_v

    def _stages(self, h: float, nothing: float) -> tuple[Slopes, Found]:
        """All stages; ``nothing``: the acceleration that counts as none."""
        system, s = self.system, self.state
        c, A, _ = coefficients()
        xi, v, a, lam = np.zeros_like(s.v), s.v, s.a, s.lam

        rates: list[Array] = []
        pushes: list[Array] = []
        solves = 0

        for i in range(len(c) - 1):
            rates.append(system.rate(xi, v))
            q = system.compose(s.q, xi)
            xi = h * (A[i + 1, : i + 1] @ np.array(rates))
            known = s.v + h * (A[i + 1, :i] @ np.array(pushes)) if i else s.v
            given = q, v, system.compose(s.q, xi), known
            a, lam, took = self._stage(s.t + h * c[i : i + 2], given, (h * A[i + 1, i], nothing), (a, lam))
            solves += took
            pushes.append(a)
            v = known + h * A[i + 1, i] * a

        return (np.array(rates), np.array(pushes), xi, v), (a, lam, solves)

    def _stage(
        self, times: Array, given: tuple[Array, ...], sizes: tuple[float, float], guess: tuple[Array, Array]
    ) -> Found:
        """(2) for one stage: G_j gives the force, G_j+1 the constraint; solved with the symmetric matrix of the stage, repeated.

        ``given``: q_j, v_j, q_j+1, and v_j+1 without this stage, which adds h a. ``sizes``: h, and the acceleration that counts
        as none.
        """
        (q, v, end, known), (h, nothing), (a, lam), n = given, sizes, guess, self.system.n_lam
        ev = self.system.at(float(times[0]), q, v)
        after = self.system.at(float(times[1]), end, known)  # drives ask for velocities
        self.solver.prepare(ev, MASS)
        rate = after.constraint_rate() if n else np.zeros(0)
        nothing = max(nothing, SPEEDS * self.system.max_abs(known) / h)

        last = np.inf
        for k in range(50):
            r = ev.balance(a, lam)
            slip = (after.jacobian.times(known + h * a) + rate) / h if n else np.zeros(0)
            da, dlam = self.solver.solve(-r, -slip)
            a, lam = a + da, lam + dlam

            size = self.system.max_abs(da)
            scale = max(self.system.max_abs(a), 1e-300)
            stalled = size >= 0.5 * last and size <= 1e-9 * scale
            if stalled or size <= max(1e-13 * scale, nothing):
                return a, lam, k + 1
            if not np.isfinite(size) or size > 2 * last:
                break
            last = size
        raise ConvergenceError(
            f"A half-explicit stage at t = {ev.t:.6g} s did not close its constraints: take a smaller dt."
        )


def _quartic(x: Array, change: Array, slopes: tuple[Array, Array], bend: Array) -> Array:
    """From 0 at x = 0 by ``change`` until x = 1, with these slopes at both ends and the second derivative ``bend`` at x = 0."""
    first, last = slopes
    parabola = x * first + 0.5 * x * x * bend

    # what it leaves open at the end, in place and slope
    gap = change - first - 0.5 * bend
    turn = last - first - bend
    return parabola + x**3 * ((4 - 3 * x) * gap + (x - 1) * turn)
