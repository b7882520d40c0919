"""What implicit schemes in local coordinates have in common: the equations of a step, their tangent, Newton's iteration and its
judge, the step control.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ...errors import BalanceError, CallbackError, ConvergenceError, LinearSolveError
from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...linear.residual import Judge
from ...log import log
from ...rotations import Array
from ...system.compiled.states.convergence import GOES_ON, Convergence
from ...system.compiled.states.stages import StageRule
from ...system.layout import State, States
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ...system.tangents.foretold_efforts import foretold_efforts
from ..consistent import MASS, arrived, corrected, project, worst_block
from ..consistent_states import all_corrected, metrics_of, projected
from ..control import FALLEN, ROUNDOFF, STAGNATION, Statistics, StepControl, first_step
from ..dae import Points
from ..declared import Declared
from ..error_norm import EPS, ErrorNorm
from ..newton import Newton
from ..prescribed_ways import time_for_way
from .convergence import CAUSES, Rates, judge_increment
from .implicit_march import ImplicitMarch
from .stage_iteration import StageIteration
from .step_equations import step_equations

OPEN = 1e-6  # of the model's length
FIRST_WAY = 0.5  # of what rtol lets a first step move, as first_step has it
SPELL = 63  # steps with tangents of their own, until one tangent is tried again
STILL = 16.0  # roundings of the model's length


class ImplicitStepper(ImplicitMarch):
    """Advances a consistent state by stages that Newton's iteration finds; :class:`.Radau` and :class:`.BDF` derive from it.

    ``what``: what is solved, for messages. ``lost``: measured, where motions begin to differ from those of rigid links.
    ``control``: of the step size, set by the scheme.
    """

    what: ClassVar[str]
    lost: ClassVar[float] = 3e-4  # share of the forces that the roundoff of a spring's effort may have
    control: StepControl
    keeps: ClassVar = {
        "state": Memory.state,
        **dict.fromkeys(("_fresh", "_full", "_spell", "_rest", "proposed", "local_error", "_theta"), plain()),
        "control": plain(StepControl),
        "stats": plain(Statistics),
        "norm": worker,
        "eq": worker,
    }

    def __init__(self, scheme: Any, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.scheme, self.system, self.solver, self.newton, self.state = scheme, system, solver, newton, state
        speed = system.max_abs(state.v)
        acceleration = max(speed * speed / system.length, system.max_abs(state.a))
        self.eq = step_equations(system, scheme.form, solver, acceleration)
        self.adaptive = scheme.rtol is not None
        self.norm = ErrorNorm(system, scheme.rtol or newton.tolerance, scheme.atol, scheme.form.index)
        self.stats = Statistics()
        self.judge = Judge(self.what)
        self.proposed: float | None = None
        self._allowed = 0.0  # m, what an increment of a constant step may move

        # the tangent is kept from step to step while Newton's iteration converges fast with it
        self._tangent: Any = None  # of the equations' own kind
        self._pencil: Any = None  # its factor
        self._fresh = False  # whether the tangent is that of this step
        self._full = False  # whether each iteration takes its own
        self._spell = self._rest = 0  # for how many constant steps, after the last failure and from now on
        self._theta = 1e-3  # rate of convergence
        self._unweighted = np.ones((3, system.n_v))
        self._roundoff = STILL * EPS * system.length  # m
        self._still = (
            False  # whether the last increment moved nothing beyond roundoff: multipliers may go on changing by theirs
        )
        if not self.eq.dense:
            self._warn_of_roundoff(acceleration)

    def _warn_of_roundoff(self, acceleration: float) -> None:
        """Say that a spring is too stiff for Newton's iteration with one tangent for several configurations."""
        name, lost = foretold_efforts(self.system).lost(self.state.q)
        system = self.system
        weight = system.mass * max(system.gravity.size, acceleration)
        if lost > self.lost * weight > 0:  # at rest without loads nothing can be lost
            log.warning(
                'the effort of spring "%s" is known to %.1e N only, by roundoff of places times its stiffness, where forces are '
                "of %.1e N: %s may lose the motion. Take fmbd.GeneralizedAlpha(), or fmbd.distance(...) in place of the spring",
                name, lost, weight, self.scheme.name,
            )  # fmt: skip

    def _begin_from(self, state: State) -> None:
        """A consistent state, without a past; equations, room and counts stay."""
        self.state, self.proposed, self._tangent = state, None, None
        self._full, self._spell, self._rest = False, 0, 0
        self.eq.weigh(state)

    def restart(self, t: float) -> None:
        """Forget the past: the solution has a kink at t. What drives have changed in velocities is an impact; accelerations and
        multipliers behind the kink are solved for.
        """
        self._begin_from(arrived(self.system, replace(self.state, t=t), self.solver, places=False))

    def begin_anew(self, start: Callable[[], State]) -> bool:
        """As :meth:`TimeStepper.begin_anew`."""
        self._begin_from(start())
        return True

    @property
    def counters(self) -> dict[str, float]:
        """Work so far, for the counters of a run."""
        eq, judge = self.eq, self.judge
        self.stats.residuals, self.stats.jacobians, self.stats.solves = eq.residuals, eq.jacobians, judge.solves
        return {**self.stats.as_dict(), **eq.counters}

    def _held(self, h: float, within: State) -> State:
        """A state within a step of h (s), see :meth:`_all_held`."""
        return self._all_held(np.array([h]), States.of([within])).state(0)

    def _all_held(self, h: Array, within: States) -> States:
        """States within steps of h (k,) s, on the constraints of the levels that the form holds at their ends; collective.

        What drives prescribe is no polynomial: places of a driven crank were off by a thousand times the error of the ends. Nor
        is the nearest state by the masses alone one of a stiff body, which has dents at its joints there.
        """
        levels = Declared.by(self.scheme).levels
        if 0 in levels and self.system.n_lam:
            closed = projected(self.system, within, self.solver, metrics_of(h, self._metric))
            within = closed if 1 in levels else replace(closed, v=within.v)
        if self._correctable:
            within = all_corrected(self.system, within, self.solver, metrics_of(h, self._step_metric))
        return within

    def _first_size(self, order: float, limit: float) -> float:
        """The size (s) that a run under error control begins with, of a method of this order; collective."""
        self.norm.update(self.state, self.to_come(limit))
        found = first_step(self.norm, self.state, order, limit)
        way = FIRST_WAY * self.norm.rtol ** (1.0 / order) * self.system.length
        return time_for_way(self.system, self.state, found, way)

    def _metric(self, h: float) -> Weights:
        """In which motions within a step of h (s) are least: that of a step, where bodies deform."""
        deforms = self.norm.deforming or self.system.elements
        return self._step_metric(h) if deforms else MASS

    def _step_metric(self, h: float) -> Weights:
        return self.eq.metric_of(h, self._solved_for(h))

    def _solved_for(self, h: float) -> Array:
        """The frequencies, (p,) in 1/s, that a step of h (s) was solved for; none where steps nearby have about the same."""
        return np.zeros(0)

    def _found(self, iterate: Callable[[], Points | str]) -> Points | str:
        """The stages that an iteration finds, or the cause of its failure."""
        try:
            found = iterate()
            if isinstance(found, str):
                self._note_open()
            return found
        except (LinearSolveError, np.linalg.LinAlgError):
            return "linear solve failed"
        except (CallbackError, ConvergenceError) as error:
            ran_away = isinstance(error, (BalanceError, ConvergenceError))
            if not (self.adaptive or ran_away):
                raise
            self.control.fault = str(error)
            return "forces not finite, or a motion out of range"

    def _with_new_tangent(self, find: Callable[[], Points | str]) -> Points | str:
        """What is found, once more with a tangent of this step where an older one has failed."""
        found = find()
        if isinstance(found, str) and (not self._fresh or self.eq.renew()):
            self._tangent = None
            self.eq.begin(self.state)
            found = find()
        return found

    def _begin_spell(self) -> None:
        """Tangents of their own for this constant step, and more if it was not long ago: stiff springs that turn ask for them in
        every step, friction that sticks in one.
        """
        self._full, self._tangent = True, None
        self._spell = self._rest = min(2 * self._spell + 1, SPELL)

    def _note_open(self) -> None:
        """Where an iteration has failed: the joint that it left open by more than a rounding of steps, for messages."""
        gaps = self.system.row_units * self.eq.left
        gap = float(np.abs(gaps).max(initial=0.0))
        if not gap > OPEN * self.system.length:
            return
        self.control.fault = (
            f"Newton left {worst_block(self.system, gaps)} open by {gap:.1e} {self.eq.form.unit} after t = {self.state.t:.6g} s: "
            "drives and joints may contradict each other there, or ask for more than bodies can reach."
        )

    def _failure(self, h: float, cause: str) -> ConvergenceError:
        """The error of a step of constant size h (s) whose iteration failed."""
        t = self.state.t + h
        return ConvergenceError(
            f"Newton's iteration failed at t = {t:.6g} s (h = {h:.3g} s): {cause}. "
            + (f"{self.control.fault} " if self.control.fault else "")
            + "Take a smaller dt."
        )

    # -- steps --------------------------------------------------------------------------------------------------
    def advance(self, h: float) -> State:
        """One accepted step. Constant steps: of size h. Error control: of at most h (s), which is then hit exactly at the end.

        Raises ConvergenceError when steps would have to be too small.
        """
        if self._step_in_one_call(h):
            return self.state
        return self._controlled(h) if self.adaptive else self._constant(h)

    def _constant(self, h: float) -> State:
        raise NotImplementedError

    def _controlled(self, limit: float) -> State:
        raise NotImplementedError

    def _ended(self, h: float, end: State, mult: Array) -> State:
        """The end of a step of size h (s) with multipliers (n_mult,), which is accepted; with ties and constraints closed."""
        self.stats.steps += 1
        self.control.fault = ""
        self._fresh = False
        if not self._full:
            self._spell = max(self._spell - 1, 0)
        elif self._rest:
            self._rest -= 1
            self._full = self._rest > 0
        end = self.eq.close_ties(h, end, mult)
        end = project(self.system, end, self.solver) if self.scheme.form.projected else end
        return corrected(self.system, end, self.solver, self._step_metric(h)) if self._corrects else end

    def _smallest(self, t: float, q: Array, mult: Array) -> Array:
        """Of the multipliers (n_mult,) with the same forces the smallest, level by level, so that predictions stay small."""
        shape = self.eq.levels, self.system.n_lam
        every = shape[0] * shape[1]
        levels = least(self.solver, t, q, mult[:every].reshape(shape))
        return np.concatenate((levels.ravel(), mult[every:]))

    @cached_property
    def _newton_tolerance(self) -> float:
        """Bound of the norm of the error left, in units of the error norm."""
        if not self.adaptive:
            return 1.0
        roundoff = 10 * EPS / self.norm.rtol
        return max(roundoff, min(0.03, self.norm.rtol**0.5))

    def _error_size(self, h: float, pencil: Any, e_q: Array, e_v: Array, e_a: Array | None = None) -> float:
        """Norm of errors like v; along ties velocities count by the places they lead to, as in index 3. ``pencil``: of a real
        frequency.
        """
        errors = np.array([e_v] if e_a is None else [e_v, e_a])
        held = self.eq.along_ties(pencil, errors)
        if not held.any():
            return self.norm(h, e_q, e_v, e_a)
        return max(self.norm(h, e_q, *(errors - held)), self.norm.mean(held[0] * (h / self.norm.wq)))

    def _size(self, h: float, dxi: Array, dv: Array, dmult: Array) -> float:
        """Norm of an increment of the stages, (s, ...) each; the largest over the stages."""
        push, size = self.eq.pushes(dmult), 0.0
        # pushes also where accelerations tell multipliers: those of several levels may change while places and velocities do not
        lengths = [0.0 if x is None else self.system.max_abs(x) for x in (dxi, dv, push)]
        if self.adaptive:
            # joints and ties apart, though they may cancel: what is left of either is noise of the next steps
            pulls = self.eq.pulls(dmult)
            size = self.norm(h, dxi, dv, push)
            if push is not None and self.scheme.form.index == 1:  # no part of an error, but of what is recorded
                size = max(size, self.norm.pushed(h, push))
            if pulls is not None:
                size = max(size, self.norm.mean(pulls * (h * h / self.norm.wq)))
        places, speeds, pushes = lengths
        moved = max(places, h * speeds)
        self._still = moved <= self._roundoff
        return size if self.adaptive else max(moved, h * h * pushes) / self._allowed

    def _iteration(self, h: float, t: Array, points: Points, rule: StageRule) -> StageIteration:
        """Newton's iteration for the points of a step of size h (s)."""
        self._allow(h)
        weights = self.norm.weights(h) if self.adaptive else self._unweighted
        return StageIteration(self.eq, t, points, rule, weights)

    def _allow(self, h: float) -> None:
        """Find what increments of a constant step of size h (s) may move."""
        if not self.adaptive:
            self._allowed = self.norm.constant(h, self.state)

    def _convergence(self, h: float, rates: Rates, first: float) -> Convergence:
        """Of an iteration in a step of h (s) of which nothing is done so far; ``first``: share that one increment leaves."""
        return Convergence(
            most=self.newton.max_iterations, adaptive=self.adaptive, h=h, allowed=self._allowed, still=self._roundoff,
            tolerance=self._newton_tolerance, limit=rates.limit, largest=rates.largest, before=rates.before,
            least=rates.least, averaged=rates.averaged, foresees=rates.foresees, calm=ROUNDOFF, stagnation=STAGNATION,
            fallen=FALLEN, first=first, theta=self._theta,
        )  # fmt: skip

    def _iterated(self, h: float, iteration: StageIteration, convergence: Convergence, until: int) -> str:
        """Increments up to number ``until`` of the iteration, or to its end; why it has failed, "" where it has not."""
        before = convergence.done
        try:
            iteration.follow(self._pencil, convergence, until)
            while convergence.outcome == GOES_ON and convergence.done < until:
                size = self._size(h, *iteration.increment(self._pencil))
                judge_increment(convergence, size, still=self._still)
        finally:
            self._count(convergence.done - before)
        self._theta = convergence.theta
        return CAUSES.get(convergence.outcome, "")

    def _count(self, increments: int) -> None:
        """So many increments more."""
        self.newton.iterations += increments
        self.stats.newton_iterations += increments
