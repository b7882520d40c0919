"""A march of a scheme from a consistent start to the end of a run, recorded on the way; one answer on all ranks."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ..errors import ConvergenceError
from ..linear.condensation import StepSolver
from ..log import StopRequests, log
from ..notices import Gathered
from ..ranks import OneAnswer
from ..rotations import Array
from ..schemes.consistent import Correction, consistent
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..schemes.stepping import TimeStepper, made_stepper
from ..system.element_memory import accept, reset
from ..system.evaluation import Evaluation
from ..system.scene.scene import Scene
from ..system.system import State, System
from .acceptance import Closed, attempt, attempt_in_balance
from .energy_check import Guarded, Watch, closed
from .force_balance import Balanced
from .forecast import Forecast
from .moment import Moment
from .output import Output, Progress, Recorder
from .prescribed_motions import PrescribedMotions
from .progress import Course
from .schedule import Pace
from .step_bisection import ConstantSteps

if TYPE_CHECKING:
    from .checkpoint import Keeper
    from .events import EventWatch


@dataclass(frozen=True)
class Problem:
    """A consistent start and what a march from it needs."""

    scene: Scene
    system: System
    markers: dict[str, int]
    given: State
    start: State
    scheme: Any
    newton: Newton
    linear: Any
    pressures: list[Array]  # that bodies carry as unknowns
    warned: Gathered | None = None  # the warnings of the run; None: it warns of nothing


@dataclass(frozen=True)
class March:
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


def make_solver(scene: Scene, system: System, linear: Any) -> StepSolver:
    """The linear solver of a scene, with its own prefix of PETSc's options; collective."""
    return StepSolver(system, linear=linear, prefix=scene.name.replace(" ", "_") + "_")


def begin(
    scene: Scene, scheme: Any, system: System, given: State, *, solver: StepSolver, h: float
) -> tuple[State, Correction]:
    """The consistent start of a scheme from a state as given, with first steps of h (s); collective."""
    reset(system, given)
    with OneAnswer(system.comm):
        return _begun(scene, scheme, system, given, solver=solver, h=h)


def _begun(
    scene: Scene, scheme: Any, system: System, given: State, *, solver: StepSolver, h: float
) -> tuple[State, Correction]:
    """See :func:`begin`."""
    if scene.settle:
        from ..analysis.equilibrium import settled

        given = settled(system, given, solver)
    said = Declared.by(scheme)
    if said.start is not None:
        return said.start(system, given, solver, h)  # type: ignore[no-any-return]
    if said.prepare is not None:
        said.prepare(solver)
    return consistent(system, given, solver, h=h)


def make_stepper(problem: Problem, solver: StepSolver, pace: Pace, *, guarded: bool) -> TimeStepper:
    """The scheme's worker from the consistent start: constant steps in parts where that must be, under the energy guard where
    that makes sense.
    """
    made = made_stepper(problem.scheme, problem.system, solver, problem.newton, problem.start)
    watch = Watch(problem.system, made.state, evaluation_of(solver, made.state)) if guarded else None

    def renew(state: State) -> TimeStepper:
        problem.newton.theta = 0.5
        if problem.system.fields:  # tangents of a failed iteration are of no use
            problem.system.at(state.t, state.q, state.v).balance(state.a, state.lam)
            for _, part in problem.system.fields:
                part.relinearise()
        start, _ = consistent(problem.system, state, solver, h=pace.next(0.0))
        return made_stepper(problem.scheme, problem.system, solver, problem.newton, start)

    if pace.steps:
        said = Declared.by(problem.scheme)
        goes_on = said.start is not None or said.free_steps
        return ConstantSteps(
            made,
            problem.system,
            None if goes_on else renew,
            watch,
            closed=replace(Closed.under(problem.system, problem.scheme), balanced=_balanced(problem, solver)),
            forecast=Forecast(solver, made.state.t, pace.t_end, pace.steps),
            at=solver.at,
        )
    return made if watch is None else Guarded(made, watch)


def evaluation_of(solver: StepSolver, state: State) -> Evaluation:
    """The system in a state."""
    return solver.at(state.t, state.q, state.v)


def _balanced(problem: Problem, solver: StepSolver) -> Balanced | None:
    """Who judges the forces at the ends of steps, if anybody."""
    return Balanced.under(solver, problem.scheme, problem.newton.tolerance)


def _look(balanced: Balanced | None, stepper: TimeStepper, h: float) -> None:
    """Refuse the newest state, after compiled steps of size h (s), where its forces are not in balance."""
    if balanced is not None and not balanced.solver.system.keepers:  # their memory is that of the state already
        state = stepper.state
        balanced.check(balanced.solver.at(state.t, state.q, state.v), state, h)


CHUNK = 0.1  # s: longer calls into compiled code would not hear of a request to stop


def quietly(stepper: TimeStepper, pace: Pace, recorder: Recorder, done: int, *, most: int) -> int:
    """How many steps, at most so many, were made in one call, where the stepper can: recorded on the way or up to a record."""
    t, h = stepper.state.t, pace.next(stepper.state.t)
    if recorder.output.on_step is not None or recorder.output.events:
        return 0
    tape = stepper.tape(recorder.openness) if recorder.on_tape else None
    quiet = recorder.quiet(done, t, h) if tape is None else recorder.free(t, h)
    steps = min(quiet, pace.steps - done, most)
    if steps == 1 and tape is None:
        return 0

    begin, made, chunk = clock.perf_counter(), 0, 64
    every = recorder.output.every
    while made < steps and clock.perf_counter() - begin < CHUNK:
        now = min(chunk, steps - made)
        if tape is not None:
            tape.begin(every, every - (done + made) % every)
            now = min(now, tape.capacity * every)
        now = stepper.march(h, now, tape=tape)
        if tape is not None and now:
            recorder.take_tape(tape.recorded(), done + made)
        made += now
        if not now:
            break
        chunk *= 4
    return made


def _events(problem: Problem, pace: Pace, output: Output, state: State) -> EventWatch | None:
    """Who looks for the events of a run; loaded only when asked for."""
    if not output.events:
        return None
    from .events import EventWatch

    watch = EventWatch(tuple(output.events), problem.scene, problem.system, problem.markers, samples=not pace.steps)
    watch.start(state)
    return watch


def _motions(problem: Problem, pace: Pace, t: float) -> PrescribedMotions | None:
    """Who looks whether prescribed motions make sense; None in runs that warn of nothing."""
    if problem.warned is None:
        return None
    motions = PrescribedMotions(problem.scene, problem.system, t, planned=pace.steps)
    if not pace.steps:
        motions.ahead(pace.t_end)
    return motions


def march(problem: Problem, solver: StepSolver, pace: Pace, output: Output, keeper: Keeper | None = None) -> March:
    """All steps from a consistent start, or from the checkpoint that the ``keeper`` takes up; collective."""
    reset(problem.system, problem.start)
    stepper = make_stepper(problem, solver, pace, guarded=output.energy and closed(problem.scene, problem.system))
    recorder = Recorder(problem.scene, problem.system, problem.markers, output, pace.t_end)
    recorder.closed, recorder.warned = Closed.under(problem.system, problem.scheme), problem.warned
    recorder.take(0, stepper.state, stepper.evaluation or evaluation_of(solver, stepper.state))
    course = Course(problem.system, solver, problem.newton, stepper, recorder)
    if keeper is not None:
        keeper.resume(course)
    state = stepper.state
    forecast = Forecast(solver, state.t, pace.t_end, pace.steps)
    motions, balanced = _motions(problem, pace, state.t), _balanced(problem, solver)
    events, ended = _events(problem, pace, output, state), False
    bar = Progress(problem.scene.name, pace.steps or None, output.progress)
    try:
        with OneAnswer(problem.system.comm), StopRequests() if keeper is None else keeper.listen() as stop:
            while not pace.ended(state.t, course.done):
                if motions is not None and pace.steps:
                    motions.look(state.t + pace.next(state.t))
                most = pace.steps if keeper is None else 1  # a checkpoint may be due after every step
                h = pace.next(state.t)
                made = quietly(stepper, pace, recorder, course.done, most=most) if pace.steps else 0
                seen = None
                if made:
                    _look(balanced, stepper, h)
                elif pace.steps:  # looked at where they may be made in parts
                    attempt(problem.system, stepper, h)
                else:
                    seen = attempt_in_balance(problem.system, stepper, h, balanced=balanced)
                state = stepper.state
                if motions is not None:
                    motions.look(state.t, made)
                if not pace.steps:  # constant steps note their parts one by one
                    accept(problem.system, state)
                    forecast.note(state)
                course.done += max(made, 1)
                course.local_error = max(course.local_error, stepper.local_error)
                met = None if events is None else events.look(course.done, state, stepper)
                if met is not None:
                    recorder.take_until(course.done, state, met, stepper)
                    state, ended = met, True
                    break
                recorder.take(course.done, state, seen or stepper.evaluation, stepper)
                if output.on_step is not None:
                    output.on_step(Moment(problem.scene, problem.system, problem.markers, state, course.done))
                bar.update(max(made, 1))
                course.first = course.first or solver.back_solves
                if (kink := pace.broken(state.t)) is not None:
                    stepper.restart(kink)
                    state = stepper.state
                if stop.asked if keeper is None else keeper.after_step(course, stop):
                    log.warning("stopped on request at t = %g s", state.t)
                    break
        if keeper is not None:
            keeper.write(course)
    except ConvergenceError as error:
        if motions is not None:
            motions.look(stepper.state.t)  # a contradiction between drives says more than the joint that it opens
        total = f" of {pace.steps}" if pace.steps else ""
        kept = "" if keeper is None or keeper.newest is None else f" The newest checkpoint is {keeper.newest}."
        raise type(error)(f'Scene "{problem.scene.name}", step {course.done + 1}{total}: {error}{kept}') from error
    finally:
        bar.close()
    return March(
        recorder=recorder,
        state=state,
        local_error=course.local_error,
        done=course.done,
        first=course.first,
        status="ended by an event" if ended else "finished" if pace.ended(state.t, course.done) else "stopped",
        counters=stepper.counters
        if balanced is None or not balanced.repeated
        else {**stepper.counters, "unbalanced_steps": balanced.repeated},
        path=stepper.path,
        earlier=course.earlier,
    )
