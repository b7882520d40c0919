"""Generalized-alpha with compiled steps; a step that the compiled code gives back is made in NumPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from ...system.system import State
from ..dae import GGL
from . import alpha_driver as slots
from .alpha_driver import AlphaDriver, settings
from .generalized_alpha import FAR, PATIENCE, Stepper

if TYPE_CHECKING:
    from ...run.energy_check import Watch
    from ...system.compiled.recording import Openness, Tape
    from .generalized_alpha import GeneralizedAlpha


class CompiledStepper(Stepper):
    """Steps by the driver, one or many in a call. Those that fail are NumPy's."""

    path = "compiled (all bodies, joints and forces in C; NumPy for the start and for steps it gives back)"
    compiled_whole = True
    keeps_memories = True

    def __init__(self, data: tuple[GeneralizedAlpha, Any, Any, Any, State], driver: AlphaDriver | None) -> None:
        self._driver: AlphaDriver | None = None
        self._tail: State | None = None  # the state of the newest block
        self._ahead = False  # blocks are newer than A and the past of the NumPy path
        self._refused: tuple[State, float] | None = None  # where the driver gave a step of this size back
        super().__init__(*data)
        self.counters["compiled_steps"] = 0.0
        if driver is not None:
            self._use(driver)

    def _use(self, driver: AlphaDriver) -> None:
        """Take a driver."""
        self._driver, self._tail = driver, None
        settings(driver.parameters, self.scheme.parameters, self.system, self.newton)
        driver.parameters[slots.FAR] = FAR * self.system.length
        driver.parameters[slots.PATIENCE] = PATIENCE
        driver.parameters[slots.STABILISED] = isinstance(self.scheme.form, GGL)

    @property
    def driver(self) -> AlphaDriver:
        """The driver in use."""
        assert self._driver is not None
        return self._driver

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

    @property
    def slopes(self) -> Array | None:  # type: ignore[override]
        """Slopes of forces in Python that the next step begins with."""
        return None if self._driver is None else self._driver.slopes

    @slopes.setter
    def slopes(self, kept: Array | None) -> None:
        if self._driver is not None:
            self._driver.slopes = kept

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
        """Give A and the past of the newest blocks to the NumPy path; they hold for the state with its time rounded too."""
        if self._ahead:
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
        if not (self._first_march(h) if self.fresh else self._march(h, 1)):
            return super().advance(h)
        return self.state  # who called notes the memory of elements when the step is accepted

    def _first_march(self, h: float) -> int:
        """The first step after a consistent start, as :meth:`Stepper._first` prepares it; 1, or 0 where it fails."""
        s = self.state
        _, (v, A, a, lam) = self._predicted(h)

        # the predictor of the driver is a line through two states: one before the start that leads to what was predicted
        place, zero = np.zeros(self.driver.nq), np.zeros(self.driver.n)
        before = (s.t - h, place, zero, 2 * s.a - a, zero, 2 * s.lam - lam)
        self.driver.load([(s.t, s.q, v, s.a, A, s.lam), before])
        self.fresh = not self._steps(h, 1)
        self.driver.parameters[slots.HISTORY] = 1
        return 0 if self.fresh else 1

    def march(self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None) -> int:
        """Up to so many steps of size h (s) in one call; how many were made.

        ``watch``: stop before one that gains energy. ``tape``: takes records on the way, one of :meth:`tape`. Elements with a
        memory have that of the last step.
        """
        made = self._march(h, steps, watch, tape)
        if made:
            self.driver.tables.remember()
        return made

    def note(self) -> bool:
        """Elements with a memory keep that of the newest state, which is accepted; whether it is known."""
        known = self._ahead and self._tail is self.state
        if known:
            self.driver.tables.remember()
        return known

    def _march(self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None) -> int:
        """The same; the memory of elements is left as it was."""
        refused = self._refused is not None and self._refused[0] is self.state and self._refused[1] == h
        if self.fresh or refused:
            return 0
        if self._tail is not self.state:
            self._load()
        return self._steps(h, steps, watch, tape)

    def _steps(self, h: float, steps: int, watch: Watch | None = None, tape: Tape | None = None) -> int:
        """The same from the blocks as they are."""
        driver, newton = self.driver, self.newton
        p = driver.parameters
        p[slots.H], p[slots.THETA] = h, newton.theta
        p[slots.GUARDED] = watch is not None
        if watch is not None:
            p[slots.HIGHEST : slots.SETTLING + 1] = watch.limits

        driver.tables.recall()
        made, verdict = driver.march(steps, tape)
        if verdict == slots.LOOK:
            driver.tables.look()
        if made and watch is not None:
            watch.limits = tuple(p[slots.HIGHEST : slots.SETTLING + 1])
        if made:
            self._take(made)
        if verdict in (slots.NEWTON, slots.SINGULAR):
            self._refused = self.state, h
        return made

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records of :meth:`march`; ``judged``: how open joints are told. None where states would be read one by one
        that depend on a memory, which later steps change.
        """
        tables = self.driver.tables
        if tables.c.remembers and not tables.looks.complete:
            return None
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
