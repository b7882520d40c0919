"""The explicit Runge-Kutta method of order eight of Dormand and Prince, for accelerations; constraints closed by projection.

    xi_i = h sum_j a_ij rate(xi_j, v_j),     v_i = v_n + h sum_j a_ij a_j                                           (1)
    [M G^T; G 0] (a_j, lambda_j) = (-f, -gamma)  at  (t_n + c_j h, q_n o exp(xi_j), v_j)                            (2)

Each of the twelve stages is one linear system with the matrix of the masses. At the end of a step q, then v, are moved onto the
constraints in the mass metric, which changes them by the error of the step and keeps the order; the recorded a and lambda are
those of the new state. Embedded formulas of orders five and three tell the error. Made for motion without stiff forces, with
tolerances from 1e-5 down to 1e-12. Where the compiled driver knows a system all stages of a step are one call.

Sources: Hairer, Norsett and Wanner, Solving ODEs I, doi:10.1007/978-3-540-78862-1, sections II.5 (DOP853) and II.6 (values
between steps); projection: Hairer and Wanner, Solving ODEs II, doi:10.1007/978-3-642-05221-7, section VII.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import DOP853

from ...linear.condensation import StepSolver
from ...rotations import Array
from ...system.compiled.declarations import constants
from ...system.compiled.explicit import CONTROLLED
from ...system.compiled.march import March
from ...system.compiled.states.explicit import Tableau
from ...system.layout import State
from ...system.system import System
from ..consistent import accelerations
from ..newton import Newton
from .explicit_stepper import ExplicitScheme, ExplicitStepper, amplified

STAGES = 12
(THIRD,) = constants(
    "runge_kutta.c", "THIRD"
)  # weight of the square of the error of order three beside that of order five


@lru_cache
def coefficients() -> tuple[Array, Array]:
    """Nodes c (12,), and rows a (13, 12) with the weights last."""
    return np.ascontiguousarray(DOP853.C[:STAGES]), np.vstack((DOP853.A[:STAGES, :STAGES], DOP853.B))


def amplification(z: float, damping: float) -> Array:
    """The matrix of one step for x'' + c x' + w^2 x = 0, z = h w and damping = h c, over (x, h x'), (2, 2)."""
    return amplified(coefficients()[1], z, damping)


@dataclass(frozen=True)
class ExplicitRungeKutta(ExplicitScheme):
    """Scheme data, order eight; settings of :class:`.ExplicitScheme`."""

    rtol: float | None = 1e-8
    order = 8
    name = "explicit Runge-Kutta (8)"

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> RungeKuttaStepper:
        """Time stepper from a consistent state."""
        return RungeKuttaStepper(self, system, solver, newton, state)


class RungeKuttaStepper(ExplicitStepper):
    """Advances a consistent state."""

    what = "The explicit Runge-Kutta scheme"
    _slopes: tuple[Array, Array] | None = None  # rates and accelerations of the stages of the last step

    maker = "RUNGE_KUTTA"
    embedded = np.vstack((DOP853.E5[:STAGES], DOP853.E3[:STAGES]))
    amplification = staticmethod(amplification)

    def _tableau(self) -> tuple[Tableau, float]:
        return coefficients(), 0.0

    def _own(self, *, factored: bool) -> Array:
        slopes = np.zeros((1, 2 * STAGES * self._twin.system.n_v))
        return np.concatenate((super()._own(factored=factored), slopes), axis=1)

    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        rates, pushes = self._twin.forces(march.ring.own()[CONTROLLED:].reshape(2, STAGES, -1))
        self._slopes = rates.copy(), pushes.copy()

    def _count(self, attempts: int) -> None:
        self.stats.residuals += attempts * (STAGES - 1)
        self.stats.factorisations += attempts * (STAGES - 1)

    def _step(self, h: float) -> tuple[State, tuple[Array, Array]]:
        """(1), (2): the new state before projection, and the slopes of all stages."""
        s, driver = self.state, self.solver.driver
        self._count(1)
        found = None if driver is None else driver.stages(s, h, coefficients())
        if found is None:
            found = self._stages(h)

        rates, pushes, xi, v = found
        self._slopes = rates, pushes
        return State(s.t + h, self.system.compose(s.q, xi), v, s.a, s.lam), (rates, pushes)

    def _stages(self, h: float) -> tuple[Array, Array, Array, Array]:
        """All stages one by one, as the driver finds them."""
        s, (c, A) = self.state, coefficients()
        rates, pushes = [s.v], [s.a]
        for i in range(1, STAGES):
            rate, push = self._slopes_at(s.t + c[i] * h, h * A[i, :i], (s, np.array(rates), np.array(pushes)))
            rates.append(rate)
            pushes.append(push)

        b = h * A[STAGES]
        return np.array(rates), np.array(pushes), b @ rates, s.v + b @ pushes

    def _slopes_at(self, t: float, weights: Array, known: tuple[State, Array, Array]) -> tuple[Array, Array]:
        """Rate of xi and acceleration at a time, where so much of the slopes known so far leads."""
        s, rates, pushes = known
        xi = weights @ rates
        v = s.v + weights @ pushes
        at = accelerations(self.system, State(t, self.system.compose(s.q, xi), v, s.a, s.lam), self.solver)
        return self.system.rate(xi, v), at.a

    def _size(self, h: float, errors: tuple[Array, Array]) -> float:
        """The error by the formulas of orders five and three, over the tolerance."""
        fifth, third = (self.norm(h, *(h * (weights @ slopes) for slopes in errors)) for weights in self.embedded)
        return 0.0 if fifth == 0.0 else float(fifth * fifth / np.sqrt(fifth * fifth + THIRD * third * third))

    def restart(self, t: float) -> None:
        """Accelerations and multipliers behind a kink at t."""
        super().restart(t)
        self._slopes = None

    def between(self, t: float) -> State | None:
        """The state at a time t (s) within the last step, of order seven, with three stages more; None after a new start;
        accelerations and multipliers are solved for; collective.
        """
        if self.before is None or self._slopes is None:
            return None
        system, a, b = self.system, self.before, self.state
        h = b.t - a.t
        moved = system.difference(a.q, b.q)
        pairs = self._all_slopes(h, system.rate(moved, b.v))
        x = (t - a.t) / h
        xi, change = (_interpolated(x, end, h * slopes) for end, slopes in zip((moved, b.v - a.v), pairs, strict=True))
        made = State(t, system.compose(a.q, xi), a.v + change, a.a, a.lam)
        return accelerations(system, made, self.solver)

    def _all_slopes(self, h: float, last: Array) -> tuple[Array, Array]:
        """Slopes of xi and of v in the stages, at the end, where the rate is ``last``, and in three stages more; (16, n_v)."""
        assert self.before is not None and self._slopes is not None
        rates, pushes = (np.vstack(x) for x in zip(self._slopes, (last, self.state.a), strict=True))
        for c, row in zip(DOP853.C_EXTRA, DOP853.A_EXTRA, strict=True):
            known = self.before, rates, pushes
            rate, push = self._slopes_at(self.before.t + c * h, h * row[: len(rates)], known)
            rates = np.vstack((rates, rate))
            pushes = np.vstack((pushes, push))
        return rates, pushes


def _interpolated(x: float, change: Array, slopes: Array) -> Array:
    """What has changed after the share x of a step; ``change``: after all of it, ``slopes``: times its size, (16, n)."""
    first, last = slopes[0], slopes[STAGES]
    terms = [change, first - change, 2 * change - (first + last), *(DOP853.D @ slopes)]
    found = np.zeros_like(change)
    for i, term in enumerate(reversed(terms)):
        found = (found + term) * (x if i % 2 == 0 else 1 - x)
    return found
