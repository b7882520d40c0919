"""RATTLE: second order, symmetric, position and velocity constraints both hold; for non-stiff motion over long times.

    M (v_1/2 - v_n) = -(h/2) (f(q_n, v_1/2) + G_n^T lambda_n),         q_n+1 = q_n o exp(h v_1/2),   g(q_n+1) = 0       (1)
    M (v_n+1 - v_1/2) = -(h/2) (f(q_n+1, v_1/2) + G_n+1^T mu_n+1),     G_n+1 v_n+1 + g_t = 0                            (2)

with f all terms of the balance but M a. For a constant mass matrix and conservative forces the step is symplectic: the
energy error stays bounded over any number of steps. With rotations in space, or M(q), it is symmetric. The multipliers of
(1), (2) belong to the half steps: as values at t_n+1 they are of first order. The recorded a and lambda solve the
accelerations at (q, v)_n+1 and are of second order.

Sources: Andersen, doi:10.1016/0021-9991(83)90014-1; Leimkuhler and Skeel, doi:10.1006/jcph.1994.1085; Hairer, Lubich and Wanner,
Geometric Numerical Integration, VII.1.4, doi:10.1007/3-540-30666-8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...errors import BalanceError, ConvergenceError
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...rotations import Array
from ...system.compiled.march import March
from ...system.compiled.states.evaluation import DriverStates
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.lengths import farthest
from ...system.scene.contents import Contents
from ...system.serialisation import Memory, plain
from ...system.system import System
from ..consistent import behind_a_jump
from ..dae import positions_refused
from ..marching import MarchingStepper
from ..newton import Newton
from .explicit_limit import StepLimit

MASS = Weights(1.0, 0.0, 0.0)
PATIENCE = 4  # iterations with the masses alone, before the matrix knows of damping


@dataclass(frozen=True)
class Rattle:
    """Scheme data; nothing to choose. Steps must resolve every vibration: h omega < 2; longer ones are refused."""

    order = 2
    name = "RATTLE"
    free_steps = True  # any size may follow any other

    holds = (0, 1)

    def refusal(self, held: Contents) -> str:
        """Why it does not take what a scene holds."""
        return positions_refused(held, "Rattle", self.holds)

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> RattleStepper:
        """The time stepper of a run, from a consistent state."""
        return RattleStepper(system, solver, newton, state)


def amplification(z: float, damping: float) -> Array:
    """The matrix of one step for x'' + c x' + w^2 x = 0, z = h w and damping = h c, over (x, h x'), (2, 2)."""
    x, v = np.eye(2)
    middle = (v - 0.5 * z * z * x) / (1.0 + 0.5 * damping)
    new = x + middle
    return np.array([new, middle - 0.5 * (z * z * new + damping * middle)])


class RattleStepper(MarchingStepper):
    """Advances a consistent state; ``half`` holds the multipliers of the last second half step.

    ``ahead``: by how much accelerations and multipliers of the last first half step differed from those at its beginning, a
    second of step: where the next one starts. ``damped``: forces depend on velocities so much that the matrix has to know them.
    """

    maker = "RATTLE"
    keeps: ClassVar = {"state": Memory.state, "half": plain(), "ahead": plain(), "damped": plain()}

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton, self.state = system, solver, newton, state
        self.half = state.lam
        self.ahead: tuple[Array, Array] = np.zeros_like(state.a), np.zeros_like(state.lam)
        self.damped = False
        self.limit: StepLimit = StepLimit("RATTLE", system, solver, amplification)

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """Go on with the accelerations behind a jump: records within the next step lie between these and those of its end."""
        self.state = behind_a_jump(self.system, start(), self.solver)
        self.ahead = np.zeros_like(self.state.a), np.zeros_like(self.state.lam)
        return True

    def advance(self, h: float) -> State:
        """One step of size h (s); collective. Raises ConvergenceError when the iteration for (1) fails, or h is too long."""
        self.limit.free(self.state, h)
        self.limit.count(1)
        try:
            return self.state if self._step_in_one_call(h) else self._step_in_parts(h)
        except BalanceError as error:
            raise self.limit.blame(self.state, h, error) from error

    def _room(self, states: DriverStates) -> int:
        s = states.tables.system
        return s.n_q + 6 * s.n_v + 4 * s.n_lam + states.tables.nu

    def _own(self, *, factored: bool) -> Array:
        a, lam = self.ahead
        return np.concatenate((self.half, self._twin.velocities(a), lam, (self.damped, factored)))[None]

    def _take_march(self, march: March, made: int) -> None:
        n, m, own = march.system.n_v, self.system.n_lam, march.ring.own().copy()
        self.half, self.ahead = own[:m], (self._twin.forces(own[m : m + n]), own[m + n : 2 * m + n])
        self.damped = bool(own[2 * m + n])
        self._count_increments(march.parameters, made)

    def _beginning(self, h: float) -> tuple[tuple[Array, Array], float]:
        """Where the iteration for (1) begins, and its tolerance (m), in parts."""
        system, s = self.system, self.state
        guess = s.a + h * self.ahead[0], s.lam
        # the smallest multipliers of dependent rows have none that grow from step to step
        if not self.solver.core.redundant:
            guess = guess[0], s.lam + h * self.ahead[1]
        accelerated = 0.5 * h * h * max(system.max_abs(s.a), 1e-300)
        return guess, self.newton.small(system, accelerated, farthest(system, s.q))

    def _step_in_parts(self, h: float) -> State:
        """The same, where it is no one call of C."""
        system, (guess, tolerance) = self.system, self._beginning(h)
        s = self.state
        t = s.t + h
        # first half, which closes the positions at the end
        a, lam, increments = self._first_half(h, guess, tolerance)
        self._look_ahead(h, (a, lam), increments)
        v = s.v + 0.5 * h * a
        q = system.compose(s.q, h * v)
        # second half, which closes the velocities
        a, self.half = self._solve_second(t, (q, v), h)
        v = v + 0.5 * h * a
        # accelerations and multipliers of the end, for records
        driver = self.solver.driver
        end = None if driver is None else driver.accelerations(t, q, v)
        if end is not None:
            self.state = State(t, q, v, *end)
            return self.state
        self.half = least(self.solver, t, q, self.half)  # which may take the matrix
        ev = system.at(t, q, v)
        self.solver.prepare_once(ev, MASS)  # which is that of the half step before, and of the next one
        a, lam = self._refine(ev, a, self.half, lambda a: ev.jacobian.times(a) + ev.gamma())
        self.state = State(t, q, v, a, least(self.solver, t, q, lam))
        return self.state

    def _look_ahead(self, h: float, first: tuple[Array, Array], increments: int) -> None:
        """Where the next step starts, from a and lambda of the first half of this one and how many increments these took."""
        a, lam = first
        self.ahead = (a - self.state.a) / h, (lam - self.state.lam) / h
        self.damped |= increments > PATIENCE

    def _first_half(self, h: float, guess: tuple[Array, Array], tolerance: float) -> tuple[Array, Array, int]:
        """a, lambda of (1) and the number of increments; where these diverge, the matrix learns of damping."""
        try:
            return self._iterated_half(h, guess, tolerance)
        except ConvergenceError:
            if self.damped:
                raise
        self.damped = True
        return self._iterated_half(h, guess, tolerance)

    def _iterated_half(self, h: float, guess: tuple[Array, Array], tolerance: float) -> tuple[Array, Array, int]:
        """The same with the matrix at hand."""
        system, s, (a, lam) = self.system, self.state, guess
        weights = Weights(1.0, 0.5 * h, 0.0) if self.damped else MASS
        begun: Evaluation | None = None

        def increment() -> float:
            nonlocal a, lam, begun
            v = s.v + 0.5 * h * a
            ev = system.at(s.t, s.q, v)
            if begun is None:
                self.solver.prepare_once(ev, weights)
            begun = ev

            r = ev.balance(a, lam)
            g = system.at(s.t + h, system.compose(s.q, h * v)).constraint() if system.n_lam else np.zeros(0)
            da, dlam = self.solver.solve(-r, -2.0 / (h * h) * g)

            a, lam = a + da, lam + dlam
            return 0.5 * h * h * system.max_abs(da) / tolerance

        converged, history = self.newton.solve(increment, lambda: begun is not None and self.solver.refresh(begun))
        if not converged:
            raise ConvergenceError(
                f"RATTLE's position constraints did not close at t = {s.t + h:.6g} s (h = {h:.3g} s): increments over tolerance "
                + " -> ".join(f"{x:.1e}" for x in history)
                + ". Take a smaller dt."
            )
        return a, lam, len(history)

    def _solve_second(self, t: float, end: tuple[Array, Array], h: float) -> tuple[Array, Array]:
        """a = 2 (v_n+1 - v_1/2) / h and mu of (2); ``end``: q_n+1 and v_1/2."""
        q, v = end
        ev = self.system.at(t, q, v)
        slip = ev.opening() if self.system.n_lam else np.zeros(0)
        self.solver.prepare_once(ev, MASS)
        return self._refine(ev, self.state.a, self.half, lambda a: ev.jacobian.times(a) + 2.0 / h * slip)

    def _refine(self, ev: Evaluation, a: Array, lam: Array, rows: Callable[[Array], Array]) -> tuple[Array, Array]:
        """Solve balance(a, lambda) = 0, rows(a) = 0; repeated where the solver's matrix is not exact (deformed bodies)."""
        exact = not self.system.fields and self.solver.core.exact
        for _ in range(self.newton.max_iterations):
            da, dlam = self.solver.solve(-ev.balance(a, lam), -rows(a) if self.system.n_lam else np.zeros(0))
            a, lam = a + da, lam + dlam
            if exact or self.system.max_abs(da) <= 1e-12 * max(self.system.max_abs(a), 1e-300):
                break
        return a, lam
