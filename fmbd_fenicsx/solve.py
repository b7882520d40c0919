"""The one time loop: consistent start, steps, recording, report; one answer on all ranks."""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .errors import ConvergenceError, InputError, require
from .linear.schur import StepSolver
from .log import install_abort_hook, log, world_rank
from .newton import Newton
from .plan import Plan, make_plan
from .rotations import Array
from .scene import Scene
from .schemes.generalized_alpha import GeneralizedAlpha
from .schemes.start import Correction, consistent
from .system import State, System


@dataclass
class Run:
    """What a run left behind.

    Attributes:
        scene, scheme, plan: what was solved, how, and what existed.
        times: (n,) s; ``series``: sensor name -> (n, size) values; ``energy``: name -> (n,) J.
        state, system: the last state and its system. ``snapshots``: states kept for pictures.
        counters: steps, newton iterations, factorisations, back-solves. ``seconds``: by phase.
        drift: largest position constraint (m) and velocity constraint (m/s) residual seen.
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
    status: str = "finished"

    def __getitem__(self, sensor: str) -> Array:
        """Series of a sensor, (n, size)."""
        if sensor not in self.series:
            from .errors import near

            raise InputError(f'No sensor "{sensor}". {near(sensor, self.series)}')
        return self.series[sensor]

    def report(self) -> str:
        """Steps, iterations, error estimate, drift, energy, seconds by phase, and the plan, as text."""
        from .report import run_report

        return run_report(self)

    def plot(self, *sensors: str, file: str) -> None:
        """Write a figure of sensor series (matplotlib); collective, rank 0 writes."""
        from .plot import plot_series

        plot_series(self, list(sensors), file)


@dataclass(frozen=True)
class Output:
    """What a run records: sensors and energies every ``every`` steps, ``snapshots`` states for pictures, a progress bar.

    ``progress``: None shows a bar on rank 0 when standard error is a terminal.
    """

    every: int = 1
    snapshots: int = 0
    energy: bool = True
    progress: bool | None = None


def solve(
    scene: Scene,
    *,
    t_end: float,
    dt: float,
    scheme: Any = None,
    newton: Newton | None = None,
    output: Output | None = None,
) -> Run:
    """Integrate a scene from t = 0 to ``t_end`` (s) with steps ``dt`` (s); collective.

    Args:
        scheme: a scheme object; :class:`GeneralizedAlpha` with rho_inf = 0.8 by default.
        newton: tolerance and limits of Newton's iteration.
        output: what is recorded how often.

    Returns:
        The run. Ctrl-C in a serial run ends it after the current step with status "stopped".

    Raises:
        InputError: unusable arguments. ConstraintError: the bodies do not fit. ConvergenceError: a step failed.
    """
    install_abort_hook()
    scheme = GeneralizedAlpha() if scheme is None else scheme
    output = Output() if output is None else output
    _check_times(t_end, dt)
    begin = clock.perf_counter()
    system, state, markers = scene.build()
    built = clock.perf_counter()
    solver = StepSolver(system)
    newton = Newton() if newton is None else Newton(newton.tolerance, newton.max_iterations, newton.slow)
    state, correction = consistent(system, state, solver)
    started = clock.perf_counter()
    steps = max(1, round(t_end / dt))
    if abs(steps * dt - t_end) > 1e-9 * t_end:
        steps = int(np.ceil(t_end / dt))
    h = t_end / steps
    stepper = scheme.stepper(system, solver, newton, state)
    recorder = _Recorder(scene, system, markers, output, steps)
    recorder.take(0, state)
    bar = _Progress(scene.name, steps, output.progress)
    status, n = "finished", 0
    local_error = 0.0
    try:
        for n in range(1, steps + 1):
            state = stepper.advance(h)
            local_error = max(local_error, stepper.local_error)
            recorder.take(n, state)
            bar.update(state.t)
    except KeyboardInterrupt:
        status = "stopped"
        log.warning("stopped on request at t = %g s", stepper.state.t)
    except ConvergenceError as error:
        raise ConvergenceError(f'Scene "{scene.name}", step {n} of {steps}: {error}') from error
    finally:
        bar.close()
    ended = clock.perf_counter()
    run = Run(
        scene=scene,
        scheme=scheme,
        plan=make_plan(scene, system),
        system=system,
        state=stepper.state,
        dt=h,
        times=np.array(recorder.times),
        series={k: np.array(x) for k, x in recorder.series.items()},
        energy={k: np.array(x) for k, x in recorder.energy.items()},
        snapshots=recorder.snapshots,
        counters={
            "steps": n,
            "newton_iterations": newton.iterations,
            "factorisations": solver.factorisations,
            "back_solves": solver.back_solves,
            "core_factorisations": solver.core.factorisations,
            "worst_linear_residual": solver.worst_residual,
        },
        seconds={
            "set-up": built - begin,
            "start": started - built,
            "steps": ended - started - recorder.seconds,
            "recording": recorder.seconds,
            "total": ended - begin,
        },
        drift=(recorder.gap, recorder.slip),
        correction=correction,
        local_error=local_error,
        status=status,
    )
    solver.destroy()
    return run


def _check_times(t_end: float, dt: float) -> None:
    require(bool(np.isfinite(dt)) and dt > 0, f"Step dt = {dt} s must be positive.")
    require(bool(np.isfinite(t_end)) and t_end > 0, f"End time t_end = {t_end} s must be positive.")
    require(dt <= t_end * (1 + 1e-12), f"Step dt = {dt} s is larger than the whole run, t_end = {t_end} s.")
    require(t_end + dt > t_end, f"Step dt = {dt} s is below the roundoff of t_end = {t_end} s: t + h == t.")


class _Recorder:
    """Series of sensors and energies, snapshots, and the drift of the constraints."""

    def __init__(self, scene: Scene, system: System, markers: dict[str, int], output: Output, steps: int) -> None:
        self.scene, self.system, self.markers, self.output, self.steps = scene, system, markers, output, steps
        self.times: list[float] = []
        self.series: dict[str, list[Array]] = {n: [] for n in scene.sensors}
        self.energy: dict[str, list[float]] = {}
        self.snapshots: list[State] = []
        self.gap = self.slip = self.seconds = 0.0
        self._keep = set(np.linspace(0, steps, output.snapshots).round().astype(int)) if output.snapshots else set()

    def take(self, n: int, state: State) -> None:
        """Record step n when it is due; collective."""
        if n in self._keep:
            self.snapshots.append(state)
        if n % self.output.every and n != self.steps:
            return
        begin = clock.perf_counter()
        ev = self.system.at(state.t, state.q, state.v)
        self.times.append(state.t)
        for name, sensor in self.scene.sensors.items():
            self.series[name].append(sensor.read(ev, state, self.markers[name]))
        if self.system.n_lam:
            self.gap = max(self.gap, float(np.abs(ev.constraint()).max()))
            rate = ev.jacobian.times(state.v) + ev.constraint_rate()
            self.slip = max(self.slip, float(np.abs(rate).max()))
        if self.output.energy:
            for name, value in ev.energies().items():
                self.energy.setdefault(name, []).append(value)
        self.seconds += clock.perf_counter() - begin


class _Progress:
    """A bar with the time left, on rank 0 of a terminal; a log line every 30 s elsewhere."""

    def __init__(self, name: str, steps: int, wanted: bool | None) -> None:
        self.bar: Callable[..., Any] | None = None
        show = sys.stderr.isatty() if wanted is None else wanted
        if not show or world_rank() != 0:
            return
        try:
            from tqdm import tqdm
        except ImportError:
            return
        self.bar = tqdm(total=steps, desc=name, unit="step", file=sys.stderr, mininterval=0.2)

    def update(self, t: float) -> None:
        """One step done."""
        if self.bar is not None:
            self.bar.update(1)

    def close(self) -> None:
        """Remove the bar's hold on the terminal."""
        if self.bar is not None:
            self.bar.close()
