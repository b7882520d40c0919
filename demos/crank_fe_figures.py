"""Figures of demos/slider_crank_fe.py: the moving crank coloured by stress, rods beside the beam, error against run time."""

from __future__ import annotations

from typing import Any

import crank_fe_model as fe
import crank_model as model
import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import plot, study
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.ranks import world_rank

GROW = 30.0  # of the distance from the chord


def bending_stress(u: Any) -> Any:
    """Stress along the rod (plane stress), MPa, as a UFL expression."""
    from ufl import grad, sym

    e = sym(grad(u))
    return 1e-6 * model.E / (1 - model.NU**2) * (e[0, 0] + model.NU * e[1, 1])


def picture(pairs: dict[float, tuple[fmbd.Run, fmbd.Run]], body: Any, file: object) -> None:
    """The crank in the last turn; deflections over the crank angle; by how much the elements deflect more. Collective.

    ``pairs``: height of the rod -> runs of beam and finite elements; the first is drawn, with its snapshots and its ``body``.
    """
    from matplotlib.ticker import FixedLocator, NullLocator

    heights, (_, drawn) = list(pairs), next(iter(pairs.values()))
    drawing = draw(drawn, paint=fmbd.Paint(bending_stress, "bending stress (Pa)", (body,)))
    if world_rank() != 0:
        return
    look = {
        "size": (15, 4.6),
        "widths": (2.1, 1.2, 1),
        "title": "Slider crank with a connecting rod of finite elements",
    }
    with plot.figure(file, 1, 3, **look) as (left, middle, right):
        rod = next(p for p in drawing.pieces if p.paint is not None)
        places = [rod.at(k)[:, :2] for k in range(len(drawing.times))]
        mechanism(left, drawn, rod.triangles, places, rod.paint)
        for k, (height, (b, f)) in enumerate(pairs.items()):
            scale = 1e3 * (height / heights[0]) ** 2
            phi = np.degrees(model.OMEGA * (f.times[f.times >= fe.RAMP] - fe.RAMP))
            middle.plot(phi, scale * fe.deflection(f), f"C{k}", lw=2.5, alpha=0.5, label=f"{1e3 * height:g} mm")
            middle.plot(phi, scale * fe.deflection(b), "k--", lw=0.8, label=None if k else "two sine modes")
        middle.set(xlabel="crank angle (degrees)", ylabel=f"deflection x (height / {1e3 * heights[0]:g} mm)$^2$ (mm)")
        middle.set(xticks=range(0, 361, 90))
        s = np.array(heights) / model.L2
        line = np.geomspace(0.6 * s[0], 1.5 * s[-1], 50)
        right.loglog(line, [100 * fe.expected_difference(x) for x in line], **plot.REFERENCE, label="estimate")
        right.loglog(s, [100 * fe.difference(f, b) for b, f in pairs.values()], "o", label="measured")
        for axis in (right.xaxis, right.yaxis):
            axis.set_major_locator(FixedLocator([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5]))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_locator(NullLocator())
        right.set(xlabel="height / length of the rod", ylabel="elements deflect more by (%)")


def mechanism(
    ax: Any, run: fmbd.Run, triangles: np.ndarray, nodes: list[np.ndarray], stresses: list[np.ndarray]
) -> None:
    """Snapshots of the last turn: crank as a bar, the rod's cells with their distance from the chord grown, slider."""
    from matplotlib.patches import Rectangle

    turn = np.linspace(0, 2 * np.pi, 100)
    ax.plot(model.L1 * np.cos(turn), model.L1 * np.sin(turn), ":", color="0.6", lw=1)
    ax.plot([0.1, 0.5], [-0.022, -0.022], color="0.5", lw=2)
    last = [k for k, state in enumerate(run.snapshots) if state.t >= fe.RAMP - 1e-9][:-1]
    largest = max(abs(stresses[k]).max() for k in last)
    for k in last:
        phi, x = fe.run_up(run.snapshots[k].t)[0], nodes[k]
        a = model.L1 * np.array([np.cos(phi), np.sin(phi)])
        b = np.array([a[0] + np.sqrt(model.L2**2 - a[1] ** 2), 0.0])
        e = (b - a) / model.L2
        straight = a + (nodes[0] - [model.L1, 0.0]) @ np.array([e, [-e[1], e[0]]])
        places = straight + GROW * (x - straight)
        ax.add_patch(Rectangle((b[0] - 0.018, -0.022), 0.036, 0.044, facecolor="0.9", edgecolor="0.4"))
        ax.plot([0, a[0]], [0, a[1]], color="0.4", lw=4, solid_capstyle="round", zorder=1)
        shown = ax.tripcolor(*places.T, triangles, facecolors=stresses[k], cmap="coolwarm", vmin=-largest, vmax=largest)
        ax.plot(*np.array([a, b]).T, ".", color="k", ms=4)
    ax.plot(0, 0, "ko", ms=7)
    ax.figure.colorbar(shown, ax=ax, label="stress along the rod (MPa)", shrink=0.8)
    ax.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=f"last turn, deflection x {GROW:g}")
    ax.grid(False)


def work(dt: float, file: str) -> None:
    """Print and draw the error of the edges' mean position against run time: cells, modes and steps."""
    size = 16e-3
    fine, sheet = fe.rod(size, size / 8), fe.rod(size, size / 2)
    lines = {
        "floating: cells 16, 8, 4 mm": (lambda h: fe.drive(fe.rod(size, h), dt), [size, size / 2, size / 4]),
        "reduced: 0, 2, 6, 16 modes": (lambda n: fe.drive(fe.reduced(fine, int(n)), dt), [0, 2, 6, 16]),
        "floating: steps 0.8, 0.4, 0.2 ms": (lambda h: fe.drive(sheet, h), [4 * dt, 2 * dt, dt]),
    }
    runs = [study.Configuration(name, *line) for name, line in lines.items()]
    table = study.work_precision(runs, reference=fe.drive(fine, dt / 4), names=["side"], repeats=1)
    fmbd.say(table)
    table.figure(file)
