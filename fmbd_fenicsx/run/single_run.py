"""One run of a system: consistent start, march, and what is left of them. A system, once built, may make many runs."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import Stopped
from ..linear.condensation import StepSolver
from ..linear.redundancy import not_unique
from ..log import peak_memory
from ..schemes.newton import Newton
from ..system.scene.plan import make_plan
from ..system.scene.scene import Scene
from .built import Built
from .doubts import warn_of_doubts
from .estimates import Compared
from .output import Output, refuse_too_many
from .rank_advice import advise_on_ranks
from .result import Run
from .schedule import Pace
from .time_loop import March, Problem, begin, make_solver, march
from .turning_rows import warn_of_turning_rows

if TYPE_CHECKING:
    from .checkpoint import Checkpoint, Keeper


@dataclass(frozen=True)
class Task:
    """What a run is asked for; ``newton`` is its own, and counts."""

    scene: Scene
    scheme: Any
    pace: Pace
    newton: Newton
    linear: Any
    output: Output


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
    scene, scheme, pace, newton, output = task.scene, task.scheme, task.pace, task.newton, task.output
    system, warned = built.system, built.warned
    refuse_too_many(output, system, pace.t_end, pace.steps)
    advise_on_ranks(system)
    begun = clock.perf_counter()
    solver = make_solver(scene, system, task.linear)
    newton.refresh = solver.refresh
    keeper: Keeper | None = None
    try:
        with warned:
            start, correction = begin(scene, scheme, system, built.given, solver=solver, h=pace.next(0.0))
            started = clock.perf_counter()
            pressures = solver.pressures
            problem = Problem(
                scene, system, built.markers, built.given, start, scheme, newton, task.linear, pressures, warned
            )
            if checkpoint is not None or restart is not None:
                keeper = _keeper(problem, pace, output, checkpoint, restart)
            marched = march(problem, solver, pace, output, keeper)
            ended = clock.perf_counter()
            counters = _counters(marched, newton, solver)
            undetermined = not_unique(solver, marched.state)
            warn_of_doubts(scene, solver, marched.recorder, counters)
            warn_of_turning_rows(solver, scheme, (start, marched.state), pace.next(0.0))
    finally:
        solver.destroy()
        if keeper is not None:
            keeper.close()
    run = Run(
        scene=scene,
        scheme=scheme,
        plan=make_plan(scene, system, marched.path),
        system=system,
        state=marched.state,
        dt=marched.state.t / max(marched.done, 1),
        times=marched.recorder.times,
        series=marched.recorder.series,
        energy=marched.recorder.energy,
        books=marched.recorder.books if output.ledger else None,
        snapshots=marched.recorder.snapshots,
        counters=counters,
        seconds={
            "set-up": built.seconds,
            "start": started - begun,
            "steps": ended - started + marched.earlier - marched.recorder.seconds,
            "recording": marched.recorder.seconds,
            "total": built.seconds + ended - begun + marched.earlier,
        },
        drift=(marched.recorder.gap, marched.recorder.slip),
        correction=correction,
        local_error=marched.local_error,
        memory=peak_memory(system.comm),
        newton_accuracy=newton.accuracy,
        status=marched.status,
        not_unique=undetermined,
        warnings=warned.lines(),
    )
    if run.status == "stopped":
        raise Stopped(run) if keeper is None else Stopped(run, keeper.exit_code)
    return Solved(run, problem, Compared(marched.recorder, pace))


def _keeper(
    problem: Problem, pace: Pace, output: Output, plan: Checkpoint | None, restart: str | Path | None
) -> Keeper:
    """Who writes the checkpoints of a run, and takes one up; loaded only when asked for."""
    from .checkpoint import Keeper
    from .fingerprint import given

    newton = problem.newton
    settings = {
        "scheme": problem.scheme,
        "Newton": {n: getattr(newton, n) for n in ("tolerance", "max_iterations", "slow", "patience", "tangent")},
        "linear": problem.linear,
        "step": float(f"{pace.t_end / pace.steps:.12g}") if pace.steps else None,
        "recorded": {n: getattr(output, n) for n in ("every", "energy", "ledger")},
    }
    return Keeper(plan, restart, problem.system, given(problem.scene, problem.system, settings))


def _counters(march: March, newton: Newton, solver: StepSolver) -> dict[str, float]:
    """Counts of a run; back-solves per step without those of the first step, which also solves the constant
    columns.
    """
    later = solver.back_solves - march.first
    return {
        **march.counters,
        "steps": march.done,
        "newton_iterations": newton.iterations,
        "factorisations": solver.factorisations,
        "back_solves": solver.back_solves,
        "back_solves_per_step": later / (march.done - 1) if march.done > 1 else 0.0,
        "elastic_iterations": solver.elastic_iterations,
        "tie_iterations": solver.tie_iterations,
        "saddle_iterations": solver.saddle_iterations,
        "core_factorisations": solver.core.factorisations,
        "worst_linear_residual": solver.worst_residual,
    }
