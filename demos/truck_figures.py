"""Figures of demos/truck.py: the truck on the hump, what driver and loading area feel, error against run time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import truck_model as model

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study
from fmbd_fenicsx.log import say
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.post.drawing.scene_graph import Deforming
from fmbd_fenicsx.ranks import world_rank

MOTION, BENDING, APART = 10.0, 15.0, 11.5  # growth of motion and deformation in the drawing, m from truck to truck
SHAPES = {  # corners about the place at the start, m
    "chassis": ((-4.2, 1.92), (4.0, 1.92), (4.0, 2.08), (-4.2, 2.08)),
    "cab": ((1.9, 2.45), (3.8, 2.45), (3.8, 3.2), (3.5, 3.9), (1.9, 3.9)),
}


def picture(runs: Mapping[str, tuple[fmbd.Run, fmbd.Run]], file: object) -> None:
    """``runs``: suspension -> (rigid, elastic with snapshots); the first is drawn. Collective, rank 0 writes."""
    elastic = next(iter(runs.values()))[1]
    area = next(p for p in draw(elastic).pieces if isinstance(p.motion, Deforming))
    field: Any = next(p.field for p in elastic.system.parts if hasattr(p, "field"))
    mesh = field.comm.gather(field.X + field.center)
    if world_rank() != 0:
        return
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6.4), layout="constrained")
    figure.suptitle(f"{elastic.scene.name}: rigid and elastic loading area on a lifting road", fontsize=11)
    above, below = figure.subfigures(2, 1, height_ratios=(0.75, 1.2))
    ax = above.subplots()
    axes = below.subplot_mosaic([["acceleration", "pitch", "stress"]])
    for k, state in enumerate(elastic.snapshots):
        row = int(np.argmin(abs(elastic.times - state.t)))
        _bodies(ax, elastic, row, APART * k)
        shown = _loading_area(ax, np.concatenate(mesh), area.at(k)[:, :2], area.triangles, APART * k)
        ax.text(APART * k, 5.7, f"t = {state.t:.1f} s", ha="center")
    above.colorbar(shown, ax=ax, label="Mises stress x thickness (kN/m)", shrink=0.9, pad=0.01)
    ax.set(aspect="equal", ylabel="y (m)", xticks=[], ylim=(-0.2, 6.4))
    ax.set_title(f"loading area on a {next(iter(runs))}: motion x {MOTION:g}, deformation x {BENDING:g}", fontsize=10)
    for k, (name, (rigid, soft)) in enumerate(runs.items()):
        for run, kind, look in ((rigid, "rigid", {"lw": 4, "alpha": 0.35}), (soft, "elastic", {"lw": 1})):
            label = f"{kind}, {name}"
            axes["acceleration"].plot(run.times, run["cab acceleration"][:, 1], color=f"C{k}", label=label, **look)
            axes["pitch"].plot(run.times, 1e3 * run["cab pitch"][:, 0], color=f"C{k}", label=label, **look)
        change = soft["stress"][:, 0] - soft["stress"][0, 0]
        axes["stress"].plot(
            soft.times, change, f"C{k}", label=f"{name}: {1e-3 * soft['stress'][0, 0]:.1f} kN/m at rest"
        )
    for name, label in (("acceleration", "cab acceleration (m/s$^2$)"), ("pitch", "cab pitch (mrad)"),
                        ("stress", "change of the largest stress (N/m)")):  # fmt: skip
        axes[name].set(xlabel="time (s)", ylabel=label)
        axes[name].grid(alpha=0.3)
    for one in axes.values():
        one.legend(
            frameon=False,
            fontsize=8,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=1 if one is axes["stress"] else 2,
        )
    figure.savefig(str(file), dpi=110)


def _turned(points: Any, center: np.ndarray, place: np.ndarray, angle: float) -> np.ndarray:
    """Points of a body about its ``center``, moved: its motion grown."""
    a, to = MOTION * angle, center + MOTION * (place - center)
    R = np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    return np.asarray(to + (np.asarray(points) - center) @ R.T)


def _bodies(ax: Any, run: fmbd.Run, row: int, shift: float) -> None:
    """Road, wheels, springs, chassis and cab at one instant."""
    from matplotlib.patches import Circle, Polygon

    move = np.array([shift, 0.0])
    places = {"ground": lambda p, wheel=None: np.asarray(p)}
    for name in ("rear wheel", "front wheel", "chassis", "cab"):
        start, now, angle = (
            run[name][0],
            run[name][row],
            float(run[f"{name} pitch"][row, 0] - run[f"{name} pitch"][0, 0]),
        )
        places[name] = lambda p, c=start, x=now, a=angle: _turned([p], c, x, a)[0]
        if "wheel" in name:
            ax.add_patch(Circle(places[name](start) + move, 0.5, color="0.3"))
        else:
            color = "C0" if name == "chassis" else "C1"
            corners = [places[name](p) for p in SHAPES[name]]
            ax.add_patch(Polygon(np.array(corners) + move, facecolor=color, alpha=0.85))
    x = np.linspace(-5.0, 5.0, 60)
    road = [MOTION * model.hump(float(run.times[row]), xi)[0] for xi in x]
    ax.plot(x + shift, road, color="0.5", lw=1.5)
    for name, (a, b, at_a, at_b, *_) in model.SUSPENSION.items():
        if "load" not in name and "tyre" not in name:
            p, q = places[a](at_a) + move, places[b](at_b) + move
            s = np.linspace(0, 1, 40)
            if "wheel" in a:  # the short springs between wheels and chassis, drawn as struts
                q = places["chassis"]((at_a[0], model.CHASSIS[1])) + move
            ax.plot(p[0] + (q[0] - p[0]) * s + 0.07 * np.sin(14 * np.pi * s), p[1] + (q[1] - p[1]) * s, "k", lw=0.8)
    ax.plot(*(places["chassis"](model.PIN) + move), "ko", ms=5)


def _loading_area(ax: Any, X: np.ndarray, x: np.ndarray, triangles: np.ndarray, shift: float) -> Any:
    """The sheet, coloured by its Mises stress; X undeformed, x now."""
    center, now = X.mean(0), x.mean(0)
    U, _, V = np.linalg.svd((X - center).T @ (x - now))
    R = (U @ V).T  # the rotation that brings X closest to x
    u = (x - now) @ R - (X - center)
    angle = float(np.arctan2(R[1, 0], R[0, 0]))
    drawn = _turned(X + BENDING * u, center, now, angle) + np.array([shift, 0.0])
    D = np.stack([X[triangles[:, k]] - X[triangles[:, 0]] for k in (1, 2)], axis=2)
    G = np.stack([u[triangles[:, k]] - u[triangles[:, 0]] for k in (1, 2)], axis=2) @ np.linalg.inv(D)
    e = 0.5 * (G + G.transpose(0, 2, 1))
    k, nu = model.MODULUS / (1 - model.POISSON**2), model.POISSON
    n = k * ((1 - nu) * e + nu * np.trace(e, axis1=1, axis2=2)[:, None, None] * np.eye(2))
    stress = np.sqrt(1.5 * (n**2).sum((1, 2)) - 0.5 * np.trace(n, axis1=1, axis2=2) ** 2)
    return ax.tripcolor(*drawn.T, triangles, facecolors=1e-3 * stress, cmap="viridis", vmin=0, vmax=60)


def work(file: str, t_end: float = 10.0) -> None:
    """Print and draw error against run time: the rigid truck by schemes and forms, the elastic one by mesh, modes and step.

    The second figure goes beside ``file``, with "_elastic" in its name.
    """
    quiet = fmbd.Output(energy=False)

    def by(scheme: Any, dt: float | None = None) -> fmbd.Run:
        return fmbd.solve(model.truck(model.rigid_load()), t_end=t_end, dt=dt, scheme=scheme, output=quiet)

    tolerances = [1e-3, 1e-5, 1e-7, 1e-9]
    rigid = [
        study.Configuration("generalized-alpha", lambda h: by(None, h), [0.1, 0.05, 0.025, 0.0125]),
        study.Configuration("Radau IIA, index 3", lambda r: by(fmbd.Radau(rtol=r)), tolerances),
        study.Configuration("Radau IIA, GGL", lambda r: by(fmbd.Radau(rtol=r, form=fmbd.GGL())), tolerances[:3]),
        study.Configuration(
            "Radau IIA, state space", lambda r: by(fmbd.Radau(rtol=r, form=fmbd.StateSpace())), tolerances
        ),
        study.Configuration("BDF, GGL", lambda r: by(fmbd.BDF(rtol=r, form=fmbd.GGL())), tolerances[:3]),
    ]
    table = study.work_precision(rigid, reference=by(fmbd.Radau(rtol=1e-12)), names=["cab"], repeats=1)
    say(table)
    table.figure(file)

    loads = {h: model.elastic_load(h=h) for h in (0.6, 0.3, 0.15)}

    def soft(load: Any, dt: float = 0.05) -> fmbd.Run:
        return fmbd.solve(model.truck(load), t_end=t_end, dt=dt, output=quiet)

    def reduced(modes: float, inertia: bool) -> fmbd.Run:
        basis = fmbd.CraigBampton(("rear", "front"), int(modes), inertia=inertia)
        return soft(loads[0.15].reduced(basis=basis))

    elastic = [
        study.Configuration("field: cells 0.6, 0.3, 0.15 m", lambda h: soft(loads[h]), list(loads)),
        study.Configuration("0, 6, 24 modes", lambda n: reduced(n, False), [0, 6, 24]),
        study.Configuration("0, 6, 24 modes, inertia", lambda n: reduced(n, True), [0, 6, 24]),
        study.Configuration("field: steps 0.2, 0.1 s", lambda h: soft(loads[0.15], h), [0.2, 0.1]),
    ]
    fine = soft(model.elastic_load(h=0.075), 0.025)
    table = study.work_precision(elastic, reference=fine, names=["cab", "stress"], repeats=1)
    say(table)
    beside = Path(file)
    table.figure(beside.with_name(f"{beside.stem}_elastic{beside.suffix}"))
