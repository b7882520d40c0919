"""Runs that only tell an error of another one: with other steps, another tolerance, in finer spaces, with more modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from ...errors import ConvergenceError, InputError, LinearSolveError
from ...schemes.newton import Newton
from ...system.scene.scene import Scene
from ..built import Built
from ..problem import Problem, make_solver
from ..recording.output import Output
from ..recording.recorder import Recorder
from ..schedule import StepSchedule, sampled_late
from ..time_loop import Marched, march
from .certificate import struck_or_sampled

# of runs that only tell an error: with larger steps forces may have no value
UNFIT = (ConvergenceError, LinearSolveError, InputError)


class StoppedError(ConvergenceError):
    """A run that only tells an error was stopped on request: no other one is made in its place."""


@dataclass(frozen=True)
class Compared:
    """A run of the scene as it stands, its steps and its scheme: what runs in finer spaces or by more modes are compared with."""

    recorder: Recorder
    schedule: StepSchedule
    scheme: Any

    @property
    def steps(self) -> int:
        """How many it was to take, or took where the scheme chose them."""
        schedule = self.schedule
        if schedule.given:
            return len(schedule.marks) + len(schedule.stops) + 1
        return schedule.steps or int(self.recorder.indices[-1])


def again(
    problem: Problem, schedule: StepSchedule, steps: int, times: Sequence[float] | None, *, whole: bool = True
) -> Compared:
    """The march once more with another number of steps, sensors recorded in every step or at the ``times``; ``whole``: it ends
    where one of them would be made in parts; collective.

    Raises ConvergenceError where steps take samples of a controller late that those of the schedule take in time.
    """
    wanted, other = Output(energy=False, progress=False, times=times), schedule.with_steps(steps)
    late = sampled_late(problem.scene, other)
    if late and not sampled_late(problem.scene, schedule):
        raise ConvergenceError(f'steps of {other.next(0.0):g} s take the samples of controller "{late[0]}" late')
    asked = replace(problem, most_parts=0.0) if whole else problem
    beside = steps_beside(problem.scene, wanted, other)  # where kinks are seen
    return Compared(companion(asked, other, wanted, beside=beside).recorder, other, problem.scheme)


def unbegun(scene: Scene, built: Built, scheme: Any, *, newton: Newton, linear: Any, parts: float) -> Problem:
    """What a run needs that only tells an error, but for its start; its steps may be halved so many times (``parts``)."""
    return Problem(
        scene=scene,
        system=built.system,
        markers=built.markers,
        given=built.given,
        start=built.given,
        memories=[],
        scheme=scheme,
        newton=newton,
        linear=linear,
        pressures=[],
        most_parts=parts,
    )


def companion(
    problem: Problem, schedule: StepSchedule, output: Output, of: Built | None = None, *, beside: Output | None = None
) -> Marched:
    """A march that only tells an error, with an iteration and a solver of its own, warning of nothing: from the start of the
    problem, or from that ``of`` another system; recorded ``beside``, too; collective.

    Raises StoppedError where it was stopped on request.
    """
    system = problem.system if of is None else of.system
    solver = make_solver(problem.scene, system, problem.linear)
    try:
        if of is None:
            solver.pressures = problem.pressures
            system.evaluator.begin_anew()
        else:
            begun = of.start(problem.scene, problem.scheme, solver=solver, h=schedule.next(0.0))
            problem = replace(
                problem, system=system, markers=of.markers, given=of.given, start=begun.state, memories=begun.memories
            )

        newton, pressures = problem.newton.afresh(), solver.pressures
        made = replace(problem, newton=newton, pressures=pressures, warned=None, beside=beside)
        marched = march(made, solver, schedule, output)
    finally:
        solver.destroy()
    if marched.status != "finished":
        raise StoppedError(f"stopped at t = {marched.state.t:g} s")
    return marched


def steps_beside(scene: Scene, output: Output, schedule: StepSchedule) -> Output | None:
    """Sensors at ends of equal steps, beside records at given times: they tell of jumps within steps."""
    at_times = output.times is not None and schedule.steps and not struck_or_sampled(scene)
    return Output(every=output.every, energy=False, progress=False) if at_times else None


def as_recorded(coarse: Recorder, schedule: StepSchedule) -> Output:
    """Sensors at the instants of another run with the same steps, and nothing else."""
    wanted = replace(coarse.output, snapshots=0, energy=False, ledger=False, progress=False, on_step=None, events=())
    return wanted if schedule.steps else replace(wanted, times=tuple(coarse.times))
