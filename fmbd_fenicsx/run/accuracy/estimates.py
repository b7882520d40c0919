"""Errors that a run states of itself, from more runs of the same scene: of time discretisation, of modal reduction."""

from __future__ import annotations

import time as clock
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...log import log
from ...notices import Gathered
from ...schemes.control import FINEST
from ...schemes.declared import Declared
from ...system.scene.refined_basis import finer_system
from ...system.scene.scene import Scene
from ..built import Built
from ..problem import Problem
from ..recording.accompanied import Accompanied
from ..recording.output import Output
from ..recording.recorder import Recorder
from ..schedule import StepSchedule
from ..time_loop import March
from .algebra import algebra_error, tighter_run
from .certificate import HIDDEN, moving, stated_of, uncertain_of
from .companion_runs import UNFIT, Compared, StoppedError, again, as_recorded, companion
from .damped import damped_vibrations
from .deviation import Deviation, scaled
from .orders import expected_orders, irregular, order_seen, resolved, scattered_order, usable_order
from .search.space_levels import finer_scene, space_deviations, unended

if TYPE_CHECKING:
    from ..result import Run

NEARBY = 0.1  # share of the run about the largest difference in which that with larger steps is looked at too
FEWEST = 12  # steps of runs that tell errors by spaces and modes; fewer show an order
ROUNDOFF = 1e-9  # errors below this share of a sensor have no order
STEEPEST = 0.9  # power of a scheme's tolerance that its errors follow at most, as long as nothing was seen
LOOKED_AT = 50  # instants at which runs of a search with steps of their own choice are compared
CERTIFIED_AT = 200  # the same for a certificate: peaks of accelerations and reactions are narrow
# share of its error that a run with a tenth of the tolerance is thought to have left, at least and at most
TENTH, LEFT = 0.2, 0.6
SATURATION = 1.5  # the error of the finer basis counts as at most a third of that of the given one


@dataclass(frozen=True)
class TimeError:
    """Error of time and observed order of each sensor; ``with_others``: the cheapest run that follows the same motion."""

    errors: dict[str, Deviation]
    orders: dict[str, float]
    with_others: Compared


def time_error(problem: Problem, fine: Recorder, schedule: StepSchedule) -> TimeError:
    """Error of each sensor from runs with 2 h and 4 h, and the observed order, see :func:`compare_steps`; collective.

    Where a run with larger steps does not end, or follows another motion in some sensor (:func:`.certificate.irregular`), one
    with half the step tells the error. Motion that the scheme damps in all runs is not seen.
    Hairer, Norsett, Wanner, doi:10.1007/978-3-540-78862-1, II.4.
    """
    given, coarser = Compared(fine, schedule, problem.scheme), []
    orders = expected_orders(problem.scheme, problem.scene, problem.system)

    found: TimeError | None = None
    try:
        for parts in (2, 4):
            coarser.append(again(problem, schedule, schedule.steps // parts, fine.output.times))
        found = compare_steps(orders, given, coarser)
    except UNFIT as error:
        if not isinstance(error, StoppedError):
            found = _by_smaller_steps(problem, given, coarser, orders)
        if found is None:
            log.warning("no error estimate: the run with twice the step did not end: %s", error)
            return TimeError({}, {}, given)

    if _irregular(problem.scheme.order, orders, fine, found):
        found = _by_smaller_steps(problem, given, coarser[:1], orders) or found
    return found if found.with_others is given else replace(found, with_others=coarser[0])


def _irregular(highest: int, expected: Mapping[str, int], made: Recorder, found: TimeError) -> bool:
    """Whether the order of a sensor that moves is not that of the scheme in it, and its error matters."""
    spans = moving(made.series, made.scene.sensors)
    return any(
        irregular((expected[n], highest), found.orders[n], found.errors[n].size / span) for n, span in spans.items()
    )


def _by_smaller_steps(
    problem: Problem, given: Compared, coarser: list[Compared], expected: Mapping[str, int]
) -> TimeError | None:
    """Errors of the ``given`` run with the help of one with half its step, None where nothing can be compared; collective.

    |x_h - x| ~ |x_h - x_h/2| / (1 - 2^-p),     p the order of the scheme in the sensor, at most 2            (1)

    For motion of order one the truth is 3/2 of this with p = 2, for motion that is off by its own size in both runs 3/4.
    """
    schedule = given.schedule
    try:
        finer = again(problem, schedule, 2 * schedule.steps, given.recorder.output.times)
    except UNFIT:
        return compare_steps(expected, given, coarser) if coarser else None
    orders = compare_steps(expected, finer, [given, *coarser]).orders
    factors = {name: 1.0 / (1.0 - 2.0 ** -min(p, 2)) for name, p in expected.items()}
    errors = {name: scaled(_deviation(finer.recorder, given.recorder, name), factors[name]) for name in orders}
    return TimeError(errors, orders, given)


def compare_steps(
    expected: Mapping[str, int],
    given: Compared,
    coarser: Sequence[Compared],
    known: Mapping[str, float] | None = None,
    *,
    before: Mapping[str, float] | None = None,
) -> TimeError:
    """Error of each sensor by Richardson's extrapolation from one or two runs with larger steps, h < H < K:

        |x_h - x| ~ |x_h - x_H| / ((H/h)^p - 1),     (K^p - H^p) / (H^p - h^p) = |x_H - x_K| / |x_h - x_H|     (1)

    p the smallest one of those in the maximum over time, in the mean square, and about the largest |x_h - x_H|: a start that
    shakes for some steps is not told by the slow motion after it. It counts as :func:`usable_order` says.

    Where fast motion is not resolved (say, gravity switched on at once) the observed order is below the scheme's, and the
    estimate larger. From one run alone p is the ``known`` one, sensor -> p, or the ``expected`` one. Orders of such motion
    scatter: one that is not regular counts as its mean with a lower one that was seen ``before``, with larger steps.
    """
    fine, coarse = given.recorder, coarser[0].recorder
    ratio = given.schedule.steps / coarser[0].schedule.steps
    errors, orders = {}, {}
    for name in fine.series:
        between = _deviation(fine, coarse, name)
        p = float("nan") if known is None else known.get(name, float("nan"))
        if len(coarser) > 1 and between.size > 0:
            steps = coarser[1].schedule.steps, coarser[0].schedule.steps, given.schedule.steps
            far = _deviation(coarse, coarser[1].recorder, name)
            here = far.near(between.when, max(NEARBY * fine.t_end, 2.0 * fine.t_end / steps[0]))
            ratios = far.size / between.size, far.mean / between.mean, here / between.size
            p = min(order_seen(*steps, x) for x in ratios)
            p = scattered_order(p, expected[name], None if before is None else before.get(name))
        errors[name], orders[name] = scaled(between, 1.0 / (ratio ** usable_order(p, expected[name]) - 1.0)), p

    moves = [n for n, x in fine.series.items() if errors[n].size > ROUNDOFF * np.abs(x).max(initial=0.0)]
    seen = {n: orders[n] for n in moves}
    follows = bool(seen) and resolved(seen, expected) and (len(coarser) > 1 or known is not None)
    others = [made for made in coarser if follows and made.schedule.steps >= FEWEST]
    return TimeError(errors, orders, others[-1] if others else given)


def of_order(
    expected: Mapping[str, int], given: Compared, coarser: Compared, share: float, least: float = 0.0
) -> dict[str, Deviation]:
    """Errors of a run as one with larger steps tells them, by a ``share`` of the expected orders, one at least if need be."""
    ratio = given.schedule.steps / coarser.schedule.steps
    factors = {n: 1.0 / (ratio ** max(share * p, least) - 1.0) for n, p in expected.items()}
    return {n: scaled(_deviation(given.recorder, coarser.recorder, n), x) for n, x in factors.items()}


def tolerance_error(
    problem: Problem, coarse: Recorder, schedule: StepSchedule, instants: int = LOOKED_AT
) -> dict[str, Deviation]:
    """Error of each sensor by the tolerance of an error-controlled scheme, both runs at the recorded times; collective.

    Empty, with a warning, where the second one fails.

        |x_r - x| <= |x_r - x_s| + |x_s - x| <= 1 / (1 - k) |x_r - x_s|,     s = r / 10,     k = (n_r / n_s)^p           (1)

    with n_r, n_s the steps that the runs took and p the order of the scheme in the sensor: multipliers, and all where memories
    go by the trapezoidal rule, have lower ones than the steps are chosen by. k counts as a fifth at least: errors like r^(2/3)
    fall to 0.22 of their size.
    """
    given = Compared(coarse, schedule, problem.scheme)
    rtol = max(0.1 * problem.scheme.rtol, FINEST)
    try:
        apart, finer = _from_tolerance(problem, given, rtol, instants)
    except UNFIT as error:
        log.warning("no error estimate: the run with a tenth of the tolerance did not end: %s", error)
        return {}
    steps = coarse.indices[-1] / max(finer.recorder.indices[-1], 1)
    orders = expected_orders(problem.scheme, problem.scene, problem.system)
    left = {n: min(max(steps**p, TENTH), LEFT) for n, p in orders.items()}
    return {n: scaled(x, 1.0 / (1.0 - left[n])) for n, x in apart.items()}


def looser_run(problem: Problem, given: Compared) -> tuple[dict[str, Deviation], Compared]:
    """What a given run has beyond one with ten times the tolerance, and that one; collective.

    It costs half of what a tenth does, and knows less: powers seen between two runs scatter between 1/2 and 1.2.
    """
    apart, loose = _from_tolerance(problem, given, 10.0 * problem.scheme.rtol)
    return {n: scaled(x, -1.0) for n, x in apart.items()}, loose


def beyond(given: Recorder, before: Compared) -> dict[str, Deviation]:
    """What a given run has beyond an attempt before it with a larger tolerance, at the records of that."""
    assert isinstance(given, Accompanied)
    beside, rows = given.beside, looked_at(before.recorder)
    return {n: Deviation(beside.times, x - before.recorder.series[n][rows]) for n, x in beside.series.items()}


def of_tolerances(apart: dict[str, Deviation], ratio: float, power: float) -> dict[str, Deviation]:
    """Errors from what a run has beyond one with a tolerance larger by a ``ratio``, where errors go with a ``power`` of it:

    x - x_r ~ (x_r - x_Rr) / (R^power - 1)                                                                           (1)
    """
    return {n: scaled(x, 1.0 / (ratio**power - 1.0)) for n, x in apart.items()}


def looked_at(made: Recorder, most: int = LOOKED_AT) -> np.ndarray:
    """Rows of some of the records of a run."""
    # records between the ends of steps are made one by one
    count = len(made.times)
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def usual_power(order: int) -> float:
    """The power of a scheme's tolerance that its errors go with, as long as none was seen: steps with its root of the order
    plus one.
    """
    return min(order / (order + 1.0), STEEPEST)


def _from_tolerance(
    problem: Problem, given: Compared, rtol: float, most: int = LOOKED_AT
) -> tuple[dict[str, Deviation], Compared]:
    """What a run with another tolerance has beyond a given one, at some of its records, and that run; collective.

    Steps of a finer run end there where values between ends of steps are of a lower order: their errors would be taken for the
    given run's.
    """
    recorder, schedule = given.recorder, given.schedule
    rows = looked_at(recorder, most)
    instants = tuple(recorder.times[rows])
    wanted = Output(energy=False, progress=False, times=instants)
    other = replace(problem, scheme=replace(problem.scheme, rtol=rtol))
    ahead = Declared.by(problem.scheme).ends_ahead and rtol < problem.scheme.rtol
    landing = replace(schedule, marks=instants) if ahead else schedule
    made = Compared(companion(other, landing, wanted).recorder, schedule, other.scheme)
    apart = {n: Deviation(made.recorder.times, x - recorder.series[n][rows]) for n, x in made.recorder.series.items()}
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


def run_like(problem: Problem, compared: Compared, scene: Scene, built: Built) -> March:
    """The march of another scene, with the same sensors, with the same steps; collective.

    Raises one of :data:`UNFIT` where the run does not end.
    """
    wanted = as_recorded(compared.recorder, compared.schedule)
    return companion(replace(problem, scene=scene, scheme=compared.scheme), compared.schedule, wanted, of=built)


def _deviation(fine: Recorder, coarse: Recorder, name: str) -> Deviation:
    """A series less one recorded with larger steps, at the instants that both have."""
    x, y = fine.series[name], coarse.series[name]
    t, rounding = fine.times, 1e-9 * fine.t_end
    rows = np.searchsorted(coarse.times, t - rounding).clip(max=len(coarse.times) - 1)
    common = np.abs(coarse.times[rows] - t) <= rounding
    return Deviation(t[common], x[common] - y[rows[common]])


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
    coarse, schedule = compared.recorder, compared.schedule
    try:
        fine = companion(
            replace(problem, scheme=compared.scheme), schedule, as_recorded(coarse, schedule), of=finer
        ).recorder
    except UNFIT as error:
        log.warning("no error of reduction: the run with more modes did not end: %s", error)
        return {}

    return mode_deviations(coarse, fine)


def mode_deviations(coarse: Recorder, fine: Recorder) -> dict[str, Deviation]:
    """(1) of :func:`reduction_error` from what both have recorded."""
    return {n: Deviation(coarse.times, SATURATION * (fine.series[n] - x)) for n, x in coarse.series.items()}


def state_errors(run: Run, problem: Problem, made: Compared, output: Output) -> None:
    """The estimates that were asked for; collective."""
    ended = clock.perf_counter()
    if output.estimate_error and not made.schedule.steps:
        run.state_error("time", tolerance_error(problem, made.recorder, made.schedule, CERTIFIED_AT))
        run.seconds["error estimate"] = clock.perf_counter() - ended
    elif output.estimate_error:
        found = time_error(problem, made.recorder, made.schedule)
        tight = tighter_run(problem, made, found.errors)
        if tight is not None:
            run.state_error("algebra", algebra_error(made, tight[1]))
            problem, made = tight
            found = time_error(problem, made.recorder, made.schedule)
        errors, run.damped = with_damped(found.errors, damped_vibrations(problem, made.schedule))
        run.state_error("time", errors)
        run.observed_order, made = found.orders, found.with_others
        run.seconds["error estimate"] = clock.perf_counter() - ended

    if output.estimate_reduction:
        ended = clock.perf_counter()
        run.state_error("modes", reduction_error(problem, made))
        run.seconds["reduction estimate"] = clock.perf_counter() - ended
    if output.estimate_space:
        ended = clock.perf_counter()
        found_in_space, run.space_unstated = space_error(problem, made)
        run.state_error("space", found_in_space)
        run.seconds["space estimate"] = clock.perf_counter() - ended
    warn_of_uncertain(run, run.series)


def with_damped(
    errors: dict[str, Deviation], amplitudes: Mapping[str, float]
) -> tuple[dict[str, Deviation], dict[str, float]]:
    """Errors that are at least the amplitudes of what a scheme takes out, and those that say more than the errors do."""
    hidden = {n: x for n, x in amplitudes.items() if n in errors and x > HIDDEN * errors[n].size > 0.0}
    stated = {n: scaled(x, hidden[n] / x.size) if n in hidden else x for n, x in errors.items()}
    return stated, hidden


def warn_of_uncertain(run: Run, sensors: Iterable[str]) -> None:
    """Errors of some sensors that may be far from what is stated, where a user sees it."""
    if not run.deviations:  # which tell
        return
    for why in uncertain_of(run, stated_of(run, sensors)).values():
        log.warning("%s.", why)
        run.warnings.append(f"{why}.")
