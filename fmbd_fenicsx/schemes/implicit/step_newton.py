"""Newton's iteration for the points of an implicit step: its tangent, which serves several steps, how increments are measured,
and when they are small enough. Where points begin, and by which rule they are coupled, a class of each scheme says.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...errors import BalanceError, CallbackError, ConvergenceError, LinearSolveError
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.declarations import constants
from ...system.compiled.states.convergence import CONVERGED, GOES_ON, TOO_SLOW, Convergence
from ...system.compiled.states.stages import StageRule
from ...system.layout import State
from ...system.serialisation import Remembering, plain
from ..consistent import worst_block
from ..control import FALLEN, ROUNDOFF, STAGNATION
from ..dae import Points
from ..error_norm import EPS, ErrorNorm
from ..newton import Newton
from .convergence import CAUSES, Rates, judge_increment

Increments = tuple[Array, Array, Array]  # of xi, v and of multipliers


class StageIteration:
    """Increments from predicted ``points`` at the times t (k,); ``equations`` of the step.

    What points leave of the equations is decoupled by the rule of the scheme, solved for frequency by frequency, and added:

        kin, low = residual(points),      z = pencil.solve(inverse kin, inverse low),      points += relax Re(vectors z)     (1)
    """

    def __init__(self, equations: Any, t: Array, points: Points, rule: StageRule) -> None:
        self.eq, self.t, self.points, self.rule = equations, t, points, rule

    def increment(self, pencil: Any) -> Increments:
        """Add one increment."""
        p, n = self.points, self.points.xi.shape[1]
        kin, low = self.eq.left_of(self.t, p, self.rule)
        change, mult = self._solved(pencil, kin, low)
        dxi, dv = change[:, :n], change[:, n:]
        couple = self.rule.couple
        self.eq.follow(dxi, self.rule)
        self.points = Points(p.xi + dxi, p.rate + couple @ dxi, p.v + dv, p.vd + couple @ dv, p.mult + mult)
        return dxi, dv, mult

    def creeps(self, pencil: Any, moved: Increments) -> bool:
        """Whether the last increment is one of a tangent with other slopes of laws."""
        return bool(self.eq.creeps(pencil.t, self.t, self.points, *moved[:2]))

    def _solved(self, pencil: Any, kin: Array, low: Array) -> tuple[Array, Array]:
        """(1): increments of xi and v side by side, and of the multipliers."""
        rule = self.rule
        change, mult = pencil.solve(rule.inverse @ kin, rule.inverse @ low)
        change, mult = (np.asarray((rule.vectors @ x).real) for x in (change, mult))
        return (change, mult) if rule.relax == 1.0 else (rule.relax * change, rule.relax * mult)


OPEN = 1e-6  # of the model's length
SPELL = 63  # steps with tangents of their own, until one tangent is tried again
(FALLS,) = constants(
    "implicit/stages.c", "FALLS"
)  # rate up to which an iteration goes on where laws are still to settle
STILL = 16.0  # roundings of the model's length


class StepNewton(Remembering):
    """Newton's iteration of a scheme, from step to step; ``settings``: what the user says of it, with the counters of a run.

    Attributes:
        tangent, pencil: the tangent in use, of the equations' own kind, and its factor, kept while the iteration converges fast.
        fresh: whether the tangent is that of this step.
        full: whether each iteration takes its own.
        spell, rest: for how many constant steps it does, after the last failure and from now on.
        theta: rate of convergence of the last step.
        fault: why it failed since the last accepted step, where more than the cause is known.
        still: whether the last increment moved nothing beyond roundoff: multipliers may go on changing by theirs.
        increments, factorisations: work so far.
    """

    what: ClassVar[str]  # is solved, for messages
    keeps: ClassVar = dict.fromkeys(
        ("fresh", "full", "spell", "rest", "theta", "fault", "increments", "factorisations"), plain()
    )

    def __init__(self, equations: Any, norm: ErrorNorm, settings: Newton, *, adaptive: bool) -> None:
        self.eq, self.norm, self.settings, self.adaptive = equations, norm, settings, adaptive
        self.system = system = norm.system
        self.judge = Judge(self.what)
        self.forget()
        self.pencil: Any = None
        self.fresh = self.still = False
        self.theta = 1e-3
        self.fault = ""
        self.increments = self.factorisations = 0

        self._allowed = 0.0  # m, what an increment of a constant step may move
        self._roundoff = STILL * EPS * system.length  # m

    # -- from step to step ----------------------------------------------------------------------------------------
    def forget(self) -> None:
        """Begin as if there were no steps before."""
        self.tangent: Any = None
        self.full, self.spell, self.rest = False, 0, 0

    def step_ended(self) -> None:
        """A step is accepted."""
        self.fault, self.fresh = "", False
        if not self.full:
            self.spell = max(self.spell - 1, 0)
        elif self.rest:
            self.rest -= 1
            self.full = self.rest > 0

    def steps_ended(self, count: int) -> None:
        """So many steps, made by compiled code, are accepted."""
        self.fault, self.fresh = "", False
        self.spell = max(self.spell - count, 0)

    def begin_spell(self) -> None:
        """Tangents of their own for this constant step, and more if it was not long ago: stiff springs that turn ask for them in
        every step, friction that sticks in one.
        """
        self.full, self.tangent = True, None
        self.spell = self.rest = min(2 * self.spell + 1, SPELL)

    def renews(self) -> bool:
        """Drop a tangent with which the iteration has failed; whether a new one may do better."""
        stale = self.tangent is not None and not self.fresh
        self.tangent = None
        return stale or self.eq.renew()

    # -- what is found ----------------------------------------------------------------------------------------------
    def found(self, state: State, iterate: Callable[[], Points | str]) -> Points | str:
        """The points that an iteration finds from a state on, or the cause of its failure."""
        try:
            found = iterate()
            if isinstance(found, str):
                self._note_open(state)
            return found
        except (LinearSolveError, np.linalg.LinAlgError):
            return "linear solve failed"
        except (CallbackError, ConvergenceError) as error:
            ran_away = isinstance(error, (BalanceError, ConvergenceError))
            if not (self.adaptive or ran_away):
                raise
            self.fault = str(error)
            return "forces not finite, or a motion out of range"

    def with_new_tangent(self, state: State, find: Callable[[], Points | str]) -> Points | str:
        """What is found from a state on, once more with a tangent of this step where an older one has failed."""
        found = find()
        if isinstance(found, str) and (not self.fresh or self.eq.renew()):
            self.tangent = None
            self.eq.begin(state)
            found = find()
        return found

    def _note_open(self, state: State) -> None:
        """Where an iteration has failed: the joint that it left open by more than a rounding of steps."""
        gaps = self.system.row_units * self.eq.left
        gap = float(np.abs(gaps).max(initial=0.0))
        if not gap > OPEN * self.system.length:
            return
        self.fault = (
            f"Newton left {worst_block(self.system, gaps)} open by {gap:.1e} {self.eq.form.unit} after t = {state.t:.6g} s: "
            "drives and joints may contradict each other there, or ask for more than bodies can reach."
        )

    def failure(self, t: float, h: float, cause: str) -> ConvergenceError:
        """The error of a step of constant size h (s) to t (s) whose iteration failed."""
        return ConvergenceError(
            f"Newton's iteration failed at t = {t:.6g} s (h = {h:.3g} s): {cause}. "
            + (f"{self.fault} " if self.fault else "")
            + "Take a smaller dt."
        )

    # -- increments ---------------------------------------------------------------------------------------------------
    @cached_property
    def tolerance(self) -> float:
        """Bound of the norm of the error left, in units of the error norm."""
        if not self.adaptive:
            return 1.0
        roundoff = 10 * EPS / self.norm.rtol
        return max(roundoff, min(0.03, self.norm.rtol**0.5))

    def allow(self, h: float, state: State) -> None:
        """Find what increments of a constant step of size h (s) from a state may move."""
        if not self.adaptive:
            self._allowed = self.norm.constant(h, state)

    def size(self, h: float, dxi: Array, dv: Array, dmult: Array) -> float:
        """Norm of an increment of the points, (k, ...) each; the largest of all points."""
        push, size = self.eq.pushes(dmult), 0.0
        # pushes also where accelerations tell multipliers: those of several levels may change while places and velocities do not
        lengths = [0.0 if x is None else self.system.max_abs(x) for x in (dxi, dv, push)]
        if self.adaptive:
            # joints and ties apart, though they may cancel: what is left of either is noise of the next steps
            pulls = self.eq.pulls(dmult)
            size = self.norm(h, dxi, dv, push)
            if push is not None and self.eq.form.index == 1:  # no part of an error, but of what is recorded
                size = max(size, self.norm.pushed(h, push))
            if pulls is not None:
                size = max(size, self.norm.mean(pulls * (h * h / self.norm.wq)))
        places, speeds, pushes = lengths
        moved = max(places, h * speeds)
        self.still = moved <= self._roundoff
        return size if self.adaptive else max(moved, h * h * pushes) / self._allowed

    def iteration(self, h: float, state: State, t: Array, points: Points, rule: StageRule) -> StageIteration:
        """The iteration for the points, at t (k,), of a step of size h (s) from a state."""
        self.allow(h, state)
        return StageIteration(self.eq, t, points, rule)

    def convergence(self, h: float, rates: Rates, first: float) -> Convergence:
        """Of an iteration in a step of h (s) of which nothing is done so far; ``first``: share that one increment leaves."""
        return Convergence(
            most=self.settings.max_iterations, adaptive=self.adaptive, h=h, allowed=self._allowed, still=self._roundoff,
            tolerance=self.tolerance, limit=rates.limit, largest=rates.largest, before=rates.before,
            least=rates.least, averaged=rates.averaged, foresees=rates.foresees, calm=ROUNDOFF, stagnation=STAGNATION,
            fallen=FALLEN, first=first, theta=self.theta,
        )  # fmt: skip

    def iterated(self, h: float, iteration: StageIteration, convergence: Convergence, until: int) -> str:
        """Increments up to number ``until`` of the iteration, or to its end; why it has failed, "" where it has not."""
        before = convergence.done
        try:
            while convergence.outcome == GOES_ON and convergence.done < until:
                moved = iteration.increment(self.pencil)
                judge_increment(convergence, self.size(h, *moved), still=self.still)
                if convergence.outcome == CONVERGED and iteration.creeps(self.pencil, moved):
                    falls = convergence.theta <= FALLS and convergence.done < convergence.most
                    convergence.outcome = GOES_ON if falls else TOO_SLOW
        finally:
            self.count(convergence.done - before)
        self.theta = convergence.theta
        return CAUSES.get(convergence.outcome, "")

    def count(self, increments: int) -> None:
        """So many increments more."""
        self.settings.iterations += increments
        self.increments += increments
