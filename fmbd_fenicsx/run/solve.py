"""A run of a scene: consistent start, the march, error estimates, and what is left of them; one answer on all ranks."""

from __future__ import annotations

import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..checks import instance
from ..errors import InputError, Stopped, near, require
from ..linear.condensation import StepSolver
from ..linear.redundancy import not_unique
from ..log import install_hooks, peak_memory
from ..notices import Gathered
from ..rotations import Array
from ..schemes.consistent import Correction
from ..schemes.dae import Index3
from ..schemes.declared import Declared
from ..schemes.newton import Newton
from ..schemes.onestep.generalized_alpha import GeneralizedAlpha
from ..system.scene.plan import Plan, make_plan
from ..system.scene.scene import Scene
from ..system.system import State, System
from .deviation import Deviation, sizes
from .doubts import warn_of_doubts
from .estimates import Compared, state_errors
from .ledger import Books, Ledger, make_ledger
from .output import Output, refuse_too_many
from .rank_advice import advise_on_ranks
from .schedule import Pace, pace_of
from .settings import check_pressures, check_settings, checked_scheme
from .time_loop import March, Problem, begin, make_solver, march

if TYPE_CHECKING:
    from ..post.drawing.view import Paint, View
    from .certificate import Certificate
    from .checkpoint import Checkpoint, Keeper


@dataclass(repr=False)
class Run:
    """What a run left behind; equal on all ranks but for the field values in ``state`` and ``snapshots``.

    Attributes:
        scene, scheme, plan: what was solved, how, and what existed.
        dt: step size used, s (``t_end`` divided by a whole number of steps).
        times: (n,) s; ``series``: sensor name -> (n, size) values; ``energy``: kind -> (n,) J.
        state, system: the last state and its system. ``snapshots``: states kept for pictures.
        counters: steps, Newton iterations, factorisations, back-solves. ``seconds``: by phase.
        warnings: what was warned of during the run, and what is doubtful at its end; in the report under "look at this".
        not_unique: joints whose reactions are not unique at the end, of which the smallest are given.
        drift: largest position constraint (m) and velocity constraint (m/s) residual seen.
        local_error: the scheme's own indicator of the error of one step, largest over the run (m, rad).
        error_estimate: sensor name -> estimated time-discretisation error, in the sensor's unit; empty when
            not asked for.
        observed_order: sensor name -> order in h seen in the runs of the estimate, nan where it could not be
            seen.
        reduction_error: sensor name -> estimate from above of the error by left-out modes of reduced bodies, in the
            sensor's unit; empty when not asked for and without reduced bodies.
        space_error: sensor name -> estimated error by the meshes, in the sensor's unit; empty when not asked for.
            ``space_unstated``: what of it could not be stated, and why.
        newton_accuracy: mean relative error that Newton's iteration left: its tolerance or less.
        deviations: kind (space, time, modes) -> sensor -> estimated error over time, with its sign.
        history: attempts of :func:`solve` with ``tol``.
        memory: peak memory of the largest rank, bytes.
        status: "finished", or "stopped" on request.
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
    reduction_error: dict[str, float] = field(default_factory=dict)
    space_error: dict[str, float] = field(default_factory=dict)
    space_unstated: str = ""
    newton_accuracy: float = 1e-6
    deviations: dict[str, dict[str, Deviation]] = field(default_factory=dict)
    history: tuple[Any, ...] = ()
    memory: float = 0.0
    status: str = "finished"
    not_unique: list[str] = field(default_factory=list)
    books: Books | None = None
    warnings: list[str] = field(default_factory=list)

    def __getitem__(self, sensor: str) -> Array:
        """Series of a sensor, (n, size)."""
        if sensor not in self.series:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self.series)}')
        return self.series[sensor]

    def state_error(self, kind: str, found: dict[str, Deviation]) -> None:
        """Take the estimated errors of one kind: "space", "time" or "modes"."""
        self.deviations[kind] = found
        if kind == "time":
            self.error_estimate = sizes(found)
        elif kind == "modes":
            self.reduction_error = sizes(found)
        else:
            self.space_error = sizes(found)

    def report(self) -> str:
        """Steps, iterations, error estimate, drift, energy, seconds by phase, and the plan, as text; not
        collective.
        """
        from ..post.report import run_report

        return run_report(self)

    @property
    def certificate(self) -> Certificate:
        """Errors of space, time, reduction and algebra of every sensor, their sum, and what could not be stated."""
        from .certificate import certificate_of

        return certificate_of(self)

    @property
    def ledger(self) -> Ledger:
        """Work and power of every force, drive and damping, and the change of energy that they explain; of a run with
        ``Output(ledger=True)``.
        """
        return make_ledger(self.times, self.energy, self.books)

    def plot_history(self, file: str | Path) -> None:
        """Write the error against the seconds of every attempt of a run with ``tol`` (matplotlib); rank 0 writes."""
        from ..post.plot import plot_history

        plot_history(self, file)

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
        from ..post.plot import plot_series

        plot_series(self, sensors, file, reference)

    def save(self, file: str | Path) -> None:
        """Write times, sensors with units and energies as comma-separated values; rank 0 writes.

        Stated errors of sensors go to a second file beside it, ``<name>.errors.csv``.
        """
        from ..post.export import save_series

        save_series(self, file)

    def to_xarray(self) -> Any:
        """All sensors and energies over time as an ``xarray.Dataset`` with units and names of components; ``.to_netcdf(file)``
        writes it. Needs xarray.
        """
        from ..post.tables import to_xarray

        return to_xarray(self)

    def to_pandas(self) -> Any:
        """All sensors and energies as a ``pandas.DataFrame`` over time, columns "tip x (m)". Needs pandas."""
        from ..post.tables import to_pandas

        return to_pandas(self)

    def save_fields(self, folder: str | Path, quantities: Mapping[str, Any] | None = None) -> list[Path]:
        """Write the snapshots of elastic bodies for ParaView, ``folder/<body>.pvd``; collective. Returns the files.

        Each holds the displacement x - X of the true motion, for "Warp by Vector", and ``quantities`` in the middle of each cell:
        name -> UFL expression of the displacement in the body's axes, as for :func:`fmbd_fenicsx.stress`.
        """
        from ..post.export import save_fields

        return save_fields(self, folder, quantities)

    def picture(
        self,
        file: str | Path,
        *,
        sensors: Sequence[str] | str = (),
        view: View | None = None,
        paint: Paint | None = None,
        reference: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a picture of some snapshots (pyvista), with the histories of sensors beside it; collective, rank 0 writes.

        Args:
            sensors: names of sensors or of their components ("tip y").
            view: camera, number of instants, arrows; see :class:`~fmbd_fenicsx.View`.
            paint: a quantity that colours elastic bodies; else they are coloured by time.
            reference: what is known of sensors, as for :meth:`plot`.
        """
        from ..post.plot import picture

        names = [sensors] if isinstance(sensors, str) else sensors
        picture(self, file, sensors=names, view=view, paint=paint, reference=reference)

    def animate(
        self,
        file: str | Path,
        *,
        sensors: Sequence[str] | str = (),
        view: View | None = None,
        paint: Paint | None = None,
        seconds: float | None = None,
    ) -> Path:
        """Write an animation of the snapshots, ``.gif``, ``.mp4`` (ffmpeg) or ``.html``; collective, rank 0 writes.

            run = fmbd.solve(scene, ..., output=fmbd.Output(snapshots=100))
            run.animate("arm.gif", sensors="tip", paint=fmbd.Paint(von_mises, "von Mises stress (Pa)"))

        A web page (.html) needs no other file and no network: it turns, zooms, plays and stops.

        Args:
            sensors: names of sensors or of their components, drawn beside the scene with a dot at the present instant.
            view: camera, size, arrows of forces; see :class:`~fmbd_fenicsx.View`.
            paint: a quantity that colours elastic bodies.
            seconds: how long it lasts; by default the simulated time where that is 2 s to 12 s, else 5 s.

        Raises:
            InputError: no snapshots, an unknown sensor or kind of file, no ffmpeg for .mp4.
        """
        from ..post.animation import animate

        return animate(self, file, sensors=sensors, view=view, paint=paint, seconds=seconds)

    def show(self, *, sensors: Sequence[str] | str = (), view: View | None = None, paint: Paint | None = None) -> Any:
        """The animation to look at: in a notebook as the last expression of a cell, else in the web browser; collective.

        Raises InputError without snapshots, and where there is neither a notebook nor a screen.
        """
        from ..post.showing import show

        return show(self, sensors=sensors, view=view, paint=paint)

    def __repr__(self) -> str:
        steps = f"{self.counters.get('steps', 0):.0f} steps to t = {self.state.t:g} s"
        return (
            f'<Run of "{self.scene.name}": {self.scheme.name}, {steps}, '
            f"{self.status}; sensors {', '.join(self.series) or 'none'}; {len(self.snapshots)} snapshots>"
        )

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.report())}</pre>"


def solve(
    scene: Scene,
    *,
    t_end: float,
    dt: float | None = None,
    scheme: Any = None,
    tol: Mapping[str, Any] | None = None,
    newton: Newton | None = None,
    output: Output | None = None,
    linear: Any = None,
    checkpoint: Checkpoint | None = None,
    restart: str | Path | None = None,
) -> Run:
    """Integrate a scene from t = 0 to ``t_end`` (s) with steps of at most ``dt`` (s); collective.

    Args:
        dt: needed for schemes with constant steps. A scheme with error control (``rtol``) chooses its steps,
            none above dt.
        scheme: a scheme object; :class:`GeneralizedAlpha` with rho_inf = 0.8 by default, ``ContactMidpoint``
            with contact.
        tol: sensor name -> largest error (in the sensor's unit, or :func:`relative` to its range) that the run may state of
            itself. Steps, modes and meshes are refined until the certificate is below; ``dt`` and the scene are where it
            starts. Every attempt is a line of ``run.history``; where the tolerance is not reached the best run is given, with
            a warning that says why.
        newton: tolerance and limits of Newton's iteration.
        output: what is recorded how often, and whether the time-discretisation error is estimated.
        linear: how elastic bodies and ties are solved: :class:`Direct` (the default), :class:`Schur`,
            :class:`FieldSplit`. PETSc's options of a block are those under ``-<scene>_<block>_``, of a split
            ``-<scene>_fieldsplit_<block>_``, spaces written as ``_``.
        checkpoint: where and how often the run is kept; signals and a file STOP then end it so that it can go on.
        restart: a checkpoint, or a folder of them whose newest is taken, from which the run goes on; None starts at t = 0.

    Raises:
        InputError: unusable arguments. ConstraintError: the bodies do not fit. ConvergenceError: a step
            failed.
        Stopped: Ctrl-C in a serial run, or a request to stop with a ``checkpoint``; ``run`` of the exception holds the run up
            to the step that was under way.
        CheckpointError: a checkpoint is damaged, belongs to another run, or cannot be written.
    """
    install_hooks()
    check_settings(scene, newton, output, restart)
    if tol is not None:
        instance("solve: tol", tol, Mapping)
        from .tolerance import solve_within

        require(
            checkpoint is None and restart is None, "A run with tol is made of several runs: no checkpoint, no restart."
        )
        return solve_within(scene, dict(tol), t_end=t_end, start=(scheme, dt), settings=(newton, output, linear))
    scheme = default_scheme(scene) if scheme is None else checked_scheme(scheme)
    output = Output() if output is None else output
    newton = Newton() if newton is None else newton.afresh()
    require(
        newton.tangent is None or (type(scheme) is GeneralizedAlpha and isinstance(scheme.form, Index3)),
        f"{scheme.name} has no exact tangent. Use scheme=fmbd.GeneralizedAlpha(), or leave out Newton's tangent.",
    )
    halvings = output.estimate_error and not Declared.by(scheme).adaptive
    pace = pace_of(scene, scheme, t_end, dt, multiple=4 if halvings else 1)
    called = clock.perf_counter()
    with Gathered() as warned:
        system, given, markers = scene.build()
    check_pressures(system, scheme)
    refuse_too_many(output, system, pace.t_end, pace.steps)
    advise_on_ranks(system)
    built = clock.perf_counter()
    solver = make_solver(scene, system, linear)
    newton.refresh = solver.refresh
    keeper: Keeper | None = None
    try:
        with warned:
            start, correction = begin(scene, scheme, system, given, solver=solver, h=pace.next(0.0))
            started = clock.perf_counter()
            problem = Problem(scene, system, markers, given, start, scheme, newton, linear, solver.pressures, warned)
            keeper = (
                None if checkpoint is None and restart is None else _keeper(problem, pace, output, checkpoint, restart)
            )
            marched = march(problem, solver, pace, output, keeper)
            ended = clock.perf_counter()
            counters = _counters(marched, newton, solver)
            undetermined = not_unique(solver, marched.state)
            warn_of_doubts(scene, solver, marched.recorder, counters)
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
            "set-up": built - called,
            "start": started - built,
            "steps": ended - started + marched.earlier - marched.recorder.seconds,
            "recording": marched.recorder.seconds,
            "total": ended - called + marched.earlier,
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
    state_errors(run, problem, Compared(marched.recorder, pace), output)
    return run


def default_scheme(scene: Scene) -> Any:
    """Generalized-alpha; for contact the contact-implicit midpoint rule, for joints with limits the scheme with impacts."""
    if not scene.unilateral:
        return GeneralizedAlpha()
    if scene.limits:
        from ..schemes.impacts.moreau import Moreau

        return Moreau()
    from ..schemes.impacts.contact_midpoint import ContactMidpoint

    return ContactMidpoint()


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
