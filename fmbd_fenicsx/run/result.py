"""What a run left behind: series, last state, counts, seconds, stated errors; and how it is shown and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..checks import typed, word
from ..errors import InputError, Told, near
from ..rotations import Array
from ..schemes.consistent import Correction
from ..system.layout import State
from ..system.own_state import refuse_other_state
from ..system.scene.going_on import Origin
from ..system.scene.plan import Plan
from ..system.scene.scene import Scene
from ..system.system import System
from ..uncopied import Uncopied
from .accuracy.deviation import Deviation, sizes
from .recording.ledger import Books, Ledger, make_ledger

if TYPE_CHECKING:
    from ..post.drawing.view import Paint, View
    from .accuracy.certificate import Certificate


@dataclass(repr=False)
class Run(Uncopied):
    """What a run left behind; equal on all ranks but for the field values in ``state`` and ``snapshots``.

    Attributes:
        scene, scheme, plan: what was solved, how, and what existed.
        dt: step size used, s (``t_end`` divided by a whole number of steps).
        times: (n,) s; ``series``: sensor name -> (n, size) values; ``energy``: kind -> (n,) J.
        state, system: the last state and its system; ``kept``: what elements remember then. ``snapshots``: those for pictures.
        counters: steps, Newton iterations, factorisations, back-solves. ``seconds``: by phase.
        warnings: what was warned of during the run, and what is doubtful at its end; in the report under "look at this".
        not_unique: joints whose reactions are not unique at the end, of which the smallest are given.
        drift: largest position constraint (m) and velocity constraint (m/s) residual seen.
        local_error: the scheme's own indicator of the error of one step, largest over the run (m, rad).
        observed_order: sensor name -> order in h seen in the runs of the estimate, nan where it could not be
            seen.
        space_unstated: what of the error by the meshes could not be stated, and why. ``joint``: the kind of error, of time and
            space, that holds the other; "" where each is stated.
        newton_accuracy: mean relative error that Newton's iteration left: its tolerance or less.
        deviations: kind (space, time, modes, algebra) -> sensor -> estimated error over time, with its sign.
        history: attempts of :func:`solve` with ``tol``.
        memory: peak memory of the largest rank, bytes.
        status: "finished", or "stopped" on request. ``step_limit``: of steps that the scheme chooses, s.
        struck: sensor -> a record (s) that an impact may be on the other side of, and by how much it jumps there.
        damped: sensor -> amplitude of vibrations that steps do not resolve and the scheme takes out, where that is more than
            runs with other steps tell.
        jumps: instants (s) within equal steps at which loads or drives jump, where errors are stated.
        halved: whether errors of time of equal steps are told by a run with half of them, ``alone`` where larger ones do not
            make it whole, so that no order was seen.
        at_steps: times and series of sensors at ends of equal steps, where records are at given times and errors are stated.
    """

    instead: ClassVar[str] = (
        "Keep what you need of it, run.series, run.times or run.to_xarray(); fmbd.study.map runs variants on all cores."
    )

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
    observed_order: dict[str, float] = field(default_factory=dict)
    space_unstated: str = ""
    joint: str = ""
    newton_accuracy: float = 1e-6
    deviations: dict[str, dict[str, Deviation]] = field(default_factory=dict)
    history: tuple[Any, ...] = ()
    memory: float = 0.0
    status: str = "finished"
    step_limit: float = np.inf
    damped: dict[str, float] = field(default_factory=dict)
    struck: dict[str, tuple[float, float]] = field(default_factory=dict)
    jumps: tuple[float, ...] = ()
    halved: bool = False
    alone: bool = False
    at_steps: tuple[Array, dict[str, Array]] | None = None
    not_unique: list[str] = field(default_factory=list)
    books: Books | None = None
    warnings: list[str] = field(default_factory=list)
    kept: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        self.energy = Told("Energies of a run (run.total_energy is their sum)", self.energy)
        self.counters = Told("Counters of a run", self.counters)

    def __getitem__(self, sensor: str) -> Array:
        """Series of a sensor, (n, size), or of one of its components, ``run["tip y"]``, (n,)."""
        word("run[...]: name of a sensor", sensor)
        if sensor in self.series:
            return self.series[sensor]
        known = {label: (name, k) for name in self.series for k, label in enumerate(self.components(name))}
        if sensor not in known:
            raise InputError(f'No sensor "{sensor}". {near(sensor, dict.fromkeys((*self.series, *known)))}')
        name, k = known[sensor]
        return self.series[name][:, k]

    def components(self, sensor: str) -> list[str]:
        """Labels of a sensor's components: "tip x" and so on; the bare name of a scalar."""
        size = self[sensor].shape[1]
        if size == 1:
            return [sensor]
        given = self.scene.sensors[sensor].labels
        return [f"{sensor} {given[k] if k < len(given) else k + 1}" for k in range(size)]

    @property
    def error_estimate(self) -> dict[str, float]:
        """Sensor name -> estimated time-discretisation error, in the sensor's unit; empty when not asked for."""
        return self._largest("time", "estimate_error")

    @property
    def reduction_error(self) -> dict[str, float]:
        """Sensor name -> estimate from above of the error by left-out modes of reduced bodies, in the sensor's unit; empty when
        not asked for and without reduced bodies.
        """
        return self._largest("modes", "estimate_reduction")

    @property
    def space_error(self) -> dict[str, float]:
        """Sensor name -> estimated error by the meshes, in the sensor's unit; empty when not asked for."""
        return self._largest("space", "estimate_space")

    def _largest(self, kind: str, asked: str) -> dict[str, float]:
        """The largest errors of a kind, of Output(<asked>=True)."""
        return Told(f"Errors of Output({asked}=True)", sizes(self.deviations.get(kind, {})))

    def next_scene(self) -> Scene:
        """The scene of this run to go on with from its last state: joints may be released, others close on what they find.

            flight = run.next_scene()
            del flight.joints["sling"]
            later = fmbd.solve(flight, t_end=3.0, dt=1e-3)

        Its runs begin at the last time of this one, at an event where one has ended it; what elements remember is kept where
        all of their kind are still there. A new joint takes its first body's point and axes, as that body was placed at first,
        and its second body where it is (a mass at its place); velocities against it go as in an impact without rebound. Errors
        of time and algebra are stated as of any run, those of modes and meshes are not.
        """
        return replace(self.scene, settle=False, origin=Origin(self.scene, self.system, self.state, self.kept))

    def report(self) -> str:
        """Steps, iterations, error estimate, drift, energy, seconds by phase, and the plan, as text; not
        collective.
        """
        from ..post.report import run_report

        return run_report(self)

    @property
    def certificate(self) -> Certificate:
        """Errors of space, time, reduction and algebra of every sensor, their sum, and what could not be stated."""
        from .accuracy.certificate import certificate_of

        return certificate_of(self)

    @property
    def ledger(self) -> Ledger:
        """Work and power of every force, drive and damping, and the change of energy that they explain; of a run with
        ``Output(ledger=True)``.
        """
        return make_ledger(self.times, self.energy, self.books)

    @typed
    def plot_history(self, file: str | Path) -> None:
        """Write the error against the seconds of every attempt of a run with ``tol`` (matplotlib); rank 0 writes."""
        from ..post.plot import plot_history

        plot_history(self, file)

    @property
    def shown(self) -> list[State]:
        """The snapshots; where there are none the last state, which every run holds."""
        return self.snapshots or [self.state]

    @property
    def total_energy(self) -> Array:
        """Sum of the recorded energies, (n,) J."""
        return np.sum(list(self.energy.values()), axis=0)

    @typed
    def momenta(self, state: State | None = None) -> tuple[Array, Array]:
        """Momentum (N s) and angular momentum about the origin (N m s) of a state, the last by default; collective."""
        s = self.state if state is None else state
        refuse_other_state(self.system, s, self.scene.name)
        return self.system.at(s.t, s.q, s.v).momenta()

    @typed
    def plot(self, *sensors: str, file: str | Path, reference: Mapping[str, Any] | None = None) -> None:
        """Write a figure of sensor series over time (matplotlib); rank 0 writes.

        Args:
            sensors: names of sensors ("tip") or of their components ("tip y"); all sensors when none is given.
            reference: name -> exact value as a function of time (s), drawn behind the curve, or (times, values),
                drawn as crosses.
        """
        from ..post.plot import plot_series

        plot_series(self, sensors, file, reference)

    @typed
    def save(self, file: str | Path) -> None:
        """Write times, sensors with units and energies as comma-separated values; rank 0 writes.

        Stated errors of sensors go to a second file beside it, ``<name>.errors.csv``.
        """
        from ..post.exchange.export import save_series

        save_series(self, file)

    def to_xarray(self) -> Any:
        """All sensors and energies over time as an ``xarray.Dataset`` with units and names of components; ``.to_netcdf(file)``
        writes it. Needs xarray.
        """
        from ..post.exchange.export import to_xarray

        return to_xarray(self)

    def to_pandas(self) -> Any:
        """All sensors and energies as a ``pandas.DataFrame`` over time, columns "tip x (m)". Needs pandas."""
        from ..post.exchange.export import to_pandas

        return to_pandas(self)

    @typed
    def save_fields(self, folder: str | Path, quantities: Mapping[str, Any] | None = None) -> list[Path]:
        """Write the snapshots of elastic bodies for ParaView, ``folder/<body>.pvd``; collective. Returns the files.

        Each holds the displacement x - X of the true motion, for "Warp by Vector", and ``quantities`` in the middle of each cell:
        name -> UFL expression of the displacement in the body's axes, as for :func:`fmbd_fenicsx.stress`.
        """
        from ..post.exchange.export import save_fields

        return save_fields(self, folder, quantities)

    @typed
    def picture(
        self,
        file: str | Path,
        *,
        sensors: Sequence[str] | str = (),
        view: View | None = None,
        paint: Paint | None = None,
        reference: Mapping[str, Any] | None = None,
    ) -> None:
        """Write a picture of some snapshots, of the last state where there are none (pyvista), with histories of sensors beside
        it; collective, rank 0 writes.

        Args:
            sensors: names of sensors or of their components ("tip y").
            view: camera, number of instants, arrows; see :class:`~fmbd_fenicsx.View`.
            paint: a quantity that colours elastic bodies; else they are coloured by time.
            reference: what is known of sensors, as for :meth:`plot`.
        """
        from ..post.plot import picture

        names = [sensors] if isinstance(sensors, str) else sensors
        picture(self, file, sensors=names, view=view, paint=paint, reference=reference)

    @typed
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

    @typed
    def show(self, *, sensors: Sequence[str] | str = (), view: View | None = None, paint: Paint | None = None) -> Any:
        """The animation to look at: in a notebook as the last expression of a cell, else in the web browser; collective.

        Raises InputError without snapshots, and where there is neither a notebook nor a screen.
        """
        from ..post.animation import show

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
