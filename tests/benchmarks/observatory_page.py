"""The page and the figure of the observatory from its runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from observatory_problems import PROBLEMS

from fmbd_fenicsx import study

if TYPE_CHECKING:
    from observatory import Point

ACCURACIES = (1e-2, 1e-4, 1e-6, 1e-8)
INTRODUCTION = """\
Written by `tests/benchmarks/observatory.py --write` (its head says how), {setting}.
The runs took {spent:.0f} s of CPU time, on one core of a machine with other work.

Errors are those of a sensor at the end, relative to the largest component of the reference. CPU times are those of whole runs,
set-up and the first compilation of kernels included. References are exact or come from other means than this code; "ordinary
equations" are those of minimal coordinates, by DOP853 of SciPy with a tolerance of 1e-12. In elastic problems the error of the
mesh stays when steps become finer. Every failure is listed. A finer run is left out where the coarser one took more than
{limit:g} s, and no run may take more than {longest:g} s.

Neighbours: **Exudyn 1.13.6** with its own models of the rigid problems (its CPU time is that of assembly and steps, without the
start of Python), **IDA** of SUNDIALS (scikit-sundae) and **SciPy** on planar problems of rigid bodies. The equations of IDA and
SciPy are evaluated by this package, one state at a time: their times are those of its evaluations, their "steps" the number of
these.

![Error against CPU time](pictures/observatory.png)
"""


def page(points: list[Point], setting: str, spent: tuple[float, float, float]) -> str:
    """The page: what was run, best times for accuracies, all runs, failures.

    ``spent``: CPU seconds above which no finer run is made, after which a run is given up, and of all.
    """
    names = list(dict.fromkeys(p.problem for p in points))
    head = INTRODUCTION.format(setting=setting, limit=spent[0], longest=spent[1], spent=spent[2])
    lines = ["# The observatory: error against CPU time", "", head, f"## {len(names)} problems", ""]
    rows = [["problem", "what", "reference", "s", "sensor"]]
    rows += [[n, _what(n), PROBLEMS[n].provenance, f"{PROBLEMS[n].t_end:g}", PROBLEMS[n].sensor] for n in names]
    missing = [n for n in PROBLEMS if n not in names]
    lines += [study.markdown(rows), "", *([f"Not run this time: {', '.join(missing)}.", ""] if missing else [])]
    lines += ["## Fastest to an accuracy", "", study.markdown(_fastest(points, names))]

    lines += ["", "## All runs", "", "Relative error at the end / CPU seconds / steps.", ""]
    rows, failures = [["problem", "scheme", "coarse", "finer", "finest"]], []
    for n in names:
        for scheme in dict.fromkeys(p.scheme for p in points if p.problem == n):
            found = [p for p in points if (p.problem, p.scheme) == (n, scheme)]
            cells = [_cell(p) for p in found]
            rows.append([n, scheme, *cells, *[""] * (3 - len(cells))])
            failures += [p for p in found if p.failure]

    lines += [study.markdown(rows), "", "## Failures", ""]
    for title, refused in (("Refused before the run:", True), ("Failed on the way:", False)):
        told = [f"- {p.problem}, {p.scheme}, {p.value:g}: {p.failure}" for p in failures if p.refused is refused]
        lines += [title, "", *(told or ["- none"]), ""]
    return "\n".join(lines)


def rows_of(text: str) -> list[tuple[str, str, list[str], dict[str, str]]]:
    """The runs that a page holds: problem, scheme, cells of its values, and what was said of values that failed."""
    listed, failures = text.split("## All runs")[1].split("## Failures")
    told: dict[tuple[str, str], dict[str, str]] = {}
    found = []
    for line in listed.splitlines():
        cells = [x.strip() for x in line.strip("|").split("|")]
        if len(cells) == 5 and cells[0] in PROBLEMS:
            said = told.setdefault((cells[0], cells[1]), {})
            start = f"- {cells[0]}, {cells[1]}, "
            for failure in (x[len(start) :] for x in failures.splitlines() if x.startswith(start)):
                value, _, why = failure.partition(": ")
                said[value] = why
            found.append((cells[0], cells[1], [x for x in cells[2:] if x], said))
    return found


def _what(name: str) -> str:
    """The first sentence of the function that makes the scene, where it has one."""
    text = PROBLEMS[name].scene.__doc__ or ""
    return text.strip().split("\n")[0].rstrip(".")


def _fastest(points: list[Point], names: list[str]) -> list[list[str]]:
    """For each problem and accuracy the fastest run that reached it."""
    rows = [["problem", *(f"{accuracy:.0e}" for accuracy in ACCURACIES)]]
    for n in names:
        cells = []
        for accuracy in ACCURACIES:
            good = [p for p in points if p.problem == n and p.error <= accuracy]
            best = min(good, key=lambda p: p.seconds, default=None)
            cells.append("not reached" if best is None else f"{best.scheme}: {best.seconds:.2g} s")
        rows.append([n, *cells])
    return rows


def _cell(p: Point) -> str:
    if p.failure:
        return "refused" if p.refused else "failed"
    return f"{p.error:.1e} / {p.seconds:.2g} / {p.steps:.0f}"


def figure(points: list[Point], file: Path) -> None:
    """A panel for each problem, a line for each scheme."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    names, schemes = list(dict.fromkeys(p.problem for p in points)), list(dict.fromkeys(p.scheme for p in points))
    columns = min(5, len(names))
    rows = -(-len(names) // columns)
    made = Figure(figsize=(3.2 * columns, 2.4 * rows + 1.2), layout="constrained")
    panels = made.subplots(rows, columns, squeeze=False).ravel()
    shown: dict[str, object] = {}

    for axes, name in zip(panels, names, strict=False):
        for k, scheme in enumerate(schemes):
            good = [p for p in points if (p.problem, p.scheme) == (name, scheme) and not p.failure]
            if not good:
                continue
            at = [p.seconds for p in good], [max(p.error, 1e-16) for p in good]
            style = "o-" if good[0].value < 1 else "s--"
            shown[scheme] = axes.loglog(*at, style, color=colormaps["tab20"](k % 20), ms=3, label=scheme)[0]
        axes.set_title(name, fontsize=9)
        axes.grid(alpha=0.3)
        axes.tick_params(labelsize=7)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_minor_formatter(NullFormatter())

    for axes in panels[len(names) :]:
        axes.set_visible(False)
    made.supylabel("relative error at the end, over CPU time in s", fontsize=9)
    made.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=5, fontsize=8)
    made.savefig(file, dpi=80)
