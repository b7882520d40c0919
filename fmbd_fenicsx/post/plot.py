"""Figures of runs (matplotlib): sensor series, snapshots beside a history, error against work. Rank 0 writes, no window
opens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..checks import typed, words
from ..errors import InputError
from ..ranks import on_root, world_rank
from ..rotations import Array
from ..run.result import Run
from ..schemes.declared import Declared
from .drawing.render import ARROWS, strobe
from .drawing.scene_graph import Deforming, Drawing, Role
from .drawing.view import Paint, View
from .figures import REFERENCE, STYLE, add_legend, add_title, empty_figure, figure, save_figure, set_label, set_ticks

__all__ = ["REFERENCE", "STYLE", "figure", "picture", "plot_history", "plot_series", "plot_work_precision", "shapes"]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


MARKS = "osD^vP*X"
CROSSES: dict[str, Any] = {"color": "k", "linestyle": "", "marker": "x", "markersize": 9, "zorder": 4, "clip_on": False}
"""How single known values are drawn: above curves and dots, whole at the end of the time axis too."""

Known = Callable[[float], Any] | tuple[Any, Any]
"""What is known of a sensor: its value as a function of time (s), or (times, values) that are drawn as crosses."""


class Comparison(Protocol):
    """What a work-precision figure needs of a :class:`~fmbd_fenicsx.post.study.WorkPrecision`."""

    @property
    def points(self) -> Sequence[Any]:
        """Runs: label, errors by quantity, seconds, counters, failure."""

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the errors."""

    @property
    def quantities(self) -> list[str]:
        """Names of the compared quantities."""


def _comm(run: Run) -> Any:
    return run.system.comm


def series_of(run: Run, name: str) -> tuple[list[str], Array, str]:
    """Labels, values (n, size) and unit of a sensor ("tip"), or of one of its components ("tip y")."""
    for sensor in run.series:
        labels = run.components(sensor)
        if name in labels and len(labels) > 1:
            k = labels.index(name)
            return [name], run[sensor][:, k][:, None], run.scene.sensors[sensor].unit_of(k)
    return run.components(name), run[name], run.scene.sensors[name].unit


def draw_history(axes: Any, run: Run, name: str, known: Known | None = None) -> None:
    """Curves of a sensor's components over time, with units, and what is known of them."""
    labels, values, unit = series_of(run, name)
    if known is not None:
        # known values behind the curves, or crosses on them
        points = isinstance(known, tuple)
        t, x = known if isinstance(known, tuple) else (run.times, [known(float(t)) for t in run.times])
        look = CROSSES if points else REFERENCE
        lines = axes.plot(t, np.reshape(x, (np.size(t), -1)), **look)
        lines[0].set_label("reference")

    stated = run.certificate[name].total if name in run.series and _certified(run) else 0.0
    for label, x in zip(labels, values.T, strict=True):
        (curve,) = axes.plot(run.times, x, label=label, linewidth=1.4)
        if stated > 0:  # a band of the stated error
            axes.fill_between(run.times, x - stated, x + stated, color=curve.get_color(), alpha=0.2, linewidth=0)

    set_label(axes, name, unit)
    axes.set_xlim(run.times[0], max(run.times[-1], run.times[0] + 1e-300))
    if len(labels) > 1 or known is not None:
        add_legend(axes)


def _certified(run: Run) -> bool:
    """Whether the run states its errors of space and time."""
    return bool(run.error_estimate) and not run.certificate.unstated


def _of(run: Run) -> str:
    """What a figure of a run is called: scene, scheme, and its step or tolerance."""
    said = Declared.by(run.scheme)
    step = "" if said.timeless else f", rtol = {said.rtol:g}" if said.adaptive else f", h = {run.dt:.4g} s"
    return f"{run.scene.name}: {run.scheme.name}{step}"


def shapes(axes: Any, run: Run, *, paint: tuple[Any, Callable[[Any], Any], str] | None = None) -> None:
    """Draw the snapshots' elastic bodies of a plane scene on axes of :func:`figure`, deformed, coloured by time; collective.

    ``paint``: (body, scalar quantity(u) in UFL, label with unit) colours this body's cells instead.
    """
    from .drawing.draw import draw

    painted = None if paint is None else Paint(paint[1], paint[2], (paint[0],))
    drawing = draw(run, view=View(symbols=False), paint=painted)
    if world_rank() != 0:
        return
    times, shown = drawing.times, None
    span = (times[0], times[-1]) if paint is None else drawing.span
    meshed = [p for p in drawing.pieces if p.role is Role.BODY and isinstance(p.motion, Deforming)]

    for k, t in enumerate(times):
        for piece in meshed:
            x = piece.at(k)
            axes.plot(*x[piece.edges].transpose(2, 1, 0)[:2], color="0.25", linewidth=0.6, zorder=1.5 + k)
            if paint is None or piece.paint is not None:
                faces = np.full(len(piece.triangles), t) if piece.paint is None else piece.paint[k]
                look = {"facecolors": faces, "vmin": span[0], "vmax": span[1], "zorder": 1 + k}
                shown = axes.tripcolor(*x.T[:2], piece.triangles, **look)

    axes.figure.colorbar(shown, ax=axes, label="time (s)" if paint is None else paint[2], shrink=0.9)
    axes.grid(False)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")


def plot_series(
    run: Run, sensors: Sequence[str], file: str | Path, reference: Mapping[str, Known] | None = None
) -> None:
    """Write sensor series over time, one axes for each sensor or component ("tip y"), all sensors when none is named, with
    what is known of them; collective.
    """
    names = list(words("plot: sensors", sensors) or run.series)
    known = dict(reference or {})
    for name in [*names, *known]:
        series_of(run, name)

    def draw() -> None:
        matplotlib, figure = empty_figure(6.4, 1.0 + 2.0 * len(names))
        with matplotlib.rc_context(STYLE):
            rows = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
            for axes, name in zip(rows, names, strict=True):
                draw_history(axes, run, name, known.get(name))
            rows[-1].set_xlabel("time (s)")
            add_title(figure, _of(run))
            save_figure(figure, file, 200)

    on_root(_comm(run), draw)


def plot_history(run: Run, file: str | Path) -> None:
    """Stated error over tolerance against seconds, of every attempt of a run with ``tol``, in the order they were made."""
    if not run.history:
        raise InputError("This run has no history: it was made without tol=.")
    if world_rank() != 0:
        return

    mpl, fig = empty_figure(6.0, 4.0)
    with mpl.rc_context(STYLE):
        axes = fig.add_subplot()
        stated = [a for a in run.history if np.isfinite(a.worst)]
        axes.loglog([a.seconds for a in stated], [a.worst for a in stated], "o-", color="C0")
        axes.axhline(1.0, color="0.6", linestyle="--")
        # each attempt by its step
        for a in stated:
            axes.annotate(f"  {a.step:.1g}", (a.seconds, a.worst), fontsize=8)
        axes.set(xlabel="seconds, estimates included (s)", ylabel="stated error over tolerance", title=run.scene.name)
        save_figure(fig, file, 150)


@typed
def picture(
    run: Run,
    file: str | Path,
    *,
    sensors: Sequence[str] = (),
    view: View | None = None,
    paint: Paint | None = None,
    reference: Mapping[str, Known] | None = None,
) -> None:
    """Write some of a run's snapshots in one image, coloured by time or by ``paint``, and histories of sensors beside them, over
    what is known of them; collective.
    """
    from .drawing.draw import draw

    known = dict(reference or {})
    names = list(dict.fromkeys((*sensors, *known)))
    for name in names:
        series_of(run, name)
    view = View() if view is None else view
    states = chosen(run.shown, view.instants)
    drawing = draw(run, view=view, paint=paint, states=states)

    def write() -> None:
        matplotlib, figure = empty_figure(10.5 if names else 6.4, max(4.2, 2.1 * len(names)))

        # colours tell the time
        times = drawing.times
        norm = matplotlib.colors.Normalize(times.min(), max(times.max(), times.min() + 1e-300))
        colormap = matplotlib.colormaps["viridis"]
        colors = [colormap(norm(t))[:3] for t in times]

        with matplotlib.rc_context(STYLE):
            left, *right = _panels(figure, len(names))
            _show(left, strobe(drawing, view, None if paint or len(times) == 1 else colors))
            _scale(figure, left, drawing, (norm, colormap))
            arrow_legend(left, drawing)
            for axes, name in zip(right, names, strict=True):
                draw_history(axes, run, name, known.get(name))
                _dots(axes, run, name, (states, colors))
                axes.set_xlabel("time (s)")
            add_title(figure, _of(run))
            save_figure(figure, file, 200)

    on_root(_comm(run), write)


def chosen(snapshots: Sequence[Any], count: int) -> list[Any]:
    """At most ``count`` of the snapshots, evenly spaced, first and last included."""
    if len(snapshots) <= count:
        return list(snapshots)
    numbers = np.linspace(0, len(snapshots) - 1, count).round().astype(int) if count > 1 else [len(snapshots) - 1]

    return [snapshots[k] for k in numbers]


def _panels(figure: Any, rows: int) -> list[Any]:
    """One large axes to the left, ``rows`` to the right."""
    if not rows:
        return [figure.subplots()]
    grid = figure.add_gridspec(rows, 2)

    return [figure.add_subplot(grid[:, 0]), *(figure.add_subplot(grid[k, 1]) for k in range(rows))]


def _scale(figure: Any, axes: Any, drawing: Drawing, by_time: tuple[Any, Any]) -> None:
    """A colour bar: what is painted, else the time where there are several instants."""
    import matplotlib

    norm, colormap = by_time
    if drawing.label:
        norm = matplotlib.colors.Normalize(*drawing.span)
    elif len(drawing.times) == 1:
        return
    scale = matplotlib.cm.ScalarMappable(norm, colormap)
    figure.colorbar(scale, ax=axes, label=drawing.label or "time (s)", shrink=0.8)


def arrow_legend(axes: Any, drawing: Drawing, **look: Any) -> None:
    """Above the axes: what the arrows of forces stand for, and the force of the longest; nothing where none are drawn."""
    if not drawing.scales:
        return
    from matplotlib.lines import Line2D

    look = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.2} | look
    lines = [Line2D([], [], color=ARROWS[s.shade], marker=">", label=s.text) for s in drawing.scales]
    axes.legend(handles=lines, **look)


def _show(axes: Any, view: Any) -> None:
    """The image; in the plane with its coordinates."""
    axes.grid(False)
    axes.imshow(view.image, extent=view.extent, interpolation="antialiased")
    if view.extent is None:
        axes.axis("off")
    else:
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")
        x0, x1, y0, y1 = view.extent
        axes.locator_params(axis="x", nbins=6 if x1 - x0 > 0.6 * (y1 - y0) else 3)
        axes.locator_params(axis="y", nbins=6)


def _dots(axes: Any, run: Run, sensor: str, at: tuple[Sequence[Any], Sequence[Any]]) -> None:
    """Mark instants on a history in their colours; ``at``: (states, colours)."""
    states, colors = at
    rows = [int(np.argmin(np.abs(run.times - s.t))) for s in states]
    for x in series_of(run, sensor)[1].T:
        axes.scatter(
            run.times[rows], x[rows], c=colors, s=30, zorder=3, edgecolors="#303030", linewidths=0.6, clip_on=False
        )


def plot_work_precision(study: Comparison, file: str | Path, work: str, title: str = "") -> None:
    """Write error over work, both logarithmic, one axes for each quantity, one line for each configuration;
    rank 0.
    """
    if world_rank() != 0:
        return
    names = study.quantities
    if not names:
        raise InputError("No run of this study finished: there is nothing to draw.")

    matplotlib, figure = empty_figure(1.2 + 3.6 * len(names), 4.0)
    labels = list(dict.fromkeys(p.label for p in study.points))
    with matplotlib.rc_context(STYLE):
        for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
            for k, label in enumerate(labels):
                points = [p for p in study.points if p.label == label and not p.failure]
                x = [p.seconds if work == "seconds" else p.counters[work] for p in points]
                mark = MARKS[k % len(MARKS)]
                axes.loglog(x, [p.errors[name] for p in points], marker=mark, markersize=4, label=label)

            axes.set_xlabel("time in steps (s)" if work == "seconds" else work.replace("_", " "))
            unit = f" ({study.units[name]})" if name in study.units else ""
            axes.set_ylabel(f"largest error of {name}{unit}")
            set_ticks(axes)

        # one legend for all axes, below them
        columns = max(int(figure.get_figwidth() / (0.6 + 0.08 * max(map(len, labels)))), 1)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=columns)
        add_title(figure, title or "Error against " + ("time" if work == "seconds" else work.replace("_", " ")))
        save_figure(figure, file, 200)
