"""Generalized-alpha with compiled steps; a step that the compiled code gives back is made in NumPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from ...system.system import State
from . import alpha_driver as slots
from .alpha_driver import AlphaDriver, settings
from .generalized_alpha import FAR, PATIENCE, Stepper

if TYPE_CHECKING:
    from ...run.energy_check import Watch
    from ...system.compiled.recording import Openness, Tape
    from .generalized_alpha import GeneralizedAlpha


class CompiledStepper(Stepper):
    """Steps by the driver, one or many in a call. Steps that it gives back are NumPy's."""

    path = "compiled (all bodies, joints and forces in C; NumPy for the start and for steps it gives back)"

    def __init__(self, data: tuple[GeneralizedAlpha, Any, Any, Any, State], driver: AlphaDriver) -> None:
        self.driver = driver
        self._tail: State | None = None  # the state of the newest block
        self._ahead = False  # blocks are newer than A and the past of the NumPy path
        super().__init__(*data)
        self.counters["compiled_steps"] = 0.0
        settings(driver.parameters, self.scheme.parameters, self.system, self.newton)
        driver.parameters[slots.FAR] = FAR * self.system.length
        driver.parameters[slots.PATIENCE] = PATIENCE

    @property
    def A(self) -> Array:  # type: ignore[override]
        """Algorithmic acceleration at the end of the last step."""
        self._settle()
        return self._A

    @A.setter
    def A(self, value: Array) -> None:
        self._A = value

    @property
    def _past(self) -> list[tuple[float, Array, Array]]:  # type: ignore[override]
        self._settle()
        return self._earlier

    @_past.setter
    def _past(self, value: list[tuple[float, Array, Array]]) -> None:
        self._earlier = value

    def _split(self, block: Array) -> tuple[float, Array, Array, Array, Array, Array]:
        """t, q, v, a, A, lambda of a block."""
        n, at = self.driver.n, 1 + self.driver.nq
        return (
            float(block[0]),
            block[1:at],
            *(block[at + i * n : at + (i + 1) * n] for i in range(3)),
            block[at + 3 * n :],
        )  # type: ignore[return-value]

    def _settle(self) -> None:
        """Give A and the past of the newest blocks to the NumPy path."""
        if self._ahead and self._tail is self.state:
            known = int(self.driver.parameters[slots.HISTORY])
            blocks = [self._split(self.driver.block(i).copy()) for i in range(known + 1)]
            self._A = blocks[0][4]
            self._earlier = [(t, a, lam) for t, _, _, a, _, lam in blocks[1:]]
        self._ahead = False

    def _load(self) -> None:
        """Blocks from the state, A and the past of the NumPy path."""
        s = self.state
        zero, place = np.zeros(self.driver.n), np.zeros(self.driver.nq)
        past = [(t, place, zero, a, zero, lam) for t, a, lam in self._past]
        self.driver.load([(s.t, s.q, s.v, s.a, self.A, s.lam), *past])
        self._tail = s

    def advance(self, h: float) -> State:
        """One step of size h (s), as :meth:`Stepper.advance`."""
        if not (self._first_march(h) if self.fresh else self.march(h, 1)):
            return super().advance(h)
        return self.state

    def _first_march(self, h: float) -> int:
        """The first step after a consistent start; 1 where it could be made.

        It begins from v_0 and A_0 without a transient. What a and lambda would have been a step earlier along their present
        rates makes the driver predict a_0 + h a' and lambda_0 + h lambda'; later steps know of true values only.
        """
        s, driver = self.state, self.driver
        _, (v, A, a, lam) = self._predicted(h)
        earlier = (s.t - h, np.zeros_like(s.q), v, 2 * s.a - a, A, 2 * s.lam - lam)
        driver.load([(s.t, s.q, v, s.a, A, s.lam), earlier])
        self._tail, self.fresh = s, False
        made = self.march(h, 1)
        self._tail, self.fresh = (self.state, False) if made else (None, True)
        driver.parameters[slots.HISTORY] = made
        return made

    def march(self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None) -> int:
        """Up to so many steps of size h (s) in one call; how many were made.

        ``watch``: stop before one that gains energy. ``tape``: takes records on the way, one of :meth:`tape`.
        """
        if self.fresh:
            return 0
        if self._tail is not self.state:
            self._load()
        driver, newton = self.driver, self.newton
        p = driver.parameters
        p[slots.H], p[slots.THETA] = h, newton.theta
        p[slots.GUARDED] = watch is not None
        if watch is not None:
            p[slots.HIGHEST : slots.SETTLING + 1] = watch.limits

        made, verdict = driver.march(steps, tape)
        if verdict == slots.LOOK:
            driver.tables.look()
        if not made:
            return 0
        if watch is not None:
            watch.limits = tuple(p[slots.HIGHEST : slots.SETTLING + 1])
        self._take(made)
        return made

    def tape(self, judged: Openness) -> Tape:
        """Room for records of :meth:`march`; ``judged``: how open joints are told."""
        return self.driver.tape(judged)

    def _take(self, made: int) -> None:
        """The newest state, and what the steps counted."""
        p, newton = self.driver.parameters, self.newton
        self.counters["compiled_steps"] += made
        newton.iterations += int(p[slots.ITERATIONS])
        newton.note(float(p[slots.LEFT]), made)
        newton.theta = float(p[slots.THETA])
        self.solver.core.factorisations += made
        self.local_error, self._ahead = float(p[slots.LOCAL]), True
        t, q, v, a, _, lam = self._split(self.driver.block(0).copy())
        self.state = self._tail = State(t, q, v, a, lam)
