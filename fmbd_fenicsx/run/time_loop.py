"""A march of a scheme from a consistent start to the end of a run, recorded on the way; one answer on all ranks."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np

from ..agreement import OneAnswer
from ..errors import ConvergenceError, LinearSolveError
from ..linear.condensation import StepSolver
from ..log import log
from ..system.axial_forces import IN_RUNS, AxialForces
from ..system.bends import Bends
from ..system.element_memory import next_sample, restore
from ..system.evaluation import Evaluation
from ..system.layout import State
from ..system.scene.alike import values_of_inputs
from ..system.small_turns import HalfTurns, SmallTurns
from ..system.spins import Spins
from .checkpoints.progress import RunProgress
from .compiled_calls import CHUNK, CompiledCalls
from .judges.acceptance import accept_step, attempt_judged
from .judges.energy_check import closed
from .judges.forecast import out_of_reach
from .judges.prescribed_motions import PrescribedMotions
from .problem import Problem, judges_of, make_stepper
from .recording.moment import Moment
from .recording.output import MANY_STEPS, Output, judge_plan
from .recording.progress_bar import Progress
from .recording.recorder import Recorder
from .schedule import StepSchedule
from .step_bisection import ConstantSteps
from .stop_requests import StopRequests

if TYPE_CHECKING:
    from .checkpoints.checkpoint import Keeper
    from .recording.events import EventWatch


@dataclass(frozen=True)
class Marched:
    """What a march left: recorder, last state, largest local error, the first step's back-solves, the
    scheme's statistics, the seconds before a restart.
    """

    recorder: Recorder
    state: State
    local_error: float
    done: int
    first: int
    status: str
    counters: dict[str, float]
    path: str
    earlier: float


MOST = 10_000_000  # steps in one call
Watcher: TypeAlias = SmallTurns | HalfTurns | Spins | Bends | AxialForces


def _stride(watcher: Watcher, steps: int) -> int:
    """So many of all steps at most between two looks of a watcher: all where it has nothing to look at any more."""
    return max(steps // watcher.looks + 1, watcher.between) if watcher.bodies else steps


def _events(problem: Problem, schedule: StepSchedule, output: Output, state: State) -> EventWatch | None:
    """Who looks for the events of a run; loaded only when asked for."""
    if not output.events:
        return None
    from .recording.events import EventWatch

    watch = EventWatch(tuple(output.events), problem.scene, problem.system, problem.markers, samples=not schedule.steps)
    watch.start(state)
    return watch


def _motions(problem: Problem, schedule: StepSchedule, t: float) -> PrescribedMotions | None:
    """Who looks whether prescribed motions make sense; None where there are none, in runs that warn of nothing, and where a
    scheme chooses its steps: there all of a run is looked at before.
    """
    if problem.warned is None or not schedule.steps:
        return None
    motions = PrescribedMotions(problem.scene, problem.system, t, planned=schedule.steps)
    return motions if motions.followers else None


def march(
    problem: Problem, solver: StepSolver, schedule: StepSchedule, output: Output, keeper: Keeper | None = None
) -> Marched:
    """All steps from a consistent start, or from the checkpoint that the ``keeper`` takes up; collective."""
    restore(problem.system, problem.memories)
    loop = Loop(problem, solver, schedule, output, keeper)
    try:
        loop.run()
    except (ConvergenceError, LinearSolveError) as error:
        raise loop.named(error) from error
    finally:
        loop.bar.close()
    return loop.left()


class Loop:
    """A march under way: who makes its steps, who watches and records them. Methods are collective."""

    def __init__(
        self, problem: Problem, solver: StepSolver, schedule: StepSchedule, output: Output, keeper: Keeper | None = None
    ) -> None:
        self.problem, self.solver, self.schedule, self.output, self.keeper = problem, solver, schedule, output, keeper
        system = problem.system

        # who makes the steps, and who records them
        guarded = output.energy and closed(problem.scene, system)
        self.judges = judges_of(problem, solver, schedule)
        self.stepper = make_stepper(
            problem, solver, schedule, self.judges, guarded=guarded, before_sample=self._before_sample
        )
        self.recorder = self._recorder()
        self.progress = RunProgress(system, solver, problem.newton, self.stepper, self.recorder, self.judges.balanced)
        if keeper is not None:
            keeper.resume(self.progress)
        self.state = state = self.stepper.state

        # who watches
        self.judges.forecast.begin(state.t)
        self.motions = _motions(problem, schedule, state.t)
        watchers: list[Watcher] = []
        if problem.warned is not None and system.forces:
            watchers.append(HalfTurns(system))
        if problem.warned is not None and system.parts:
            spins = Spins(system)
            pulls = AxialForces(system, IN_RUNS, state.t, spins.told)
            watchers += [SmallTurns(system), spins, Bends(system), pulls]
        self.watchers = [watcher for watcher in watchers if watcher.bodies]
        self.events = _events(problem, schedule, output, state)
        self.event_met = False
        self._sampled = False  # whether controllers have sampled in the newest state
        self._inputs = values_of_inputs(problem.scene)

        self.calls = CompiledCalls(
            self.stepper,
            schedule,
            self.recorder,
            closed=self.judges.closed,
            refuses=self._refuses,
            events=self.events,
            steps=self.progress,
        )
        # whether somebody looks at every step, or ranks have to agree on how many they make
        self._shown = output.on_step is not None or self.events is not None
        self._shown = self._shown or (system.comm is not None and system.comm.size > 1)
        self.bar = Progress(problem.scene.name, schedule.steps or None, output.progress)

    def _recorder(self) -> Recorder:
        """Who records the march, with its start."""
        problem, first = self.problem, self.stepper.state
        steps = self.schedule.steps
        expected = steps // self.output.every + 2 if steps else 0
        recorder = Recorder(problem.scene, problem.system, problem.markers, self.output, self.schedule.t_end, expected)
        if problem.beside is not None:
            from .recording.accompanied import Accompanied

            recorder = Accompanied(recorder, problem.beside)
        recorder.drift.closed = self.judges.closed
        recorder.warned = problem.warned
        recorder.take(0, first, self.stepper.evaluation)
        if steps > MANY_STEPS:
            judge_plan(recorder, steps)
        return recorder

    # -- the loop ---------------------------------------------------------------------------------------------------
    def run(self) -> None:
        """Steps up to the end, to an event that ends the run, or to a request to stop."""
        keeper = self.keeper
        with OneAnswer(self.problem.system.comm), StopRequests() if keeper is None else keeper.listen() as stop:
            if self.watchers:
                self._look()
            while not self.schedule.ended(self.state.t, self.progress.done):
                made, seen = self._equal_steps() if self.schedule.steps else self._chosen_step()
                self._count(made)
                if self.watchers:
                    self._look()
                if self._ends_by_event():
                    break

                # records show the efforts of a sample with the accelerations under them
                if self._sampled:
                    self._pass_kink()
                self._record(made, seen)
                self._pass_kink()
                if stop.asked if keeper is None else keeper.after_step(self.progress, stop):
                    log.warning("stopped on request at t = %g s", self.state.t)
                    break
        # what goes on from steps behind an event would have passed it: one from before meets it again
        if keeper is not None and not self.event_met:
            keeper.write(self.progress)
        self._arrive()

    def _look(self) -> None:
        """Those who watch the bodies look at the newest state; collective."""
        for watcher in self.watchers:
            watcher.look(self.state)

    def _arrive(self) -> None:
        """The last of equal steps ends when the run does: times are sums of steps, which roundoff takes from there."""
        schedule, summed = self.schedule, self.state
        ended = schedule.steps and self.progress.done >= schedule.steps and not self.event_met
        if ended and summed.t != schedule.t_end:
            self.state = replace(summed, t=schedule.t_end)
            self.recorder.arrive(summed, self.state)

    def _equal_steps(self) -> tuple[int, Evaluation | None]:
        """Steps of one size, many in one call or one by itself; how many."""
        h = self.schedule.next(self.state.t)
        if self.motions is not None:
            self.motions.look(self.state.t + h)

        done, steps = self.progress.done, self.schedule.steps
        most = min([_stride(watcher, steps) for watcher in self.watchers] + [self._unkept(done)])
        made = self.calls.make(done, most)
        if made and self.calls.samples:
            cast(ConstantSteps, self.stepper).sample()
        if not made:
            look = self.calls.next_look(done)
            made = self._in_turn(h, 1 if self.stepper.stride(h) else min(most, look - done))
            if done + made == look and not cast(ConstantSteps, self.stepper).looks_at_each:
                self._refuses(h)

        self.state = self.stepper.state
        if self.motions is not None:
            self.motions.look(self.state.t, made)
        return made, None

    def _in_turn(self, h: float, most: int) -> int:
        """Steps of size h (s), at most so many, made one by one up to one that somebody wants to see; how many."""
        stepper, done = cast(ConstantSteps, self.stepper), self.progress.done
        if self._shown or (self.problem.system.fields and not self.progress.first):
            most = 1
        if most > 1:
            most = min(most, self.recorder.quiet(done, self.state.t, h), self.schedule.left(done))
        try:
            ahead = None if self.motions is None else self.motions.look
            return stepper.in_turn(h, most, until=clock.perf_counter() + CHUNK, ahead=ahead)
        except ConvergenceError:
            self.progress.done += stepper.made
            raise

    def _unkept(self, done: int) -> int:
        """Steps behind so many up to one after which a checkpoint may be due, it included."""
        return MOST if self.keeper is None else int(min(self.keeper.steps_left(done), MOST))

    def _chosen_step(self) -> tuple[int, Evaluation | None]:
        """Steps of sizes that the scheme chooses, many in one call or one by itself: how many, and the system in the new state,
        where it is known.
        """
        system = self.problem.system
        made = self.calls.make(self.progress.done, self._unkept(self.progress.done))
        if made:
            self.state = self.stepper.state
            self.judges.forecast.note(self.state, made)
            return made, None

        h = self.schedule.next(self.state.t)
        judges = self.judges
        seen = attempt_judged(system, self.stepper, h, closed=judges.closed, balanced=judges.balanced)

        self.state = self.stepper.state
        self.judges.forecast.note(self.state)

        # equal steps note their parts one by one
        if next_sample(system) <= self.state.t:
            self._before_sample(self.state)
        accept_step(system, self.stepper)
        return 1, None if self._sampled else seen

    def _before_sample(self, state: State) -> None:
        """Controllers sample in the state at the end of a step: values within it are those of the efforts up to now."""
        made = self.stepper.made if isinstance(self.stepper, ConstantSteps) else 0
        self.recorder.take_within(self.progress.done + made + 1, state, self.stepper)
        self._sampled = True

    def _refuses(self, h: float) -> bool:
        """Whether the newest state, after compiled steps, is to be taken back for want of balance: so are steps under error
        control. Equal ones, of size h (s), end the run.
        """
        balanced, stepper = self.judges.balanced, self.stepper
        # elements with a memory have that of the state already
        if balanced is None or self.problem.system.keepers:
            return False
        equal, state = self.schedule.steps, stepper.state
        seen = stepper.evaluation or self.problem.system.at(state.t, state.q, state.v)
        try:
            balanced.check(seen, state, h if equal else state.t - stepper.origin.t)
        except ConvergenceError:
            if equal:
                raise
            balanced.repeated += 1
            return True
        return False

    def _count(self, made: int) -> None:
        """So many steps more."""
        self.progress.done += made
        self.problem.system.refuse_changed_forms()
        self.progress.local_error = max(self.progress.local_error, self.stepper.local_error, self.calls.local_error)

    def _ends_by_event(self) -> bool:
        """Whether the newest step has met an event that ends the run, which is recorded then."""
        if self.events is None:
            return False
        told = self.recorder.told_of(self.state)
        met = self.events.look(self.progress.done, self.state, self.stepper, told)
        if met is None:
            return False
        self.recorder.take_until(self.progress.done, self.state, met, self.stepper)
        self.state, self.event_met = met, True
        return True

    def _record(self, made: int, seen: Evaluation | None) -> None:
        """Record the newest state where it is due, and show it to whom it concerns."""
        done = self.progress.done
        self.recorder.take(done, self.state, seen or self.stepper.evaluation, self.stepper)
        if self.output.on_step is not None:
            problem = self.problem
            told = self.recorder.told_of(self.state)
            self.output.on_step(Moment(problem.scene, problem.system, problem.markers, self.state, done, told))
        self.bar.update(made)
        if not self.progress.first and self.solver.system.fields:
            self.progress.first = self.solver.elastic.back_solves

    def _pass_kink(self) -> None:
        """Begin anew behind a break point, under own steps behind a sample, or where a function of the user's has set an input:
        where that has not been done.
        """
        t, sampled = self.state.t, self._sampled
        jumps = self.output.calls_back and self._set_inputs()
        kink = self.schedule.broken(t, self.progress.done) if self.schedule.stops else None
        if kink is None and (jumps or (sampled and not self.schedule.steps)):
            kink = t
        if kink is not None and (sampled or jumps or kink != t):
            self.stepper.restart(kink)
            self.state = self.stepper.state
            self.recorder.go_on(self.state)
        self._sampled = False

    def _set_inputs(self) -> bool:
        """Whether inputs have other values than when it was asked last."""
        before, self._inputs = self._inputs, values_of_inputs(self.problem.scene)
        return before != self._inputs

    # -- what is left -----------------------------------------------------------------------------------------------
    def named(self, error: ConvergenceError | LinearSolveError) -> ConvergenceError | LinearSolveError:
        """The error of a step that failed, with the scene, the number of the step and the newest checkpoint."""
        # a contradiction between drives says more than the joint that it opens
        if self.motions is not None:
            self.motions.look(self.stepper.state.t)

        why = out_of_reach(self.solver, self.problem.start, self.stepper.state)
        number, steps = self.progress.done + 1, self.schedule.steps
        if steps:  # the newest of many that were made in one call is refused, or the one behind those that count
            number = max(number, self.schedule.reached(self.stepper.state.t))
        step = f"step {number}" + (f" of {steps}" if steps else "")
        newest = None if self.keeper is None else self.keeper.newest
        kept = "" if newest is None else f" The newest checkpoint is {newest}."
        named = type(error)(f'Scene "{self.problem.scene.name}", {step}: {error}{why}{kept}')
        t = self.stepper.state.t
        named.halted = t, t / max(number - 1, 1)
        return named

    def left(self) -> Marched:
        """What the march has left."""
        progress = self.progress
        if self.problem.system.contacts is not None:
            self.recorder.struck = np.sort(self.stepper.struck)
        return Marched(
            recorder=self.recorder,
            state=self.stepper.told(self.state),
            local_error=progress.local_error,
            done=progress.done,
            first=progress.first,
            status=self._status(),
            counters=self._counters(),
            path=self.stepper.path,
            earlier=progress.earlier,
        )

    def _status(self) -> str:
        """How the march ended."""
        if self.event_met:
            return "ended by an event"
        if not self.schedule.ended(self.state.t, self.progress.done):
            return "stopped"
        if self.events is not None:
            self.events.tell_unmet(self.recorder.series)
        return "finished"

    def _counters(self) -> dict[str, float]:
        """Of the stepper, and how many steps were made again for open joints, or for want of balance."""
        judges = self.judges
        repeated = {
            "open_steps": judges.closed.repeated,
            "unbalanced_steps": judges.balanced and judges.balanced.repeated,
        }
        return {**self.stepper.counters, **{name: count for name, count in repeated.items() if count}}
