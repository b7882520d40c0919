"""One run of a system: consistent start, march, and what is left of them. A system, once built, may make many runs."""

from __future__ import annotations

import resource
import sys
import time as clock
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import Stopped
from ..linear.condensation import StepSolver
from ..linear.redundancy import not_unique
from ..rotations import Array
from ..schemes.consistent import Correction
from ..schemes.newton import Newton
from ..system.element_memory import memories
from ..system.scene.plan import make_plan
from ..system.scene.scene import Scene
from .accuracy.companion_runs import Compared
from .built import Built, ConsistentStart
from .doubts import warn_of_doubts, warn_of_halvings
from .functions_of_time import warn_of_acceleration_jumps, warn_of_short_tables
from .judges.prescribed_motions import ending_at_kinks
from .judges.rank_advice import advise_on_ranks
from .judges.turning_rows import warn_of_turning_rows
from .loads_ahead import seeing_loads
from .problem import Problem, make_solver
from .recording.accompanied import Accompanied
from .recording.output import Output, refuse_too_many
from .recording.recorder import Recorder
from .result import Run
from .schedule import StepSchedule, warn_of_close_break_points, warn_of_dense_break_points, warn_of_late_samples
from .settings import check_times
from .time_loop import Marched, march

if TYPE_CHECKING:
    from .checkpoints.checkpoint import Checkpoint, Keeper


@dataclass(frozen=True)
class Task:
    """What a run is asked for; ``newton`` is its own, and counts. ``most_parts``, ``beside``: see :class:`.Problem`."""

    scene: Scene
    scheme: Any
    schedule: StepSchedule
    newton: Newton
    linear: Any
    output: Output
    most_parts: float | None = None
    beside: Output | None = None


@dataclass(frozen=True)
class Solved:
    """A run, and what further runs need that are compared with it."""

    run: Run
    problem: Problem
    compared: Compared


def run_once(
    task: Task, built: Built, *, checkpoint: Checkpoint | None = None, restart: str | Path | None = None
) -> Solved:
    """Consistent start and march of a system that may have made other runs before; collective."""
    if task.output.times is not None:
        check_times(task.output.times, (task.schedule.begin, task.schedule.t_end))
    refuse_too_many(task.output, built.system, task.schedule.t_end, task.schedule.steps)
    advise_on_ranks(built.system)

    begun = clock.perf_counter()
    # the solver is freed whatever happens: its factors are large
    solver = make_solver(task.scene, built.system, task.linear)
    try:
        with built.warned:
            found = built.start(task.scene, task.scheme, solver=solver, h=task.schedule.next(task.schedule.begin))
            schedule = ending_at_kinks(task.schedule, task.scene, built.system)
            schedule = seeing_loads(schedule, task.scheme, task.scene, built.system, found.state)
            task = replace(task, schedule=schedule)
            started = clock.perf_counter()
            problem = _problem(task, built, solver, found)
            keeps = checkpoint is not None or restart is not None
            keeper = _keeper(problem, task.schedule, task.output, checkpoint, restart) if keeps else None
            try:
                marched = march(problem, solver, task.schedule, task.output, keeper)
            finally:
                if keeper is not None:
                    keeper.close()
            times = begun, started, clock.perf_counter()
            counters = _counters(marched, task.newton, solver)
            _warn(task, problem, solver, marched, counters)
        run = _run(task, built, problem, found.correction, solver, marched, counters, times)
    finally:
        solver.destroy()

    if run.status == "stopped":
        raise Stopped(run) if keeper is None or keeper.exit_code is None else Stopped(run, keeper.exit_code)
    return Solved(run, problem, Compared(marched.recorder, task.schedule, task.scheme))


def _problem(task: Task, built: Built, solver: StepSolver, start: ConsistentStart) -> Problem:
    """What the march starts from."""
    return Problem(
        scene=task.scene,
        system=built.system,
        markers=built.markers,
        given=built.given,
        start=start.state,
        memories=start.memories,
        scheme=task.scheme,
        newton=task.newton,
        linear=task.linear,
        pressures=solver.pressures,
        warned=built.warned,
        most_parts=task.most_parts,
        beside=task.beside,
        books=task.output.ledger,
    )


def _warn(task: Task, problem: Problem, solver: StepSolver, marched: Marched, counters: dict[str, float]) -> None:
    """Of what a march leaves to doubt."""
    scene, schedule = task.scene, task.schedule
    first = schedule.next(schedule.begin)
    limit = problem.said.turn_limit
    ends = problem.start, marched.state
    equal = first if schedule.steps else 0.0

    warn_of_doubts(scene, solver, marched.recorder, counters, ends, equal, remembers=limit is not None)
    warn_of_late_samples(scene, schedule)
    warn_of_short_tables(scene, schedule.begin, schedule.t_end)
    if scene.breakpoints:
        warn_of_close_break_points(scene, schedule.t_end)
    warn_of_dense_break_points(schedule)
    if problem.said.carries_accelerations and problem.system.prescribes:
        warn_of_acceleration_jumps(problem.system, schedule)
    warn_of_turning_rows(solver, limit, ends, first)
    warn_of_halvings(counters)


def _run(
    task: Task,
    built: Built,
    problem: Problem,
    correction: Correction,
    solver: StepSolver,
    marched: Marched,
    counters: dict[str, float],
    times: tuple[float, float, float],
) -> Run:
    """The run as users see it. ``times``: of the clock when it began, when its start was found, and at its end, s."""
    recorder, system = marched.recorder, built.system
    return Run(
        scene=task.scene,
        scheme=task.scheme,
        plan=make_plan(task.scene, system, marched.path, solver.elastic.methods),
        system=system,
        state=marched.state,
        dt=(marched.state.t - task.schedule.begin) / max(marched.done, 1),
        times=recorder.times,
        series=recorder.series,
        energy=recorder.energy,
        books=recorder.bookkeeper.books if task.output.ledger else None,
        snapshots=recorder.snapshots,
        counters=counters,
        seconds=_seconds(built.seconds, marched, times),
        # how well it went
        drift=(recorder.drift.gap, recorder.drift.slip),
        correction=correction,
        local_error=marched.local_error,
        memory=_peak_memory(system.comm),
        newton_accuracy=problem.said.accuracy(task.newton),
        # what users should know
        status=marched.status,
        step_limit=task.schedule.largest,
        at_steps=_at_steps(recorder),
        not_unique=not_unique(solver, marched.state),
        warnings=built.warned.lines(),
        kept=tuple(memories(system)),
    )


def _at_steps(recorder: Recorder) -> tuple[Array, dict[str, Array]] | None:
    """Sensors at ends of steps beside records at given times."""
    if not isinstance(recorder, Accompanied) or not recorder.timed:
        return None
    return recorder.beside.times, recorder.beside.series


def _seconds(set_up: float, marched: Marched, times: tuple[float, float, float]) -> dict[str, float]:
    """Wall time of the phases of a run, with those before a restart, s."""
    (begun, started, ended), earlier, recording = times, marched.earlier, marched.recorder.seconds
    return {
        "set-up": set_up,
        "start": started - begun,
        "steps": ended - started + earlier - recording,
        "recording": recording,
        "total": set_up + ended - begun + earlier,
    }


def _keeper(
    problem: Problem, schedule: StepSchedule, output: Output, plan: Checkpoint | None, restart: str | Path | None
) -> Keeper:
    """Who writes the checkpoints of a run, and takes one up; loaded only when asked for."""
    from .checkpoints.checkpoint import Keeper
    from .checkpoints.fingerprint import given

    settings = {
        "scheme": problem.scheme,
        "Newton": problem.newton.settings,
        "linear": problem.linear,
        "step": schedule.fitting,
        "recorded": {"every": output.every, "energy": output.energy, "ledger": output.ledger},
    }
    return Keeper(plan, restart, problem.system, given(problem.scene, problem.system, settings))


def _counters(march: Marched, newton: Newton, solver: StepSolver) -> dict[str, float]:
    """Counts of a run; back-solves per step without those of the first one, which also solves the constant columns."""
    later = solver.elastic.back_solves - march.first
    return {
        **march.counters,
        "steps": march.done,
        "newton_iterations": newton.iterations,
        **solver.counters,
        "back_solves_per_step": later / (march.done - 1) if march.done > 1 else 0.0,
    }


def _peak_memory(comm: Any) -> float:
    """Peak resident memory of the largest rank, bytes; collective over ``comm`` (None: this process)."""
    own = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * (1.0 if sys.platform == "darwin" else 1024.0)
    return own if comm is None else max(comm.allgather(own))
