"""The explicit Runge-Kutta method of order eight of Dormand and Prince, for accelerations; constraints closed by projection.

    xi_i = h sum_j a_ij rate(xi_j, v_j),     v_i = v_n + h sum_j a_ij a_j                                           (1)
    [M G^T; G 0] (a_j, lambda_j) = (-f, -gamma)  at  (t_n + c_j h, q_n o exp(xi_j), v_j)                            (2)

Each of the twelve stages is one linear system with the matrix of the masses. At the end of a step q, then v, are moved onto the
constraints in the mass metric, which changes them by the error of the step and keeps the order; the recorded a and lambda are
those of the new state. Embedded formulas of orders five, six and three tell the error. Made for motion without stiff forces, with
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
from ...system.layout import State, States
from ...system.system import System
from ..consistent import accelerations
from ..consistent_states import accelerated
from ..error_norm import worst
from ..newton import Newton
from .explicit_stepper import ExplicitScheme, ExplicitStepper

STAGES = 12
# weight of the square of the error of order three beside those of higher orders
(THIRD,) = constants("onestep/runge_kutta.c", "THIRD")
BEND = 4.0  # length of the formula of order six beside that of order five: smooth motion still has less error by it


@lru_cache
def coefficients() -> tuple[Array, Array]:
    """Nodes c (12,), and rows a (13, 12) with the weights last."""
    return np.ascontiguousarray(DOP853.C[:STAGES]), np.vstack((DOP853.A[:STAGES, :STAGES], DOP853.B))


def formulas() -> Array:
    """Weights of slopes in formulas of the error, (3, 12): of orders five, six and three.

    The error by one formula vanishes for some place of a bend of forces within the step, whatever the bend leaves: hardly that by
    two. Weights e that vanish at stages two to five, of lower order, are of order six with sum_i e_i c_i^k = 0, k <= 5, and
    sum_ijk e_i a_ij a_jk c_k^3 = 0. Of smooth motion they see little.
    """
    (c, A), fifth = coefficients(), DOP853.E5[:STAGES]
    good, A = fifth != 0.0, A[:STAGES]
    sixth = np.zeros(STAGES)
    sixth[good] = np.linalg.svd(np.vstack((c ** np.arange(6)[:, None], A @ A @ c**3))[:, good])[2][-1]
    return np.vstack((fifth, BEND * np.linalg.norm(fifth) * sixth, DOP853.E3[:STAGES]))


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
    maker = "RUNGE_KUTTA"
    embedded = formulas()

    def _tableau(self) -> tuple[Tableau, float]:
        return coefficients(), 0.0

    def _own(self, *, factored: bool) -> Array:
        slopes = np.zeros((1, 2 * STAGES * self._twin.system.n_v))
        return np.concatenate((super()._own(factored=factored), slopes), axis=1)

    def _take_march(self, march: March, made: int) -> None:
        super()._take_march(march, made)
        self._slopes = self._told(march.ring.own()).copy()

    def _told(self, own: Array) -> Array:
        return self._twin.forces(own[..., CONTROLLED:].reshape(*own.shape[:-1], 2, STAGES, -1))

    def _count(self, attempts: int) -> None:
        self.stats.residuals += attempts * (STAGES - 1)
        self.stats.factorisations += attempts * (STAGES - 1)

    def _step(self, h: float) -> tuple[State, tuple[Array, Array]]:
        """(1), (2): the new state before projection, and the slopes of all stages."""
        s = self.state
        self._count(1)
        rates, pushes, xi, v = self._stages(h)
        self._slopes = np.array((rates, pushes))
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
        """The error by the formulas, over the tolerance."""
        fifth, sixth, third = (
            self.norm(h, *(h * (weights @ slopes) for slopes in errors)) for weights in self.embedded
        )
        high = worst(fifth, sixth)
        return 0.0 if high == 0.0 else float(high * high / np.sqrt(high * high + THIRD * third * third))

    def _polynomial(self, before: States, after: States, t: Array, slopes: Array) -> States:
        """States of order seven, with three stages more; accelerations and multipliers are solved for."""
        system, h = self.system, after.t - before.t
        moved = system.difference(before.q, after.q)
        pairs = self._all_slopes((before, after), h, system.rate(moved, after.v), slopes)
        x = (t - before.t) / h
        changes = (moved, after.v - before.v)
        xi, change = (_interpolated(x, end, h[..., None] * all_of) for end, all_of in zip(changes, pairs, strict=True))
        made = States(t, system.compose(before.q, xi), before.v + change, before.a, before.lam)
        return accelerated(system, made, self.solver)

    def _all_slopes(self, ends: tuple[States, States], h: Array, last: Array, slopes: Array) -> list[Array]:
        """Slopes of xi and of v in the stages of steps h (k, 1) s, at the end, where the rate is ``last``, and in three stages
        more; (k, 16, n_v).
        """
        system, (before, after) = self.system, ends
        pairs = [np.concatenate((slopes[:, i], x[:, None]), axis=1) for i, x in enumerate((last, after.a))]
        for c, row in zip(DOP853.C_EXTRA, DOP853.A_EXTRA, strict=True):
            xi, change = (h * (row[: x.shape[1]] @ x) for x in pairs)
            q, v = system.compose(before.q, xi), before.v + change
            at = accelerated(system, States(before.t + c * h, q, v, before.a, before.lam), self.solver)
            new = system.rate(xi, v), at.a
            pairs = [np.concatenate((x, y[:, None]), axis=1) for x, y in zip(pairs, new, strict=True)]
        return pairs


def _interpolated(x: Array, change: Array, slopes: Array) -> Array:
    """What has changed after shares x (k, 1) of steps; ``change``: after all of each, ``slopes`` (k, 16, n): times its size."""
    first, last = slopes[:, 0], slopes[:, STAGES]
    higher = np.moveaxis(DOP853.D @ slopes, 1, 0)
    terms = [change, first - change, 2 * change - (first + last), *higher]
    found = np.zeros_like(change)
    for i, term in enumerate(reversed(terms)):
        found = (found + term) * (x if i % 2 == 0 else 1 - x)
    return found
