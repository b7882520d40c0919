"""Generalized-alpha with steps of its own choice: nested parts of the stretch to the next point that must be hit.

Two quantities of the scheme belong to a step size, and the order falls to one unless they change with it: velocities of the
index-3 form (:mod:`.size_change`), and, with r = h_new / h_old,

    A  <-  a + r (A - a),                     as  A_n = a(t_n + (alpha_m - alpha_f) h) + O(h^2)                        (1)

The error of a step is that of the positions, filtered by the matrix of the step, so that vibrations which the step damps do not
count:

    (M + s K) e + G^T mu = M h^2 (beta - 1/6) (A_n+1 - A_n),     G e = h/2 (G v + g_t)                                 (2)

Positions meet their constraints; what velocities miss them by, of order h^2, tells how far the motion within a step is from the
one that they prescribe. Without it a mechanism without freedom, all of whose places its drives give, took one step for three
turns. Rows on velocities hold no places, and velocities of the stabilised form miss nothing: across these e is as it were without
constraints, G e = h^2 (beta - 1/6) G (A_n+1 - A_n). The slopes of places miss the constraints by a higher order: with these for v
driven mechanisms took half the steps and had four times the error.

What dampers alone hold has no way back: where (2) lets a step of rigid bodies pass in which M h^2 (beta - 1/6) (A_n+1 - A_n) is
above the tolerance, M + s K without damping filters e. Behind the layer of a start A swings on for many steps, and steps that
grew faster than it fell moved a body by 7 cm that stands within 1e-12 s.

Stiffness of a law may end with the next step: a ball that meets a stop is thrown back by what (2) takes for a vibration of the
ball on the stop. Velocities, which (2) leaves out, tell it by what the trapezoidal rule misses of them, with a^ where the line
through the last two accelerations leads, h_- the step before, and K and M of the beginning and of the end of the step in turn:

    (M + s K) w + G^T mu = M h^2 / (6 (h + h_-)) (a_n+1 - a^),     G w = h^2 / (6 (h + h_-)) G (a_n+1 - a^)                (3)

of order h^3. What is stiff at one end only filters nothing, so that such a step becomes as small as the touch asks; within the
touch w falls again with steps that are far larger than its time alone. The norm of w is that of velocities over the largest so
far, where forces follow laws.

Memories of controllers go by the trapezoidal rule, and what that misses of them counts, too: behind a limit the motion has no
error, and its steps would grow over all that a memory does there.

Sources: Bruels and Arnold, doi:10.1115/1.2960475 (variable steps); Zienkiewicz and Xie, doi:10.1002/eqe.4290200907 (the
error); Shampine and Baca, doi:10.1145/357456.357462 (filters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ....errors import ConvergenceError, LinearSolveError
from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....rotations import Array
from ....system.compiled.declarations import constants
from ....system.element_memory import whole_steps
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.serialisation import plain, worker
from ....system.system import System
from ...consistent import behind_a_jump
from ...control import ESTIMATE, FADING, Statistics, StepControl, first_step, moves, turn_limit
from ...error_norm import NormOfWays, worst
from ...newton import Newton
from ...stepping import UNOBSERVED, Around, Observers, TimeStepper
from .look_ahead import LookAhead
from .quiet_times import CALM, QuietTimes
from .size_change import ResizedSteps, SizeChange
from .stretch import SAME, Stretch, parts

if TYPE_CHECKING:
    from .compiled_control import CompiledControl
    from .generalized_alpha import GeneralizedAlpha

KEPT = 9  # sets of elastic factors: those of eight sizes, and that of the whole stretch
KEEPS, KNOWN_FADES = constants("marches/control.c", "KEEPS", "KNOWN_FADES")


class VariableAlpha(Around):
    """Chooses the sizes of steps, and asks whether these pass; :class:`.size_change.ResizedSteps` makes them."""

    keeps: ClassVar = {
        "resized": worker,
        "norm": worker,
        "control": plain(StepControl),
        "stats": plain(Statistics),
        "stretch": worker,
        "quiet": worker,
        **dict.fromkeys(("proposed", "local_error", "error", "peak"), plain()),
    }

    def __init__(
        self, scheme: GeneralizedAlpha, system: System, solver: StepSolver, newton: Newton, state: State
    ) -> None:
        assert scheme.rtol is not None
        self.scheme, self.system, self.solver, self.newton = scheme, system, solver, newton
        self.constant = replace(scheme, rtol=None, atol=None)

        self.norm = NormOfWays(state, system, scheme.rtol, scheme.atol, 3)
        self.stretch = Stretch()
        self.laws = any(loads.follows_laws for loads in system.forces)
        self.drags = bool(system.forces or system.elements) and not system.fields  # with no stiffness beside
        self.look = LookAhead(system, solver, self.norm, self._weights)
        self.quiet = QuietTimes(self.look)
        bends = bool(self.norm.deforming or system.elements)
        change = SizeChange(system, solver, self.stretch, self._weights, bends)
        self.stepper: Any = self._steps(state)
        self.resized = ResizedSteps(self.stepper, change)
        self.control = StepControl(3.0)
        self.stats = Statistics()
        self.local_error = self.error = 0.0  # the largest since :meth:`advance`, and that of the newest step
        self.peak = 0.0  # the largest error of late
        self._compiled: CompiledControl | None = None
        self._given: Array = np.zeros(0)  # where steps that are given end, s

        self.proposed: float | None = None
        self._seen: tuple[State, Evaluation] | None = None

        # sizes come back: factors of the last few are kept
        solver.elastic.kept = max(solver.elastic.kept, KEPT)

    def _weights(self, h: float) -> Weights:
        """Those of a step of size h (s)."""
        return self.scheme.rule(h).weights

    def _steps(self, start: State) -> Any:
        """The stepper of one size from a consistent state; errors are solved for between its steps."""
        made = self.constant.steps((self.constant, self.system, self.solver, self.newton, start), alone=False)
        made.damps = False  # they are refused until they resolve what happens
        return made

    @property
    def evaluation(self) -> Evaluation | None:
        """The system in the newest state; None where elements have a memory, which moves on later."""
        s = self.state
        if self.system.keepers:
            return None
        if self._seen is None or self._seen[0] is not s:
            self._seen = s, self.system.at(s.t, s.q, s.v)
        return self._seen[1]

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, rejections by their cause."""
        counted = {"steps", "rejections"} | {f"rejected: {cause}" for cause in self.stats.rejected}
        own = {k: x for k, x in self.stats.as_dict().items() if k in counted}
        return {**self.stepper.counters, **own}

    def restart(self, t: float) -> None:
        """Go on behind a jump of forces: consistent accelerations and multipliers, a new stretch, small steps at first."""
        here, h = replace(self.state, t=t), self.resized.size or 0.0
        self.stepper.begin_anew(lambda: behind_a_jump(self.system, here, self.solver, h=h))
        self.resized.size = self.proposed = None
        self.stretch.forget()
        self.control.h_old = self.peak = 0.0

    def take_given(self, sizes: Array) -> None:
        """As :meth:`.OwnMarch.take_given`: each of these steps is a stretch of its own."""
        self.control.given = self.passes_marks = True

    def bound(self, longest: float, ends: Sequence[float], last: float = np.inf) -> None:
        """As :meth:`TimeStepper.bound`; given steps go on up to where their size changes."""
        if self.control.given:
            self._given = np.array((self.state.t, *ends))
            sizes = np.diff(self._given)
            alike = int(np.argmin(np.append(np.abs(sizes - sizes[0]) <= SAME * sizes[0], False)))
            ends = (ends[alike - 1],)
            longest = (ends[0] - self.state.t) / alike
        TimeStepper.bound(self, longest, ends, last)

    # -- one accepted step --------------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One accepted step of at most h (s), which is hit exactly at the end of the stretch; collective.

        Raises ConvergenceError when steps would have to be too small.
        """
        s = self.state
        if self.control.given:
            self.stretch.forget()
        self.stretch.follow(s.t, h)
        self.control.span = max(self.control.span, h)
        if self.proposed is None:
            self.norm.look_ahead(s, h)
            with self.norm.looking():  # h is the rest of the run: what would be reached by then is no measure
                self.norm.update(s, h)
                self.proposed = first_step(self.norm, s, 3.0, h)

        while True:
            level = self._chosen(self.control.proposal(self.proposed, h))
            h = self.stretch.size(level)
            error, cause = self._attempt(h, level)
            if error <= 1.0:
                self.solver.near_singular.accept_trial()
                break
            self.proposed = self._refused(h, error, cause)

        self.local_error, self.peak = error, max(error, FADING * self.peak)
        self._count(h, error)
        self.stretch.go_on(level)
        return self.state

    def _chosen(self, proposed: float) -> int:
        """The level of the next step, of at most a proposed size (s): what drives and loads do within it lets it be tried;
        collective.
        """
        s = self.state
        while True:
            self.proposed = proposed
            level = self.stretch.coarsest(min(proposed, turn_limit(self.system, s)), s.t)
            h = self.stretch.size(level)
            moves(s.t, h)
            if self.solver.elastic.hides_masses(self._weights(h)):
                self.stretch.lose(h, s.t)
                continue
            self.solver.near_singular.begin_trial()
            if self.control.given or self.quiet.holds(s.t, h, self.peak):
                return level

            farthest = self.look.farthest(s, h)
            if farthest < h:
                proposed = farthest
                continue
            try:
                error, cause = self.quiet.error(s, h, self.until), "a load within the step"
            except LinearSolveError as failure:
                error, cause = np.inf, self._losing(h, failure)
            if error <= 1.0:
                return level
            proposed = self._refused(h, error, cause)

    def _refused(self, h: float, error: float, cause: str) -> float:
        """The size (s) that is proposed behind a step of size h that is refused."""
        self.stats.rejected[cause] += 1
        return min(self.control.rejected(self.state.t, h, error, cause), 0.9 * h)

    def _count(self, h: float, error: float) -> None:
        """An accepted step of size h (s), and its error."""
        self.stats.steps += 1
        self.norm.foretold *= KNOWN_FADES
        self.error, self.proposed = error, self.control.accepted(h, error)
        # errors of vibrations pass through zero: no sign that larger steps will do
        if self.proposed > h:
            self.proposed = max(h, min(self.proposed, self.control.largest(h, self.peak)))
        if KEEPS * h <= self.proposed < h:  # the next smaller size is a half or a third
            self.proposed = h

    def _losing(self, h: float, failure: LinearSolveError) -> str:
        """A step of size h (s) in which M is lost beside s K, and with it the motion of a free body: how that is counted."""
        self.control.fault = str(failure)
        self.stretch.lose(h, self.state.t)
        return "linear solve failed"

    # -- many steps in compiled code ------------------------------------------------------------------------------------
    def stride(self, h: float) -> float:
        """Size (s) of the steps that :meth:`march` makes next, where h is the most; 0 where :meth:`advance` has to."""
        level = self._next_level(h)
        return 0.0 if level is None else self.stretch.size(level)

    def _next_level(self, h: float) -> int | None:
        """The parts of the stretch that these steps are; None where there are none."""
        s = self.state
        self.stretch.follow(s.t, min(h, self.longest))
        if self.proposed is None or self.resized.size is None or not (self._marches and self.stepper.is_driven):
            return None
        proposed = self.control.proposal(self.proposed, h)
        level = self.stretch.coarsest(min(proposed, turn_limit(self.system, s)), s.t)
        return level if whole_steps(self.system, s.t, self.stretch.size(level)) > 0 else None

    @property
    def _marches(self) -> bool:
        """Whether compiled code knows all memories."""
        return bool(self.stepper.keeps_memories) or not self.system.keepers

    def march(self, h: float, steps: int, observers: Observers = UNOBSERVED) -> int:
        """Up to so many accepted steps, each at most h (s), in one call of compiled code, as :meth:`advance` makes them; fewer
        where Python has to look at what comes, or a step fails.
        """
        if self._next_level(h) is None:
            return 0
        assert self.proposed is not None
        level = self._chosen(self.control.proposal(self.proposed, h))
        size = self.stretch.size(level)
        steps = int(min(steps, whole_steps(self.system, self.state.t, size)))
        if steps <= 0:
            return 0

        control, kept = self._control(), self.resized.held
        resized = size != self.resized.size and not control.resizes
        try:
            if resized:
                self.resized.resize(size)
                self.resized.size, steps = size, 1
        except LinearSolveError:
            self.resized.held = kept
            return 0

        control.lend(self.stretch, level, self.quiet, until=self.until, last=self.last)
        c = control.c
        c.proposed, c.size, c.error, c.peak = self.proposed, self.resized.size, self.error, self.peak
        made: int = self.stepper.controlled(size, steps, control, observers)
        control.take(self.stretch, self.state.t)
        if self.control.given:  # sums of many steps are off by their roundoff
            self.resized.arrive(float(self._given[np.abs(self._given - self.state.t).argmin()]))
        self.proposed, self.resized.size, self.error, self.peak = c.proposed, c.size, c.error, c.peak
        self.local_error = max(self.local_error, c.largest)
        self.stats.steps += made
        if c.refusals:
            self.stats.rejected[ESTIMATE] += c.refusals
        if made:
            self.solver.near_singular.accept_trial()
        elif resized:
            self.resized.held, self.newton.theta = kept, 0.5
        return made

    def _control(self) -> CompiledControl:
        """What lends the controller to compiled code."""
        if self._compiled is None:
            from .compiled_control import CompiledControl

            of = {"laws": self.laws, "drags": self.drags, "bends": self.resized.change.bends}
            self._compiled = CompiledControl(self.norm, self.control, **of)
        return self._compiled

    def step_back(self) -> None:
        """Go back to the beginning of the newest step, from where smaller ones begin anew."""
        before = self.stepper.begun[0]
        self.state = before
        self.restart(before.t)

    # -- attempts -----------------------------------------------------------------------------------------------------
    def _attempt(self, h: float, level: int) -> tuple[float, str]:
        """A step of size h, one of the parts of a level, and its error; where this is above one, the stepper is as before."""
        kept, largest = self.resized.held, self.norm.largest
        try:
            self.resized.step(h)
            error, cause = 0.0, ESTIMATE
            if not self.control.given:
                error = worst(self._error(h), self.norm.of_trapezoids(self.state))
            self.resized.arrive(self.stretch.time(self.stretch.done + Fraction(1, parts(level))))
        except LinearSolveError as failure:
            error, cause = np.inf, self._losing(h, failure)
        except ConvergenceError as failure:
            error, cause = np.inf, "Newton's iteration"
            self.control.fault = str(failure)
        except np.linalg.LinAlgError:
            error, cause = np.inf, "an iteration that diverged"

        # also where the error is no number
        if not error <= 1.0:
            self.resized.held, self.newton.theta = kept, 0.5
            self.norm.take_back(largest, error)
        return error, cause

    def _error(self, h: float) -> float:
        """The norm of (2), or that of (3) where it is larger."""
        e = self.stepper.error(h)
        self.norm.update(self.state, h)  # the way of this step counts
        still = np.zeros_like(e)
        error = self.norm(h, e, still)
        if self.drags and error <= 1.0 and self.norm(h, self.stepper.unfiltered(h), still) > 1.0:
            error = self.norm(h, self.stepper.error(h, replace(self._weights(h), cd=0.0)), still)
        missed = self.stepper.missed_speeds(h) if self.laws and error <= 1.0 else None
        if missed is None or self.norm.of_speeds(h, missed) <= max(error, CALM):
            return error  # less is what Newton's iteration leaves of accelerations
        ends = self.stepper.begun[0], self.state
        return worst(error, *(self.norm.of_speeds(h, self.stepper.filtered(h, missed, s)) for s in ends))
