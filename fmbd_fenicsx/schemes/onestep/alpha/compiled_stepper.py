"""Generalized-alpha with compiled steps; a step that the compiled code gives back is made in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import BalanceError
from ....rotations import Array
from ....system.compiled import march as slots
from ....system.compiled.declarations import constants
from ....system.compiled.tape import on_the_way
from ....system.layout import State, States
from ...marching import COMPILED, CompiledSteps, lend_newton
from ...stepping import UNOBSERVED, Observers
from .alpha_driver import AlphaDriver
from .alpha_step import FAR, PATIENCE, AlphaStep, Rule, StepStart
from .alpha_stepper import CLOSINGS, SHUT, AlphaStepper

if TYPE_CHECKING:
    from ....linear.blocks.field_blocks import Weights
    from ....system.compiled.kept import KeptSteps
    from ....system.compiled.tape import Openness, Tape
    from .compiled_control import CompiledControl
    from .generalized_alpha import GeneralizedAlpha


(FAR_JUMP,) = constants("marches/control.c", "FAR_JUMP")


class CompiledAlphaStepper(CompiledSteps, AlphaStepper):
    """Steps by the driver, one or many in a call. Those that fail are NumPy's."""

    path = COMPILED
    compiled_whole = True

    def __init__(self, data: tuple[GeneralizedAlpha, Any, Any, Any, State], driver: AlphaDriver | None) -> None:
        self._driver: AlphaDriver | None = None
        self._tail: State | None = None  # the state of the newest block
        self._driven = False  # the driver made the last step, and has its factor
        self._ahead = False  # blocks are newer than A and the past of the NumPy path
        self._foretold: tuple[float, State, StepStart] | None = None  # the first step of a size (s) from a state
        super().__init__(*data)
        self.counters["compiled_steps"] = 0.0
        if driver is not None:
            self._use(driver)

    def _use(self, driver: AlphaDriver) -> None:
        """Take a driver."""
        self._driver, self._tail, self._driven = driver, None, False
        driver.parameters[slots.AM : slots.BETA + 1] = self.scheme.parameters
        lend_newton(driver.parameters, driver.system, self.newton)
        driver.parameters[slots.FAR] = FAR * self.system.length
        driver.parameters[slots.PATIENCE] = PATIENCE
        driver.parameters[slots.STABILISED] = self.stabilised

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """As :meth:`TimeStepper.begin_anew`; the driver's tables serve the start too, where they are those of evaluations."""
        with nullcontext() if self._driver is None else self._driver.idle():
            found = start()
        self._tail, self._driven, self._ahead, self._refused, self.slopes = None, False, False, None, None
        return super().begin_anew(lambda: found)

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

    @property
    def begun(self) -> tuple[State, Array, Array] | None:
        """What the last step began with, wherever it was made."""
        self._settle()
        return self._begun

    @property
    def origin(self) -> State:
        """As :meth:`TimeStepper.origin`."""
        begun = self.begun
        assert begun is not None
        return begun[0]

    def error(self, h: float, weights: Weights | None = None) -> Array:
        """As :meth:`Stepper.error`, with the driver's factor where it made the last step."""
        if not self._ahead:
            return super().error(h, weights)
        s, scale, jump, span = self._of_error(h)
        found = self.driver.error((scale, span), (s.q, s.v, s.a + jump, s.lam), s.t, scale * jump, weights)
        return super().error(h, weights) if found is None else found

    def filtered(self, h: float, missed: Array, s: State) -> Array:
        """As :meth:`AlphaStepper.filtered`, by the driver where it made the last step, with memories as before that."""
        if not self._driven:
            return super().filtered(h, missed, s)
        system, driver = self.system, self.driver
        jump = FAR_JUMP * max(system.typical(x.a) for x in (self.state, self.origin))
        part = system.max_abs(missed) / jump if jump else 1.0
        driver.tables.recall()
        arrays = s.q, s.v, s.a + missed / part, s.lam
        found = driver.error((part, 0.0), arrays, s.t, missed, self.scheme.rule(h).weights)
        return super().filtered(h, missed, s) if found is None else found

    def within(self, steps: KeptSteps) -> States:
        """As :meth:`TimeStepper.within`."""
        found = self._cubics(steps.before, steps.after, steps.t, steps.A)
        return replace(found, q=self._all_shut(found, self._weights_of(steps.before, steps.after)))

    def _all_shut(self, states: States, weights: list[Weights]) -> Array:
        """As :meth:`Stepper._all_shut`, in compiled code where that made the last step."""
        if not self._driven or not self.system.n_lam:
            return super()._all_shut(states, weights)
        found = self.driver.shut(states, weights, SHUT * self.system.length, CLOSINGS)
        return super()._all_shut(states, weights) if found is None else found

    def __copy__(self) -> CompiledAlphaStepper:
        """What may go on from here when this one has made steps: it loads the driver anew."""
        self._settle()
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__, _tail=None, _driven=False)
        return made

    def _settle(self) -> None:
        """Give A and the past of the newest blocks to the NumPy path; they hold for the state with its time rounded too."""
        if self._ahead:
            # the newest block first, then as many earlier ones as steps were made
            known = int(self.driver.parameters[slots.HISTORY])
            blocks = [self.driver.block(i) for i in range(known + 1)]
            self._A = blocks[0][4]
            self._earlier = [(t, a, lam) for t, _, _, a, _, lam in blocks[1:]]
            t, q, v, a, A, lam = blocks[1]
            self._begun = State(t, q, v, a, lam), v, A
        self._ahead = False

    def _load(self) -> None:
        """Blocks from the state, A and the past of the NumPy path."""
        s = self.state
        zero = np.zeros(self.system.n_v)
        place = np.zeros(self.system.n_q)
        past = [(t, place, zero, a, zero, lam) for t, a, lam in self._past]
        self.driver.load([(s.t, s.q, s.v, s.a, self.A, s.lam), *past])
        self._tail = s

    def _accept(self, step: AlphaStep) -> State:
        self._driven = False
        return super()._accept(step)

    def advance(self, h: float) -> State:
        """One step of size h (s), as :meth:`Stepper.advance`."""
        if not (self._first_march(h) if self.fresh else self._march(h, 1)):
            return super().advance(h)
        self._step_ended(self.driver.tables)
        return self.state

    def _first(self, rule: Rule) -> StepStart:
        """As :meth:`Stepper._first`, found once for a step that the driver gives back."""
        known = self._foretold
        if known is None or known[0] != rule.h or known[1] is not self.state:
            self._foretold = known = rule.h, self.state, super()._first(rule)
        return known[2]

    def _first_march(self, h: float, observers: Observers = UNOBSERVED) -> int:
        """The first step after a consistent start, as :meth:`Stepper._first` prepares it; 1, or 0 where it fails."""
        rule = self.scheme.rule(h)
        if self.damps and self._damped(rule) is not None:
            return 0
        try:
            start = self._predicted(rule)  # which factors the fields
        except BalanceError:  # who makes the step by itself meets it again
            return 0
        if not self._ready(h):
            return 0

        # the predictor of the driver is a line through two states: one before the start that leads to what was predicted
        s = start.state
        place = np.zeros(self.system.n_q)
        zero = np.zeros(self.system.n_v)
        before = (s.t - h, place, zero, 2 * s.a - start.a, zero, 2 * s.lam - start.lam)
        self.driver.load([(s.t, s.q, start.v, s.a, start.A, s.lam), before])
        self.fresh = not self._steps(h, 1, observers)
        self.driver.parameters[slots.HISTORY] = 1
        return 0 if self.fresh else 1

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Up to so many steps of size h (s) in one call, up to one that gains energy where that is judged; how many were made.
        Elements with a memory have that of the last step.
        """
        made = self._march(h, steps, observers)
        if made:
            self.driver.tables.remember()
        return made

    @property
    def is_driven(self) -> bool:
        """As :meth:`AlphaStepper.is_driven`."""
        return not self.fresh

    def controlled(self, h: float, steps: int, control: CompiledControl, observers: Observers) -> int:
        """:meth:`march` under error control, from a step of size h (s) on up to where Python has to look or a step fails."""
        if self.fresh or not self._ready(h) or self._is_refused(h):
            return 0
        made = self._steps(h, steps, observers, control)
        if made:
            self.driver.tables.remember()
        return made

    def _ready(self, h: float) -> bool:
        """Whether the driver can make steps of size h (s)."""
        return True

    def _march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """The same; the memory of elements may be that of a step before."""
        if self._is_refused(h):
            return 0

        # the first step after a consistent start begins with values of its own
        if self.fresh:
            made = self._first_march(h, observers)
            largest = self.local_error
            if not made or steps == 1 or (observers.tape is not None and observers.tape.ended):
                return made
            self.driver.tables.remember()  # what later steps begin with
            made += self._steps(h, steps - 1, observers)
            self.local_error = max(self.local_error, largest)
            return made

        return self._steps(h, steps, observers)

    def _steps(self, h: float, steps: int, observers: Observers, control: CompiledControl | None = None) -> int:
        """The same from the newest blocks."""
        # steps that NumPy made since are given to the driver
        if not self.fresh and self._tail is not self.state:
            self._load()
        driver, newton = self.driver, self.newton
        p = driver.parameters
        p[slots.EVENS] = not self.fresh
        driver.tables.c.renewals = newton.renewals
        factors = int(driver.tables.c.factors)
        # steps of one size close their joints or fail, and are judged where they are looked at
        observers = observers if control else replace(observers, joints=None)
        made, verdict = driver.march(h, steps, newton, observers, control)
        self.solver.core.factorisations += int(driver.tables.c.factors) - factors
        if made:
            self.size = p[slots.H] if control is None else control.c.size
            self._take(made)
        # not again from the same state with the same step: NumPy has it
        if verdict in (slots.NEWTON, slots.SINGULAR):
            self._refuse(h if control is None else control.c.tried)
        return made

    def tape(self, judged: Openness) -> Tape | None:
        """Room for records of :meth:`march`; ``judged``: how open joints are told."""
        driver = self.driver
        return driver.tape(judged) if on_the_way(driver.tables) else None

    def _take(self, made: int) -> None:
        """The newest state, and what the steps counted."""
        driver = self.driver
        p = driver.parameters
        self.counters["compiled_steps"] += made
        self._count_increments(p, made)
        self.newton.renewals = int(driver.tables.c.renewals)
        self.local_error = float(p[slots.LOCAL])
        self._ahead = self._driven = True
        self.state = self._tail = driver.state()
