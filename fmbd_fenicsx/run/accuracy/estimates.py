"""Errors that a run states of itself, from more runs of the same scene: of time discretisation, of modal reduction."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...log import log
from ...mechanics.reduction.reduced import ReducedPart, reduced_part
from ...notices import Gathered
from ...schemes.declared import Declared
from ...schemes.error_norm import FINEST
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.system import System
from ..built import Built
from ..loads_ahead import PASSED, loads_ahead
from ..problem import Problem
from ..recording.accompanied import Accompanied
from ..recording.output import Output
from ..recording.recorder import Recorder
from ..schedule import StepSchedule
from ..time_loop import Marched
from .beside_steps import algebra_error, tighter_run, with_damped, with_early_rest
from .certificate import kinked, stated_of, uncertain_of
from .companion_runs import UNFIT, Compared, as_recorded, companion
from .deviation import Deviation, scaled
from .equal_steps import TimeError, equal_steps_error
from .jumps_at_records import jumps_at_records
from .jumps_in_time import jumps_about_kinks
from .larger_steps import SLOW, beyond_by_halves
from .orders import expected_orders
from .search.space_levels import finer_scene, space_deviations, unended

if TYPE_CHECKING:
    from ..result import Run

STEEPEST = 0.9  # power of a scheme's tolerance that its errors follow at most, as long as nothing was seen
FEWEST = 100  # instants at which runs are compared, of which fewer than that have steps
TENTH = 0.1  # of a tolerance
# power of tolerances that errors are thought to fall with at most, and the most that a finer run is thought to have left of one
FALLS, LEFT = 0.7, 0.6
TELLING = 2.0  # ratio by which errors fall, by the steps that were taken, from which on runs are compared
PEAKS = 30.0  # times what Newton's iteration leaves in the mean that it does at single ends of steps
SHOWN = 4  # jumps in a message
SATURATION = 1.5  # the error of the finer basis counts as at most a third of that of the given one

Whole = Callable[[float], tuple[dict[str, Deviation], Compared] | None]  # of a tolerance


def tolerance_error(
    problem: Problem, coarse: Recorder, schedule: StepSchedule, *, whole: Whole | None = None
) -> dict[str, Deviation]:
    """Error of each sensor by the tolerance of an error-controlled scheme, both runs at the recorded times; collective.

    Empty, with a warning, where the second one, see :func:`beyond_by_finer`, fails.

        |x_r - x| <= |x_r - x_s| + |x_s - x| <= 1 / (1 - k) |x_r - x_s|                                               (1)
    """
    try:
        apart, left = beyond_by_finer(problem, Compared(coarse, schedule, problem.scheme), whole=whole)
    except UNFIT as error:
        log.warning("no error estimate: the run with a smaller tolerance did not end: %s", error)
        return {}
    return {n: scaled(x, 1.0 / (1.0 - left[n])) for n, x in apart.items()}


def left_at_single_ends(problem: Problem, made: Recorder) -> dict[str, Deviation]:
    """What Newton's iteration may leave at single ends of steps of a run with error control, at most. Larger steps, which share
    every second end, do not show it where no error of time hides it, as of mechanisms that are driven.
    """
    share = PEAKS * problem.said.accuracy(problem.newton) if problem.said.weighs else 0.0
    return {n: Deviation(made.times[:1], share * np.ptp(x, axis=0)[None]) for n, x in made.series.items()}


def beyond_by_finer(
    problem: Problem, given: Compared, *, of: Built | None = None, whole: Whole | None = None
) -> tuple[dict[str, Deviation], dict[str, float]]:
    """What a run with smaller steps has beyond a given one, and the share k of the error that it has itself. ``of``: it is made
    with another system of the problem's scene; ``whole``: who makes one that serves again, or none. Collective. Raises one of
    :data:`.UNFIT` where it does not end.

    Halves of the steps (:func:`.larger_steps.beyond_by_halves`) leave k = 2^-p, p the order of the scheme in the sensor, in finer
    spaces, which vibrate faster, :data:`SLOW` of it. A tenth of the tolerance leaves k = (n_r / n_s)^p, n_r, n_s the steps that
    both took: multipliers, and all where memories go by rules of their own, have lower orders than the steps are chosen by. k
    counts as 10^-0.7 at least: errors like r^(2/3) fall to 0.22 of their size.
    """
    orders = expected_orders(problem.scheme, problem.scene, problem.system)
    if apart := beyond_by_halves(problem, given, of):
        share = 1.0 if of is None else SLOW
        return apart, {n: 0.5 ** (share * p) for n, p in orders.items()}
    rtol = max(TENTH * problem.scheme.rtol, FINEST)
    made = None if whole is None else whole(rtol)
    apart, finer = made or _from_tolerance(problem, given, rtol, of)
    return apart, {n: min(max(grown(given, finer) ** -p, TENTH**FALLS), LEFT) for n, p in orders.items()}


def grown(given: Compared, finer: Compared) -> float:
    """How many times as many steps a run took as another one."""
    return float(finer.recorder.indices[-1] / max(given.recorder.indices[-1], 1))


def looser_run(problem: Problem, given: Compared) -> tuple[dict[str, Deviation], Compared]:
    """What a given run has beyond one with ten times the tolerance, and that one; collective.

    It costs half of what a tenth does, and knows less: powers seen between two runs scatter between 1/2 and 1.2.
    """
    apart, loose = _from_tolerance(problem, given, 10.0 * problem.scheme.rtol)
    return {n: scaled(x, -1.0) for n, x in apart.items()}, loose


def beyond(given: Recorder, before: Compared) -> dict[str, Deviation]:
    """What a given run has beyond an attempt before it with a larger tolerance, at some records of that: it has them beside its
    own, or among these where both were asked for the same times.
    """
    rows = looked_at(before.recorder)
    if isinstance(given, Accompanied):
        there = given.beside.series
    else:
        there = {n: x[rows] for n, x in given.series.items()}
    times, then = before.recorder.times[rows], before.recorder.series
    return {n: Deviation(times, x - then[n][rows]) for n, x in there.items()}


def of_tolerances(apart: dict[str, Deviation], most: float, seen: Mapping[str, float]) -> dict[str, Deviation]:
    """Errors from what a run has beyond one with a larger tolerance, where errors fall to 1 / f of their size between them:

    x - x_r ~ (x_r - x_Rr) / (f - 1),     f = R^power = ``most``, at most (n_r / n_Rr)^p = ``seen``                    (1)

    R the ratio of the tolerances, n the steps that the runs took, p the order of the scheme in the sensor: steps come in a few
    sizes, and may be nearly as many; what is of a lower order than they are chosen by falls less. f is :data:`TELLING` at least.
    """
    return {n: scaled(x, 1.0 / (max(min(most, seen[n]), TELLING) - 1.0)) for n, x in apart.items()}


def looked_at(made: Recorder) -> np.ndarray:
    """Rows of the records of a run at which others are compared: all, or evenly as many as it has steps. Peaks of accelerations
    and multipliers are narrow, and what iterations leave is at single ends of steps.
    """
    count, most = len(made.times), max(int(made.indices[-1]) + 1, FEWEST)
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


def usual_power(scheme: Any) -> float:
    """The power of a scheme's tolerance that its errors go with, as long as none was seen: steps with its root of the order plus
    one; those of schemes whose ends are ahead with a higher root than their error does.
    """
    return 1.0 if Declared.by(scheme).ends_ahead else min(scheme.order / (scheme.order + 1.0), STEEPEST)


def usual_errors(made: Compared) -> dict[str, Deviation]:
    """Errors of about the size that a scheme's tolerance has as a share of the range of sensors."""
    times, series, rtol = made.recorder.times, made.recorder.series, made.scheme.rtol
    return {n: Deviation(times[:1], rtol * np.ptp(x, axis=0)[None]) for n, x in series.items()}


def _from_tolerance(
    problem: Problem, given: Compared, rtol: float, of: Built | None = None
) -> tuple[dict[str, Deviation], Compared]:
    """What a run with another tolerance has beyond a given one, at some of its records, and that run; collective."""
    recorder, schedule = given.recorder, given.schedule
    other = replace(problem, scheme=replace(problem.scheme, rtol=rtol))
    rows = looked_at(recorder)
    wanted = Output(energy=False, progress=False, times=tuple(recorder.times[rows]))
    made = Compared(companion(other, schedule, wanted, of).recorder, schedule, other.scheme)
    there = {n: x[rows] for n, x in recorder.series.items()}
    seen = {n: x for n, x in made.recorder.series.items() if x.shape == there[n].shape}  # not those of each mesh
    apart = {n: Deviation(made.recorder.times, x - there[n]) for n, x in seen.items()}
    return apart, made


def space_error(problem: Problem, compared: Compared) -> tuple[dict[str, Deviation], str]:
    """Error of each sensor by the meshes of the elastic bodies, and what could not be stated; collective.

    A run is made once more, with the same steps, each body in a finer space
    (:func:`~fmbd_fenicsx.system.scene.refinement.finer_space`):

        |x_h - x| <= |x_h - x_f| + |x_f - x| <= 4/3 |x_h - x_f|     as long as  |x_f - x| <= |x_h - x| / 4         (2)

    in the maximum norm over time, x the run without an error in space. Near singular corners the finer space is less far ahead,
    and the estimate too small by up to a third.
    """
    scene, why, built = finer_scene(problem.scene)
    if built is None:
        return {}, why or "no body is on a mesh"
    try:
        fine = run_like(problem, compared, scene, built).recorder
    except UNFIT as error:
        return {}, unended(error)
    return space_deviations(compared.recorder, fine, why)


def run_like(problem: Problem, compared: Compared, scene: Scene, built: Built) -> Marched:
    """The march of another scene, with the same sensors, with the same steps; collective.

    Raises one of :data:`UNFIT` where the run does not end.
    """
    wanted = as_recorded(compared.recorder, compared.schedule)
    return companion(replace(problem, scene=scene, scheme=compared.scheme), compared.schedule, wanted, of=built)


def reduction_error(problem: Problem, compared: Compared) -> dict[str, Deviation]:
    """Error of each sensor by the modes that reduced bodies leave out; collective. Empty without reduced bodies.

    A run is made once more, with the same steps, by finer bases that contain the given ones
    (``mechanics.reduction.craig_bampton.RefinedBasis``):

        |x_m - x| <= |x_m - x_f| + |x_f - x| <= 3/2 |x_m - x_f|     as long as  |x_f - x| <= |x_m - x| / 3       (1)

    in the maximum norm over time, x the run with the whole field. The loop holds no field in this run either. Differences near
    the tolerance of Newton's iteration are no errors of reduction. Bank and Smith, doi:10.1137/0730048.
    """
    made = finer_system(problem.system, problem.given)
    if made is None:
        return {}

    system, given = made
    finer = Built(system, given, problem.markers, Gathered(), 0.0)
    try:
        fine = run_like(problem, compared, problem.scene, finer).recorder
    except UNFIT as error:
        log.warning("no error of reduction: the run with more modes did not end: %s", error)
        return {}
    return mode_deviations(compared.recorder, fine)


def mode_deviations(coarse: Recorder, fine: Recorder) -> dict[str, Deviation]:
    """(1) of :func:`reduction_error` from what both have recorded."""
    return {n: Deviation(coarse.times, SATURATION * (fine.series[n] - x)) for n, x in coarse.series.items()}


def state_errors(run: Run, problem: Problem, made: Compared, output: Output) -> None:
    """The estimates that were asked for; collective."""
    ended = clock.perf_counter()
    jumps: tuple[float, ...] = ()
    if output.estimate_error:
        jumps = loads_ahead(run.scene, run.scheme, run.system, run.state, made.schedule, PASSED)
        jumps = jumps or jumps_about_kinks(run, made.schedule, run.series)

    if output.estimate_error and not made.schedule.steps:
        ending = replace(made.schedule, stops=tuple(sorted({*made.schedule.stops, *jumps})))
        run.deviations["time"] = tolerance_error(problem, made.recorder, ending)
        run.seconds["error estimate"] = clock.perf_counter() - ended
    elif output.estimate_error:
        _tell_jumps(run, jumps)
        has_kinks = kinked(run)
        found = equal_steps_error(problem, made, jumps, kinked=has_kinks)
        tight = tighter_run(problem, made, found.errors)
        if tight is not None:
            run.deviations["algebra"] = algebra_error(made, tight[1])
            problem, made = tight
            found = equal_steps_error(problem, made, jumps, kinked=has_kinks)

        take_time_error(run, found, problem, made, last=True)
        made = found.with_others
        run.seconds["error estimate"] = clock.perf_counter() - ended

    if output.estimate_reduction:
        ended = clock.perf_counter()
        run.deviations["modes"] = reduction_error(problem, made)
        run.seconds["reduction estimate"] = clock.perf_counter() - ended
    if output.estimate_space:
        ended = clock.perf_counter()
        run.deviations["space"], run.space_unstated = space_error(problem, made)
        run.seconds["space estimate"] = clock.perf_counter() - ended
    warn_of_uncertain(run, run.series)


def take_time_error(run: Run, found: TimeError, problem: Problem, made: Compared, *, last: bool) -> None:
    """Errors of time and what was seen of them, in the run that was ``made``; where it may be the ``last`` one, with what runs
    with other equal steps do not tell; collective.
    """
    errors = found.errors
    if last:
        errors = with_early_rest(errors, problem, made)
        errors, run.damped = with_damped(errors, problem, made.schedule)
    run.struck = jumps_at_records(errors, made.recorder, found.struck)
    run.deviations["time"] = errors
    run.observed_order, run.halved, run.alone = found.orders, found.halved, found.unseen


def _tell_jumps(run: Run, jumps: tuple[float, ...]) -> None:
    """Jumps within equal steps, where a user sees them."""
    if jumps:
        run.jumps = jumps
        shown = ", ".join(f"{t:.6g}" for t in jumps[:SHOWN]) + (", .." if len(jumps) > SHOWN else "")
        run.warnings.append(
            f"loads or drives jump, or come and go, within steps, at t = {shown} s, which leaves an error of first order, or all "
            "of what they do, stated with the others. "
            "Name these instants in Scene(breakpoints=...), so that steps end there, or take a scheme that chooses its steps "
            "(rtol)."
        )
        log.warning("%s", run.warnings[-1])


def warn_of_uncertain(run: Run, sensors: Iterable[str]) -> None:
    """Errors of some sensors that may be far from what is stated, where a user sees it."""
    if not run.deviations:  # which tell
        return
    for why in uncertain_of(run, stated_of(run, sensors)).values():
        log.warning("%s.", why)
        run.warnings.append(f"{why}.")


def finer_system(system: System, state: State) -> tuple[System, State] | None:
    """The same system and its state as given, with reduced bodies and beams by their finer bases; collective.

    Frames, ports, constraints and forces are the same. None where there is no reduced body. Computed once for each body.
    """
    m = system.motions
    parts: list[Any] = []
    q = [state.q[: system.counted_angles.stop]]
    v = [state.v[: system.n_frames * m.n_twist]]

    # frames stay; local coordinates begin anew in the finer basis
    for k, part in enumerate(system.parts):
        local = system.local_q(state.q, k), system.local_v(state.v, k)
        if isinstance(part, ReducedPart):
            body = part.body.with_refined_basis(part.surfaces)
            part = reduced_part(body, part.frame, part.surfaces)
            local = body.start_local()
        parts.append(part)
        q.append(local[0])
        v.append(local[1])

    if not any(isinstance(p, ReducedPart) for p in parts):
        return None
    finer = replace(system, parts=tuple(parts), cache={})
    zero = np.zeros(finer.n_v)
    return finer, State(state.t, np.concatenate(q), np.concatenate(v), zero, np.zeros(finer.n_lam))
