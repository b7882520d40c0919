"""A run that keeps a tolerance: steps, modes and meshes are refined until the run states errors below it.

Every attempt is a whole run with its estimates. From its certificate follows what is too large, and by how much: the step from
the order that was seen, modes and meshes one level at a time (:mod:`.next_attempt`). Errors by modes and meshes change little
with the step, so they are estimated again only when bodies have changed; runs with larger steps, and systems, serve all attempts
(:mod:`.shared_runs`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..checks import number
from ..errors import ConvergenceError, LinearSolveError
from ..log import log
from ..schemes.declared import Declared
from ..system.scene.refinement import meshed_bodies, modal_bodies
from ..system.scene.scene import Scene
from .estimates import Compared, TimeError, reduction_error, tolerance_error
from .ledger import Books
from .next_attempt import Looked, Plan, finer_steps, next_plan, space_first
from .output import Output
from .result import Run
from .schedule import Pace, pace_of
from .settings import check_tangent, checked_scheme
from .shared_runs import Orders, SharedRuns
from .shares import Relative, Tolerance, check_tolerances, relative, safe, worst
from .single_run import Solved

__all__ = ["Attempt", "Relative", "relative", "solve_within"]

ATTEMPTS = 12
START = 100  # steps of the first attempt where no dt is given
SCOUT = 48  # the same where spaces or modes have to be found first, whose errors are seen with few steps, and nothing touches
LOOSEST = 1e-4  # rtol of the first attempt of schemes with error control
RECORDS = 200  # that runs make at least, so that they can be compared


@dataclass(frozen=True)
class Attempt:
    """One run on the way to a tolerance: its steps (s, or rtol), its level of refinement, stated errors, seconds with estimates.

    One that only looked at the error in space, with the fewest steps that follow the motion, states this error alone.
    ``worst`` is the largest stated error over its tolerance; ``errors``: sensor -> sum of errors. ``then``: what was done next.
    """

    step: float
    meshes: int
    modes: int
    worst: float
    errors: dict[str, float]
    seconds: float
    then: str

    def __str__(self) -> str:
        """A line of a table."""
        errors = ", ".join(f"{n} {x:.1e}" for n, x in self.errors.items())
        return (
            f"step {self.step:<9.3g} mesh level {self.meshes}, modes level {self.modes}: error / tol {self.worst:8.2g} "
            f"({errors}), {self.seconds:.2f} s: {self.then}"
        )


def solve_within(
    scene: Scene,
    tol: Tolerance,
    *,
    t_end: float,
    start: tuple[Any, float | None],
    settings: tuple[Any, Any, Any],
) -> Run:
    """A run whose stated errors are below ``tol``, or the best that was found, see :func:`.solve`; collective."""
    check_tolerances(scene, tol)
    newton, wanted, linear = settings
    plan = _first(scene, start[0], t_end, start[1])
    check_tangent(plan.scheme, newton)
    wanted = replace(Output() if wanted is None else wanted, estimate_error=True)
    shared = SharedRuns(newton, linear, plan.grain)

    history: list[Attempt] = []
    best: tuple[float, Run] | None = None
    why = f"{ATTEMPTS} attempts were not enough"
    for _ in range(ATTEMPTS):
        begun = clock.perf_counter()
        try:
            looked = space_first(plan, tol, shared, wanted)
            if looked is not None:
                history.append(_of_space(plan, looked, clock.perf_counter() - begun))
                plan = looked.plan
                continue
            run, orders = _attempt(plan, tol, shared, wanted)
        except (ConvergenceError, LinearSolveError) as error:
            if best is not None or plan.step < 1e-3 * t_end / START:
                why = f"a run failed: {error}"
                break
            plan = finer_steps(plan, 0.25)
            continue
        ratio = worst(run.certificate, tol)
        if best is None or ratio < best[0]:
            best = ratio, run
        tried = replace(plan, orders=orders)
        plan_next, then = (
            (None, "done") if safe(run.certificate, tol) else next_plan(tried, run, tol, shared=shared, history=history)
        )
        if plan_next is None and ratio <= 1.0:  # nothing can be made better, and nothing has to
            then = "done"
        errors = {n: run.certificate[n].sum for n in tol}
        seconds = clock.perf_counter() - begun
        history.append(Attempt(plan.step, plan.meshes, plan.modes, ratio, errors, seconds, then))
        if plan_next is None:
            why = then
            break
        plan = plan_next
    if best is None:
        raise ConvergenceError(f'Scene "{scene.name}": no run with tol came to its end: {why}')
    if best[0] > 1.0:
        log.warning('scene "%s": the tolerance was not reached, %.2g times it is stated: %s.', scene.name, best[0], why)
    best[1].history = tuple(history)
    return best[1]


def _of_space(plan: Plan, looked: Looked, seconds: float) -> Attempt:
    """The line of an attempt that ended when its meshes were found too coarse."""
    step = plan.pace.t_end / plan.orders.follow
    return Attempt(step, plan.meshes, plan.modes, looked.over, looked.errors, seconds, "finer meshes")


def _first(scene: Scene, scheme: Any, t_end: float, dt: float | None) -> Plan:
    """The first attempt: the scene as it is, with the steps given or a hundred of them, or with a loose tolerance."""
    from .solve import default_scheme

    scheme = default_scheme(scene) if scheme is None else checked_scheme(scheme)
    if Declared.by(scheme).adaptive:
        scheme = replace(scheme, rtol=max(scheme.rtol, LOOSEST))
        return Plan(scene, scheme, pace_of(scene, scheme, t_end, dt), 1)
    number("End time t_end =", t_end, above=0.0, unit="s")
    spaces = bool(meshed_bodies(scene) or modal_bodies(scene)) and not scene.contacts
    dt = t_end / (SCOUT if spaces else START) if dt is None else dt
    pace = pace_of(scene, scheme, t_end, dt, multiple=4)
    return Plan(scene, scheme, pace, pace.steps // 4)


def _attempt(plan: Plan, tol: Tolerance, shared: SharedRuns, wanted: Output) -> tuple[Run, Orders]:
    """A run with the estimates that are not known yet, and the orders that were seen; collective."""
    every = _often(wanted, plan.pace)
    output = replace(wanted, every=every, estimate_error=False)
    solved = shared.solve(plan.scene, plan.scheme, plan.pace, output)
    run, ended = solved.run, clock.perf_counter()
    found = _time_error(plan, tol, shared, solved)
    run.seconds["error estimate"] = clock.perf_counter() - ended

    _other_errors(plan, shared, solved, found.with_others)
    if every != wanted.every:
        _thin_out(run, solved.compared.recorder.indices, wanted.every)
    fewest = found.with_others.pace.steps
    return run, Orders(found.orders, fewest) if fewest < plan.steps else Orders()


def _time_error(plan: Plan, tol: Tolerance, shared: SharedRuns, solved: Solved) -> TimeError:
    """The error by the steps, or by the scheme's tolerance; collective."""
    run, made = solved.run, solved.compared
    if not plan.steps:
        errors = tolerance_error(solved.problem, made.recorder, made.pace)
        run.state_error("time", errors)
        return TimeError(errors, {}, made)

    # the order matters as soon as the run could be the last one, or where other errors are told by runs with few steps
    rough = not meshed_bodies(plan.scene) and not modal_bodies(plan.scene)
    for less in (True, False) if rough else (False,):
        found = shared.time_error(solved, plan.orders, rough=less)
        run.state_error("time", found.errors)
        run.observed_order = found.orders
        if less and not safe(run.certificate, tol):
            break
    return found


def _other_errors(plan: Plan, shared: SharedRuns, solved: Solved, made: Compared) -> None:
    """State the errors of modes and space: those that are known, or from runs with the steps of a run ``made``; collective."""
    run = solved.run
    if plan.known is not None:
        run.space_unstated = plan.known.unstated
        for kind, found in plan.known.errors.items():
            run.state_error(kind, found)
        return

    begun = clock.perf_counter()
    if modal_bodies(plan.scene):
        run.state_error("modes", reduction_error(solved.problem, made))
        run.seconds["reduction estimate"] = clock.perf_counter() - begun
    begun = clock.perf_counter()
    if meshed_bodies(plan.scene):
        in_space, run.space_unstated = shared.space_error(solved, made, plan.below)
        run.state_error("space", in_space)
        run.seconds["space estimate"] = clock.perf_counter() - begun


def _often(wanted: Output, pace: Pace) -> int:
    """Every how many steps an attempt is recorded: as wanted, or a divisor of it where that would leave few records."""
    if not pace.steps or wanted.times is not None:
        return wanted.every
    fits = [n for n in range(1, wanted.every + 1) if wanted.every % n == 0 and pace.steps / n >= RECORDS]
    return max(fits, default=1)


def _thin_out(run: Run, indices: Sequence[int], every: int) -> None:
    """Leave only the records that were wanted: of every so many steps, and the last."""
    keep = np.array([n % every == 0 for n in indices])
    keep[-1:] = True
    run.times = run.times[keep]
    run.series = {name: x[keep] for name, x in run.series.items()}
    run.energy = {kind: x[keep] for kind, x in run.energy.items()}
    if run.books is not None:
        power, work = ({n: x[keep] for n, x in kind.items()} for kind in (run.books.power, run.books.work))
        run.books = Books(power, work, run.books.unlisted)
