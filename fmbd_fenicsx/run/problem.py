"""What a march needs: a consistent start, and from it the linear solver, the stepper and who judges its steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

from ..agreement import OneAnswer
from ..linear.condensation import StepSolver
from ..notices import Gathered
from ..rotations import Array
from ..schemes.consistent import Correction, behind_a_jump, consistent
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..schemes.stepping import TimeStepper, made_stepper
from ..system.compiled.choice import use_driver
from ..system.element_memory import reset
from ..system.layout import State
from ..system.scene.scene import Scene
from ..system.system import System
from .judges.acceptance import Closed
from .judges.energy_check import Guarded, Watch
from .judges.force_balance import Balanced
from .judges.forecast import Forecast
from .judges.given_velocities import look_at_given_velocities
from .recording.output import Output
from .schedule import StepSchedule
from .step_bisection import ConstantSteps, Judges

if TYPE_CHECKING:
    from ..schemes.own_marching import OwnMarch


@dataclass(frozen=True)
class Problem:
    """A consistent start and what a march from it needs."""

    scene: Scene
    system: System
    markers: dict[str, int]
    given: State
    start: State
    memories: list[Any]  # of elements, at the start
    scheme: Any
    newton: Newton
    linear: Any
    pressures: list[Array]  # that bodies carry as unknowns
    warned: Gathered | None = None  # the warnings of the run; None: it warns of nothing
    most_parts: float | None = None  # times that steps may be halved; None: as often as that helps
    beside: Output | None = None  # how sensors are recorded beside what the run is asked for
    books: bool = False  # whether works are recorded: powers of drives are read of multipliers

    @cached_property
    def said(self) -> Declared:
        """What the scheme says of itself."""
        return Declared.by(self.scheme)


def make_solver(scene: Scene, system: System, linear: Any) -> StepSolver:
    """The linear solver of a scene, with its own prefix of PETSc's options; collective."""
    return StepSolver(system, linear=linear, prefix=scene.name.replace(" ", "_") + "_")


def begin(
    scene: Scene, scheme: Any, system: System, given: State, *, solver: StepSolver, h: float
) -> tuple[State, Correction]:
    """The consistent start of a scheme from a state as given, with first steps of h (s); the memories of elements are those of
    the start then. Collective.
    """
    reset(system, given)
    system.evaluator.begin_anew()
    with OneAnswer(system.comm):
        start, correction = _begun(scene, scheme, system, given, solver=solver, h=h)
        moved = bool(correction.position or correction.velocity) and not scene.settle
        if system.keepers and moved:  # forces are those of memories of where bodies are
            reset(system, start)
            start, _ = _begun(scene, scheme, system, start, solver=solver, h=h)
    if scene.origin is None:  # joints that close in motion change velocities
        look_at_given_velocities(system, given, start, correction, settled=scene.settle)
    return start, correction


def _begun(
    scene: Scene, scheme: Any, system: System, given: State, *, solver: StepSolver, h: float
) -> tuple[State, Correction]:
    """See :func:`begin`."""
    if scene.settle:
        from ..analysis.statics.equilibrium import settled

        given = settled(system, given, solver)
    said = Declared.by(scheme)
    if said.start is not None:
        return said.start(system, given, solver, h)  # type: ignore[no-any-return]
    # steps with fields may need no evaluations: tables wait until someone asks for them
    if said.compiled and not system.fields:
        use_driver(system)
    return consistent(system, given, solver, h=h)


def judges_of(problem: Problem, solver: StepSolver, schedule: StepSchedule) -> Judges:
    """Who looks at the ends of the steps of a march."""
    return Judges(
        closed=Closed.under(problem.system, problem.said),
        balanced=Balanced.under(solver, problem.said, problem.newton.tolerance),
        forecast=Forecast(solver, problem.start.t, schedule.t_end, schedule.steps, largest=schedule.largest),
    )


def make_stepper(
    problem: Problem,
    solver: StepSolver,
    schedule: StepSchedule,
    judges: Judges,
    *,
    guarded: bool,
    before_sample: Callable[[State], None] | None = None,
) -> TimeStepper:
    """The stepper from the consistent start: constant steps in parts where that must be, under the energy guard where that makes
    sense. ``before_sample``: who is told before controllers sample at the end of a constant step.
    """
    system = problem.system
    start = problem.start
    solver.look_for_dependent_rows(system.at(start.t, start.q, start.v))
    made = _stepper_from(problem, solver, start)
    watch = Watch(system, made.state) if guarded else None
    # a scheme with error control makes its steps smaller by itself
    if schedule.given:
        cast("OwnMarch", made).take_given(schedule.given_sizes)
    if not schedule.steps:
        return made if watch is None else Guarded(made, watch)

    def renew(state: State, before: TimeStepper | None = None) -> TimeStepper:
        return _made_anew(problem, solver, before, state, schedule.next(state.t))

    goes_on = problem.said.start is not None or problem.said.free_steps
    renews = None if goes_on else renew
    return ConstantSteps(made, system, renews, watch, judges, most=problem.most_parts, before_sample=before_sample)


def _made_anew(problem: Problem, solver: StepSolver, before: TimeStepper | None, state: State, h: float) -> TimeStepper:
    """A stepper for steps of h (s) from the consistent state nearest to one at which forces jump, or that a failed step began
    with: the one ``before``, where it can begin anew. That of a failed step cannot.
    """
    problem.newton.theta = 0.5
    system = problem.system
    # tangents of a failed iteration are of no use; those of one that goes on are as good as without a jump
    if system.fields and before is None:
        ev = system.at(state.t, state.q, state.v)
        ev.forces = state.a, state.lam
        ev.take_tangents()

    if before is not None and problem.said.compiled:
        use_driver(system)  # each jump asks for evaluations
    if before is not None and before.begin_anew(lambda: behind_a_jump(system, state, solver, h=h)):
        return before
    return _stepper_from(problem, solver, consistent(system, state, solver, h=h)[0])


def _stepper_from(problem: Problem, solver: StepSolver, start: State) -> TimeStepper:
    """The scheme's own, from a consistent state."""
    gives_up = problem.most_parts == 0.0 and not problem.said.adaptive
    made = made_stepper(problem.scheme, problem.system, solver, problem.newton, start, gives_up=gives_up)
    read = [sensor.derivative for sensor in problem.scene.sensors.values()]
    made.recorded = 2 if problem.books else max(read, default=0)
    return made
