"""Figures of own axes (matplotlib): their look, legends that lie on no curve, titles that fit. Rank 0 writes, no window opens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..ranks import world_rank
from .exchange.files import write_whole

STYLE = {
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "font.size": 10,
    "legend.frameon": False,
    "legend.fontsize": 9,
}
REFERENCE: dict[str, Any] = {"color": "0.75", "linewidth": 4.5, "linestyle": "-", "zorder": 0}
"""How an exact or finer solution is drawn: wide and grey, behind the results (``axes.plot(t, x, **REFERENCE)``)."""

LETTER = 0.08  # inches of a letter of a label


def save_figure(figure: Any, file: str | Path, dpi: int) -> None:
    """Write a figure.

    Raises:
        InputError: no such folder, or a kind of file that matplotlib does not write.
    """
    try:
        write_whole("The picture", file, lambda place: figure.savefig(place, dpi=dpi))
    except InputError:
        raise  # no such folder, and the like
    except ValueError as error:
        raise InputError(f'The picture cannot be written to "{file}": {error}') from error


def empty_figure(width: float, height: float) -> tuple[Any, Any]:
    """A matplotlib module and an empty figure (inches) that belongs to no window."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError("A figure needs matplotlib: install fmbd_fenicsx[plot].") from error
    return matplotlib, Figure(figsize=(width, height), layout="constrained")


def add_legend(axes: Any) -> None:
    """A legend above the axes, or beside them when it is long: never on a curve; each label once."""
    named = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    labels = list(named)
    if len(labels) > 9:
        axes.legend(named.values(), labels, loc="center left", bbox_to_anchor=(1.0, 0.5))
        return

    # as many columns as the labels leave room for; above the title where there is one
    room = axes.get_position().width * axes.figure.get_figwidth()  # inches
    most = int(room / (0.5 + 0.07 * max(len(label) for label in labels)))
    columns = min(max(most, 1), len(labels))
    labels = [label for k in range(columns) for label in labels[k::columns]]  # read in rows, filled in by columns
    above = 1.0 if not axes.get_title() else 1.0 + 0.3 / (axes.get_position().height * axes.figure.get_figheight())
    axes.legend(
        [named[label] for label in labels],
        labels,
        loc="lower left",
        bbox_to_anchor=(0.0, above),
        ncols=columns,
        borderaxespad=0.0,
        columnspacing=1.2,
    )


def set_label(axes: Any, name: str, unit: str) -> None:
    """What the y axis shows, and its unit; below each other where the axes are low."""
    room = axes.get_position().height * axes.figure.get_figheight() / LETTER
    axes.set_ylabel(f"{name}{' ' if len(name) + len(unit) + 3 < room else chr(10)}({unit})")


def set_ticks(axes: Any) -> None:
    """1, 2 and 5 on logarithmic axes of little more than a decade, where powers of ten would leave most of them bare; a few round
    numbers on those of much less.
    """
    from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        if isinstance(axis.get_major_locator(), LogLocator) and high < 50 * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high > 5 * low else MaxNLocator(4))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())


@contextmanager
def figure(
    file: str | Path,
    rows: int = 1,
    columns: int = 1,
    *,
    size: tuple[float, float] | None = None,
    widths: Sequence[float] | None = None,
    title: str = "",
) -> Iterator[Any]:
    """Axes to draw on, written to ``file`` at the end; on every rank, rank 0 writes.

        with plot.figure("wave.png", 1, 2) as (left, right):
            left.plot(t, exact, **plot.REFERENCE, label="exact")
            left.plot(t, force, label="P1")
            left.set(xlabel="time (s)", ylabel="force (N)")

    Yields one matplotlib axes or an array of them; ``size`` in inches, ``widths`` of the columns
    against each other, ``title`` over all. Axes with several labels get a legend above them.
    """
    matplotlib, made = empty_figure(*(size or (2.4 + 4.0 * columns, 1.2 + 2.6 * rows)))
    made.get_layout_engine().set(w_pad=0.1)
    with matplotlib.rc_context(STYLE):
        axes = made.subplots(rows, columns, squeeze=False, width_ratios=widths)
        yield axes[0, 0] if axes.size == 1 else axes.squeeze()
        for one in axes.ravel():
            set_ticks(one)
            if one.get_legend() is None and len(one.get_legend_handles_labels()[1]) > 1:
                add_legend(one)
        if title:
            add_title(made, title)
        if world_rank() == 0:
            save_figure(made, file, 160)


def add_title(figure: Any, text: str) -> None:
    """A title over all axes, in lines that fit the figure."""
    from textwrap import fill

    figure.suptitle(fill(text, int(13 * figure.get_figwidth())), fontsize=10)
