"""The one time loop: consistent start, steps, recording, error estimate; one answer on all ranks."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ConvergenceError, InputError, Stopped, near, require
from ..linear.schur import StepSolver
from ..log import StopRequests, install_hooks, log, peak_memory
from ..rotations import Array
from ..schemes.dae import Index3
from ..schemes.generalized_alpha import GeneralizedAlpha
from ..schemes.newton import Newton
from ..schemes.start import Correction, consistent
from ..schemes.statics import equilibrium
from ..system.plan import Plan, make_plan
from ..system.scene import Scene
from ..system.system import State, System
from .guard import Guarded, closed
from .output import Output, Progress, Recorder
from .pace import Pace, pace_of


@dataclass
class Run:
    """What a run left behind; equal on all ranks but for the field values in ``state`` and ``snapshots``.

    Attributes:
        scene, scheme, plan: what was solved, how, and what existed.
        dt: step size used, s (``t_end`` divided by a whole number of steps).
        times: (n,) s; ``series``: sensor name -> (n, size) values; ``energy``: kind -> (n,) J.
        state, system: the last state and its system. ``snapshots``: states kept for pictures.
        counters: steps, Newton iterations, factorisations, back-solves. ``seconds``: by phase.
        drift: largest position constraint (m) and velocity constraint (m/s) residual seen.
        local_error: the scheme's own indicator of the error of one step, largest over the run (m, rad).
        error_estimate: sensor name -> estimated time-discretisation error, in the sensor's unit; empty when
            not asked for.
        observed_order: sensor name -> order in h seen in the runs of the estimate, nan where it could not be
            seen.
        memory: peak memory of the largest rank, bytes.
        status: "finished", or "stopped" after Ctrl-C.
    """

    scene: Scene
    scheme: Any
    plan: Plan
    system: System
    state: State
    dt: float
    times: Array
    series: dict[str, Array]
    energy: dict[str, Array]
    snapshots: list[State]
    counters: dict[str, float]
    seconds: dict[str, float]
    drift: tuple[float, float]
    correction: Correction
    local_error: float
    error_estimate: dict[str, float] = field(default_factory=dict)
    observed_order: dict[str, float] = field(default_factory=dict)
    memory: float = 0.0
    status: str = "finished"

    def __getitem__(self, sensor: str) -> Array:
        """Series of a sensor, (n, size)."""
        if sensor not in self.series:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self.series)}')
        return self.series[sensor]

    def report(self) -> str:
        """Steps, iterations, error estimate, drift, energy, seconds by phase, and the plan, as text; not
        collective.
        """
        from ..faces.report import run_report

        return run_report(self)

    @property
    def total_energy(self) -> Array:
        """Sum of the recorded energies, (n,) J."""
        return np.sum(list(self.energy.values()), axis=0)

    def momenta(self, state: State | None = None) -> tuple[Array, Array]:
        """Momentum (N s) and angular momentum about the origin (N m s) of a state, the last by default; collective."""
        s = self.state if state is None else state
        return self.system.at(s.t, s.q, s.v).momenta()

    def plot(self, *sensors: str, file: str | Path, reference: Mapping[str, Any] | None = None) -> None:
        """Write a figure of sensor series over time (matplotlib); rank 0 writes.

        Args:
            sensors: names of sensors ("tip") or of their components ("tip y"); all sensors when none is given.
            reference: name -> exact value as a function of time (s), drawn behind the curve, or (times, values),
                drawn as crosses.
        """
        from ..faces.plot import plot_series

        plot_series(self, sensors, file, reference)

    def picture(self, file: str | Path, *, sensor: str | None = None) -> None:
        """Write a picture of the snapshots (pyvista), with the history of a sensor beside it; collective,
        rank 0 writes.
        """
        from ..faces.plot import picture

        picture(self, file, sensor=sensor)


@dataclass(frozen=True)
class _Problem:
    """A consistent start and what a march from it needs."""

    scene: Scene
    system: System
    markers: dict[str, int]
    start: State
    scheme: Any
    newton: Newton
    linear: Any
    pressures: list[Array]  # that bodies carry as unknowns


@dataclass(frozen=True)
class _March:
    """What a march left: recorder, last state, largest local error, the first step's back-solves, the
    scheme's statistics.
    """

    recorder: Recorder
    state: State
    local_error: float
    done: int
    first: int
    status: str
    counters: dict[str, float]
    path: str


def solve(
    scene: Scene,
    *,
    t_end: float,
    dt: float | None = None,
    scheme: Any = None,
    newton: Newton | None = None,
    output: Output | None = None,
    linear: Any = None,
) -> Run:
    """Integrate a scene from t = 0 to ``t_end`` (s) with steps of at most ``dt`` (s); collective.

    Args:
        dt: needed for schemes with constant steps. A scheme with error control (``rtol``) chooses its steps,
            none above dt.
        scheme: a scheme object; :class:`GeneralizedAlpha` with rho_inf = 0.8 by default, ``ContactMidpoint``
            with contact.
        newton: tolerance and limits of Newton's iteration.
        output: what is recorded how often, and whether the time-discretisation error is estimated.
        linear: how elastic bodies and ties are solved: :class:`Direct` (the default), :class:`Schur`,
            :class:`FieldSplit`. PETSc's options of a block are those under ``-<scene>_<block>_``, of a split
            ``-<scene>_fieldsplit_<block>_``, spaces written as ``_``.

    Raises:
        InputError: unusable arguments. ConstraintError: the bodies do not fit. ConvergenceError: a step
            failed.
        Stopped: Ctrl-C in a serial run; ``run`` of the exception holds the run up to the step that was under
            way.
    """
    install_hooks()
    scheme = _default_scheme(scene) if scheme is None else scheme
    output = Output() if output is None else output
    newton = Newton() if newton is None else replace(newton, iterations=0, theta=0.5)
    require(
        newton.tangent is None or (type(scheme) is GeneralizedAlpha and isinstance(scheme.form, Index3)),
        f"{scheme.name} has no exact tangent. Use scheme=fmbd.GeneralizedAlpha(), or leave out Newton's tangent.",
    )
    pace = pace_of(scene, scheme, t_end, dt, multiple=4 if output.estimate_error else 1)
    begin = clock.perf_counter()
    system, given, markers = scene.build()
    _check_pressures(system, scheme)
    built = clock.perf_counter()
    solver = _solver(scene, system, linear)
    newton.refresh = solver.refresh
    try:
        if scene.settle:
            given = equilibrium(system, given, solver)
        if hasattr(scheme, "start"):
            start, correction = scheme.start(system, given, solver, pace.next(0.0))
        else:
            require(
                system.contacts is None,
                f"{scheme.name} does not treat contact. Use fmbd.ContactMidpoint(), ContactAlpha() or Moreau().",
            )
            start, correction = consistent(system, given, solver)
        started = clock.perf_counter()
        problem = _Problem(scene, system, markers, start, scheme, newton, linear, solver.pressures)
        march = _march(problem, solver, pace, output)
        ended = clock.perf_counter()
        counters = _counters(march, newton, solver)
    finally:
        solver.destroy()
    run = Run(
        scene=scene,
        scheme=scheme,
        plan=make_plan(scene, system, march.path),
        system=system,
        state=march.state,
        dt=march.state.t / max(march.done, 1),
        times=np.array(march.recorder.times),
        series=march.recorder.series,
        energy=march.recorder.energy,
        snapshots=march.recorder.snapshots,
        counters=counters,
        seconds={
            "set-up": built - begin,
            "start": started - built,
            "steps": ended - started - march.recorder.seconds,
            "recording": march.recorder.seconds,
            "total": ended - begin,
        },
        drift=(march.recorder.gap, march.recorder.slip),
        correction=correction,
        local_error=march.local_error,
        memory=peak_memory(system.comm),
        status=march.status,
    )
    if run.status == "stopped":
        raise Stopped(run)
    if output.estimate_error:
        run.error_estimate, run.observed_order = _estimate(problem, march.recorder, pace)
        run.seconds["error estimate"] = clock.perf_counter() - ended
    return run


def _check_pressures(system: System, scheme: Any) -> None:
    """Bodies with a pressure as an unknown need a scheme that moves it."""
    names = [p.name for _, p in system.fields if p.field.carried]
    require(
        not names or getattr(scheme, "carries_pressure", False),
        f'Body "{"".join(names[:1])}" has a pressure that is an unknown; {scheme.name} does not solve for it. Use '
        "GeneralizedAlpha() with form=Index3(), or energy=neo_hookean_mixed(...).",
    )


def _solver(scene: Scene, system: System, linear: Any) -> StepSolver:
    """The linear solver of a scene, with its own prefix of PETSc's options; collective."""
    return StepSolver(system, linear=linear, prefix=scene.name.replace(" ", "_") + "_")


def _default_scheme(scene: Scene) -> Any:
    """Generalized-alpha; the contact-implicit midpoint rule for a scene with contact."""
    if not scene.contacts:
        return GeneralizedAlpha()
    from ..schemes.contact_midpoint import ContactMidpoint

    return ContactMidpoint()


def _stepper(problem: _Problem, solver: StepSolver, *, guarded: bool) -> Any:
    """The scheme's worker from the consistent start, under the energy guard where that makes sense."""
    made = problem.scheme.stepper(problem.system, solver, problem.newton, problem.start)
    if not guarded:
        return made

    def renew(state: State) -> Any:
        problem.newton.theta = 0.5
        start, _ = consistent(problem.system, state, solver)
        return problem.scheme.stepper(problem.system, solver, problem.newton, start)

    return Guarded(made, problem.system, renew)


def _march(problem: _Problem, solver: StepSolver, pace: Pace, output: Output) -> _March:
    """All steps from a consistent start; collective."""
    stepper = _stepper(problem, solver, guarded=output.energy and closed(problem.scene, problem.system))
    recorder = Recorder(problem.scene, problem.system, problem.markers, output, pace.t_end)
    state = stepper.state
    recorder.take(0, state, getattr(stepper, "evaluation", None))
    bar = Progress(problem.scene.name, pace.steps or None, output.progress)
    local_error, done, first = 0.0, 0, 0
    try:
        with StopRequests() as stop:
            while not pace.ended(state.t, done):
                state = stepper.advance(pace.next(state.t))
                done += 1
                local_error = max(local_error, stepper.local_error)
                recorder.take(done, state, getattr(stepper, "evaluation", None))
                bar.update()
                first = first or solver.back_solves
                if (kink := pace.broken(state.t)) is not None:
                    stepper.restart(kink)
                    state = stepper.state
                if stop.asked:
                    log.warning("stopped on request at t = %g s", state.t)
                    break
    except ConvergenceError as error:
        total = f" of {pace.steps}" if pace.steps else ""
        raise ConvergenceError(f'Scene "{problem.scene.name}", step {done + 1}{total}: {error}') from error
    finally:
        bar.close()
    status = "finished" if pace.ended(state.t, done) else "stopped"
    counters, path = getattr(stepper, "counters", {}), getattr(stepper, "path", "NumPy")
    return _March(recorder, stepper.state, local_error, done, first, status, counters, path)


def _counters(march: _March, newton: Newton, solver: StepSolver) -> dict[str, float]:
    """Counts of a run; back-solves per step without those of the first step, which also solves the constant
    columns.
    """
    later = solver.back_solves - march.first
    return {
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
        **march.counters,
    }


def _estimate(problem: _Problem, fine: Recorder, pace: Pace) -> tuple[dict[str, float], dict[str, float]]:
    """Error of each sensor by Richardson's extrapolation from runs with 2 h and 4 h, and the observed order;
    collective.

        |x_h - x| ~ |x_h - x_2h| / (2^p - 1),     p = log2(|x_2h - x_4h| / |x_h - x_2h|)               (1)

    in the maximum norm over time, p at most the order of the scheme. Where fast motion is not resolved (say,
    gravity switched on at once) the observed order is below the scheme's, and the estimate larger; an order
    below 1/2 counts as 1/2. Motion that the scheme damps in all three runs is not seen. Hairer, Norsett,
    Wanner, doi:10.1007/978-3-540-78862-1, II.4.
    """
    try:
        half = _again(problem, pace, 2)
    except ConvergenceError as error:
        log.warning("no error estimate: the run with twice the step failed: %s", error)
        return {}, {}
    try:
        quarter = _again(problem, pace, 4)
    except ConvergenceError:
        quarter = None
    errors, orders = {}, {}
    for name, x in fine.series.items():
        near, p = _distance(fine.indices, x, half.series[name]), float("nan")
        if quarter is not None and near > 0:
            far = _distance(half.indices, half.series[name], quarter.series[name])
            p = float(np.log2(far / near)) if far > 0 else 0.0
        usable = problem.scheme.order if np.isnan(p) else min(max(p, 0.5), problem.scheme.order)
        errors[name], orders[name] = near / (2.0**usable - 1.0), p
    return errors, orders


def _again(problem: _Problem, pace: Pace, factor: int) -> Recorder:
    """The march once more with steps larger by a factor, sensors recorded in every step; collective."""
    solver = _solver(problem.scene, problem.system, problem.linear)
    newton = replace(problem.newton, iterations=0, theta=0.5, refresh=solver.refresh)
    solver.pressures = problem.pressures
    wanted = Output(energy=False, progress=False)
    try:
        return _march(replace(problem, newton=newton), solver, Pace(pace.t_end, pace.steps // factor), wanted).recorder
    finally:
        solver.destroy()


def _distance(indices: list[int], x: Array, coarse: Array) -> float:
    """Largest difference of a series, recorded at the given steps, and one recorded at every step of twice
    the size.
    """
    rows = [k for k, n in enumerate(indices) if n % 2 == 0]
    return float(np.abs(x[rows] - coarse[[indices[k] // 2 for k in rows]]).max(initial=0.0))
