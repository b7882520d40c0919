"""Constant steps, made in parts where a whole one fails: one mechanism for all schemes.

A step whose Newton iteration or linear solve fails is made in two halves, these again in halves, down to 1/64. So is one that
gains energy from nothing (:mod:`.judges.energy_check`), down to 1/1024; later steps are then made in parts of that size as long
as something moves half as fast as there.
Steps that fail one after another are begun in halves: 1, 2, 4, ... of them, before the next one is tried whole.
Recorded states stay on the grid of whole steps. A scheme remembers accelerations, past values or predictors of one step size, so
before each change of size its worker is made anew from the consistent state nearest to the present one, as at the start of a run.
Workers of schemes whose rule holds for steps of any size go on as they are: with contact (its forces are their memory), RATTLE,
energy-momentum (which conserves).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ..errors import ConstraintError, ConvergenceError, FmbdError, LinearSolveError, PartsError, StabilityError
from ..log import log
from ..schemes.stepping import UNOBSERVED, Around, Observers, TimeStepper
from ..system.element_memory import accept, next_sample, sample, whole_steps
from ..system.evaluation import Evaluation
from ..system.evaluator import Glance
from ..system.layout import State
from ..system.serialisation import plain, worker
from ..system.system import System
from .judges.acceptance import Closed, diverged, finite_step
from .judges.energy_check import HALVINGS, Watch
from .judges.force_balance import Balanced
from .judges.forecast import Forecast

DEPTH = 6  # times that a step that fails may be halved
CALM = 0.5  # of the velocity at which a step gained energy, below which whole ones are tried again
OWN_STEPS = (
    " A scheme that chooses its steps, scheme=fmbd.Radau(3, rtol=1e-6), makes short ones where a motion is sharp."
)
AT_FIRST = 4  # halvings that may be any time, where only so many may be in all: others as steps go on


@dataclass(frozen=True)
class Judges:
    """Who looks at the ends of steps and parts: ``closed`` refuses open joints, ``balanced`` forces out of balance; ``forecast``
    counts.
    """

    closed: Closed
    balanced: Balanced | None
    forecast: Forecast

    def look(self, system: System, state: State, h: float, glance: Glance | None) -> Evaluation | None:
        """Refuse a state with open joints, or without balance after a step of size h (s). What a ``glance`` at it does not let
        pass is looked at closely: the system in the state then, collective.
        """
        seen, ev = None if glance is None else glance.of(state), None
        if seen is None or not self.closed.passes(seen, state.t):
            ev = system.at(state.t, state.q, state.v)
            self.closed.check(ev)
        balanced = self.balanced
        if balanced is None:
            return ev
        sums = None if glance is None else glance.sums
        if seen is None or sums is None or not balanced.passes(seen, sums, state.t, h):
            ev = ev or system.at(state.t, state.q, state.v)
            balanced.check(ev, state, h)
        return ev


class ConstantSteps(Around):
    """A stepper with constant steps, whole or in parts.

    ``renew`` makes a stepper from a state, or takes one that goes on behind a jump of forces; None: the stepper goes on with
    another size. ``watch``: the energy guard, if any.
    ``most``: times that steps and parts may be halved, None: as often as that helps. ``before_sample``: is told of a state in
    which controllers sample next.
    """

    keeps: ClassVar = {
        "stepper": worker,
        "watch": worker,
        **dict.fromkeys(
            ("halved", "whole", "fast", "failing", "_spell", "_rest", "_size", "local_error", "_past"), plain()
        ),
    }

    def __init__(
        self,
        stepper: TimeStepper,
        system: System,
        renew: Callable[..., TimeStepper] | None,
        watch: Watch | None,
        judges: Judges | None = None,
        *,
        most: float | None = None,
        before_sample: Callable[[State], None] | None = None,
    ) -> None:
        self.stepper, self.system, self.renew, self.watch = stepper, system, renew, watch
        self.most, self.parted = np.inf if most is None else most, 0
        self.judges, self.before_sample = judges, before_sample
        self.made = 0  # whole steps of the last call of :meth:`in_turn`
        # who evaluates the system, and who looks at its states in one call
        self._glance: tuple[Any, Glance | None] = None, None
        self._seen: Evaluation | None = None  # the system in the newest state, where it was looked at
        self.local_error = 0.0
        self.halved = 0  # steps and parts of steps that failed, or would have
        self.whole = 0  # halvings that every step gets since energy was gained
        self.fast = 0.0  # the largest velocity there, in units of the model's length, m/s
        self.failing = 0  # further ones that steps begin with, as those before failed without
        self._spell, self._rest = 0, 0  # steps that begin so after the next failure, and those still to come
        self._failed = False  # whether the newest step did, as it began
        self._size: float | None = None  # the stepper's last
        self._newest: tuple[State | None, State | None] = None, None  # the newest whole step, from and to
        self._past: dict[str, float] = {}  # counters of former steppers

    @property
    def evaluation(self) -> Evaluation | None:
        """At the newest state, where it was looked at."""
        found = self._seen if self.watch is None else self.watch.evaluation
        return None if found is None or found.q is not self.stepper.state.q else found

    @property
    def counters(self) -> dict[str, float]:
        """Those of the steppers, the steps made in halves and those taken back for their energy."""
        own = {**self._sum(), "halved_steps": self.halved}
        return own if self.watch is None else {**own, "energy_rejections": self.watch.rejections}

    @property
    def looks_at_each(self) -> bool:
        """Whether every state of :meth:`in_turn` is looked at."""
        return self.watch is not None or not self.stepper.compiled_whole

    @property
    def earlier(self) -> State | None:
        """Where the newest step began, one that :meth:`in_turn` has made too."""
        began, ended = self._newest
        return began if ended is self.stepper.state else self.stepper.earlier

    def _sum(self) -> dict[str, float]:
        found = self.stepper.counters
        return {k: found.get(k, 0.0) + self._past.get(k, 0.0) for k in {**self._past, **found}}

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Up to so many whole steps of size h (s) in one call; how many were made, 0 where :meth:`advance` has to."""
        # samples are taken by :meth:`advance`, or by :meth:`sample` behind the last step
        steps = int(min(steps, whole_steps(self.system, self.stepper.state.t, h) + observers.samples))
        if self._size not in (None, h) or steps <= 0 or not self.stride(h):
            return 0
        judges = self.judges
        seen = Observers(self.watch, None if judges is None else judges.closed, observers.tape)
        made = self.stepper.march(h, steps, seen)
        if made:
            self._size, self.local_error = h, max(self.local_error, self.stepper.local_error)
            if self.watch is not None:
                self.watch.time = self.stepper.state.t
            if judges is not None:
                judges.forecast.note(self.stepper.state, made)
        return made

    def sample(self) -> None:
        """Controllers that are due at the end of a :meth:`march` sample there; collective."""
        after = self.stepper.state
        if next_sample(self.system) > after.t:
            return
        self._foresee()
        if self.before_sample is not None:
            self.before_sample(after)
        sample(self.system, after)
        self._begin(after, goes_on=True)

    def stride(self, h: float) -> float:
        """That of the stepper; 0 where :meth:`advance` has to make all steps."""
        remembering = bool(self.system.keepers) and not self.stepper.keeps_memories
        return 0.0 if self._begins or remembering else self.stepper.stride(h)

    @property
    def _begins(self) -> int:
        """Halvings that the next step begins with."""
        return self.whole + self.failing

    def _foresee(self) -> None:
        """How many halvings the next step begins with, after whether the newest one failed with its own."""
        if self.whole and self.system.max_abs(self.stepper.state.v) < CALM * self.fast:
            self.whole -= 1
        if self._failed:
            if self._spell:  # not the first one in a row
                self.failing, self._rest = self.failing + 1, self._spell
            self._spell = max(2 * self._spell, 1)
        elif not self.failing:
            self._spell = 0
        else:
            self._rest -= 1
            if self._rest <= 0:
                self.failing -= 1
        self._failed = False

    def advance(self, h: float) -> State:
        """One step of size h (s), whole or in parts; collective.

        Raises ConvergenceError or LinearSolveError, that of the whole step, when its smallest parts fail too.
        """
        self.in_turn(h)
        return self.stepper.state

    def in_turn(
        self, h: float, most: int = 1, *, until: float = np.inf, ahead: Callable[[float], None] | None = None
    ) -> int:
        """Up to so many steps as :meth:`advance` makes them, one by one, ``until`` so late by the clock, or up to where many may
        be made in one call; how many. Collective.

        ``ahead``: looks at the end of each step, s, before it is made.
        """
        self.made, self.local_error = 0, 0.0
        with np.errstate(over="ignore", invalid="ignore"):
            while self.made < most:
                began, t = self.stepper.state, self.stepper.state.t + h
                if ahead is not None:
                    ahead(t)

                try:
                    self._advance(h, 0)
                except StabilityError:
                    raise
                except np.linalg.LinAlgError as error:  # of a part that begins, or is looked at
                    raise diverged(t - h, h, error) from error
                except (ConvergenceError, LinearSolveError) as error:
                    own = "" if self.system.contacts is not None else OWN_STEPS
                    raise type(error)(
                        f"{error} Parts of this step fail too, down to 1/{2 ** (self.whole + DEPTH)} of it.{own}"
                    ) from None
                if self.stepper.state.t != t:  # sums of halves round
                    self.stepper.state = replace(self.stepper.state, t=t)

                self._newest = began, self.stepper.state
                self._foresee()
                self.made += 1
                if clock.perf_counter() > until or (self.made < most and self.stepper.stride(h)):
                    break
        return self.made

    def _advance(self, h: float, depth: int) -> None:
        """One part of size h, 1/2^depth of the step."""
        if depth < self._begins:
            self.halved += depth >= self.whole
            return self._halves(h, depth)
        if self._size not in (None, h):
            self._begin(self.stepper.state)
        before, self._size = self.stepper.state, h

        try:
            after = finite_step(self.system, self.stepper, h)
            energies = self._look(after, h)
        except StabilityError:
            raise
        except (ConvergenceError, LinearSolveError) as error:
            return self._halves_of_failed(before, h, depth, error)

        # one that gains energy from nothing is made in halves, and so are later ones
        gain = None if self.watch is None else self.watch.gain(after, self._seen, energies)
        if self.watch is None or gain is None:
            return self._accept(after)
        self.whole, self.failing, self.fast = depth + 1, 0, self.system.max_abs(before.v)
        self.watch.count(before, gain, self.whole > HALVINGS)
        return self._halves(h, depth, before)

    def _halves_of_failed(self, before: State, h: float, depth: int, error: FmbdError) -> None:
        """A part that failed with an error, again in halves; where these fail too the error is raised."""
        if depth - self.whole == DEPTH:
            raise error
        if not self.halved and self.parted < self.most:
            log.warning("t = %g s: a step of h = %g s failed and is made in parts. %s", before.t, h, error)
        self.halved += 1
        self._failed = self._failed or depth == self._begins
        try:
            self._halves(h, depth, before)
        except StabilityError:
            raise
        except (ConvergenceError, LinearSolveError):
            raise error from None

    def _accept(self, after: State) -> None:
        """A part is done: it counts, and elements with a memory move on."""
        self.local_error = max(self.local_error, self.stepper.local_error)
        if self.judges is not None:
            self.judges.forecast.note(after)
        if not self.system.keepers or self.stepper.note():
            return
        if self.before_sample is not None and next_sample(self.system) <= after.t:
            self.before_sample(after)
        if accept(self.system, after):
            self._begin(after, goes_on=True)  # the past of the stepper is that of other forces

    def _look(self, state: State, h: float) -> Sequence[float] | None:
        """Refuse a state with open joints, or without balance after a step of size h (s); its energies, where they were told.

        Of compiled steps without a guard only some are, by the loop.
        """
        self._seen = None
        judges = self.judges
        if judges is None or not self.looks_at_each:
            return None
        evaluator, glance = self._glance
        if evaluator is not self.system.evaluator:
            glance = self._glance_of(judges)
        self._seen = judges.look(self.system, state, h, glance)
        return None if glance is None or self._seen is not None else glance.energies

    def _glance_of(self, judges: Judges) -> Glance | None:
        """Who looks at states in one call, where who evaluates the system can."""
        evaluator, glance = self.system.evaluator, None
        guarded, balance = self.watch is not None, judges.balanced is not None
        if guarded or balance or judges.closed.judging:
            glance = evaluator.glance(judges.closed.units, energies=guarded, balance=balance)
        self._glance = evaluator, glance
        return glance

    def _halves(self, h: float, depth: int, before: State | None = None) -> None:
        """A part of size h in halves, from the state ``before`` where it failed."""
        self.parted += 1
        if self.parted > self._allowed():
            t, whole = (before or self.stepper.state).t, h * 2**depth
            raise PartsError(
                f"t = {t:g} s: steps of {whole:g} s were halved {self.parted} times; smaller ones cost less."
            )
        if before is not None:
            self._begin(before)
        self._advance(0.5 * h, depth + 1)
        self._advance(0.5 * h, depth + 1)

    def _allowed(self) -> float:
        """How many halvings there may be up to now: a run whose steps fail from the start on does not make all of them."""
        if self.judges is None or not np.isfinite(self.most):
            return self.most
        forecast = self.judges.forecast
        return min(self.most, AT_FIRST + self.most * forecast.taken / max(forecast.planned, 1))

    def restart(self, t: float) -> None:
        """Go on at t, behind a jump of forces."""
        self._begin(replace(self.stepper.state, t=t), goes_on=True)

    def _begin(self, state: State, *, goes_on: bool = False) -> None:
        """A new stepper from a state; ``goes_on``: the one before serves, its steps did not fail."""
        if self.renew is None:
            # steps that remember nothing of forces; accelerations may be those before a jump
            if not (goes_on and self.stepper.begin_anew(lambda: state)):
                self.stepper.state = state
        else:
            before, counted, self._size = self.stepper, self._sum(), None
            try:
                self.stepper = self.renew(state, before) if goes_on else self.renew(state)
            except ConstraintError as error:
                raise ConvergenceError(
                    f"No step can begin from what parts of a step left: {error} Take a smaller dt."
                ) from None
            if self.stepper is not before:  # one that goes on counts on
                self._past = counted
