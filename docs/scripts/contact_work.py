"""Error against run time of contact scenes with known answers, with Newton counts, as a table and a figure.

Run:  ./with-dolfinx python3 docs/scripts/contact_work.py docs/pictures/contact_work.png

Seconds are CPU seconds of the solve on one rank (mesh and compilation left out by a run before).
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator

import fmbd_fenicsx as fmbd

MESHES = Path(__file__).resolve().parents[2] / "meshes"
SCHEMES = {
    "midpoint": fmbd.ContactMidpoint(),
    "alpha(0.8)": fmbd.ContactAlpha(0.8),
    "implicit Euler": fmbd.ContactMidpoint(theta=1.0),
}


def bar(n: int, scheme: Any, height: float = 0.1) -> tuple[fmbd.Run, float]:
    """Impact on a wall: RMS error of the force while closed."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, height), counts=(n, 1), quads=True)
    body = fmbd.AbsoluteBody(
        "bar", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.0), velocity=(-0.1, 0.0)
    )
    wall = fmbd.contact("wall", body.surface("left"), fmbd.Obstacle("wall", fmbd.HalfSpace((0.0, 0.0), (1.0, 0.0))))
    scene = fmbd.Scene("bar impact")
    scene.add(body, wall)
    scene.sensor("force", fmbd.contact_force(wall))
    run = fmbd.solve(scene, t_end=2.2, dt=0.5 / n, scheme=scheme)
    t = run.times[1:] - run.dt / 2
    on = (t > 0.1) & (t < 1.9)
    return run, float(np.sqrt(np.mean((run["force"][1:, 0][on] / (0.1 * height) - 1) ** 2)))


def bouncing(n: int, scheme: Any) -> tuple[fmbd.Run, float]:
    """One period of the bouncing bar: largest error of the foot's height over the drop."""
    L, h0, period = 10.0, 5.0, 16.0 / 3.0
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(1.0, L), counts=(1, n), origin=(0.0, h0), quads=True)
    body = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(900.0, 0.0))
    floor = fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("bouncing bar", gravity=(0.0, -10.0))
    scene.add(body, fmbd.contact("floor", body.surface("bottom"), floor))
    scene.sensor("foot", fmbd.position(body.surface("bottom")))
    run = fmbd.solve(scene, t_end=period, dt=0.5 * L / n / 30.0, scheme=scheme)
    at = {0.5: 3.75, 1.8: 0.5333333333, 2.0: 1.6666666667, 8 / 3: 3.8888888889, 3.0: 4.4444444444, 3.5: 0.6944444444,
          4.8: 3.5777777778, 5.0: 4.4444444444}  # fmt: skip
    foot = np.interp(list(at), run.times, run["foot"][:, 1])
    return run, float(np.abs(foot - list(at.values())).max() / h0)


def hertz(n: int, scheme: Any) -> tuple[fmbd.Run, float]:
    """Line contact at rest: RMS error of the pressure over its peak."""
    a, stiff = 0.005, 1 / (1 - 0.3**2)
    F = np.pi * a**2 * stiff / 4
    mesh = fmbd.read_gmsh(MESHES / "half_ball.py", dim=2, radius=1.0, h=a / n, near=2 * a, coarse=1.5 / n)
    body = fmbd.AbsoluteBody("body", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
    floor = fmbd.Obstacle("plane", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    scene = fmbd.Scene("Hertz")
    scene.add(body, fmbd.contact("plane", body.surface("contact"), floor, search=0.1 * a))
    scene.add(fmbd.force("load", body.surface("top"), lambda t: (0.0, -F)))
    scene.add(fmbd.prismatic("guide", fmbd.ground, body.surface("top"), axis=(0.0, 1.0)))
    run = fmbd.solve(scene, t_end=160.0, dt=20.0, scheme=scheme)
    found = run.state.contact
    x = found.x[:, 0] / a
    exact = 2 * F / (np.pi * a) * np.sqrt(np.maximum(0.0, 1 - x**2))
    return run, float(np.sqrt(np.mean((found.pressure - exact)[np.abs(x) < 1.2] ** 2)) / exact.max())


def table(name: str, make: Callable[..., Any], sizes: tuple[int, ...], schemes: tuple[str, ...], axes: Any) -> None:
    """Rows of one scene, and its lines in the figure."""
    axes.set(title=name, xlabel="CPU seconds", xscale="log", yscale="log")
    for label in schemes:
        seconds, errors = [], []
        make(sizes[0], SCHEMES[label])  # forms are compiled
        for n in sizes:
            start = time.process_time()
            run, error = make(n, SCHEMES[label])
            seconds.append(time.process_time() - start)
            errors.append(error)
            c = run.counters
            print(
                f"| {name} | {label} | {n} | {c['steps']:.0f} | {error:.1e} | {seconds[-1]:.2f} | "
                f"{c['contact_newton_iterations'] / c['contact_steps']:.2f} |",
                flush=True,
            )
        axes.plot(seconds, errors, "o-", label=label)
    ticks = [t for t in (0.2, 0.5, 1, 2, 5, 10, 20) if axes.get_xlim()[0] < t < axes.get_xlim()[1]]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks])
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.legend()


if __name__ == "__main__":
    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    axes = figure.subplots(1, 3)
    print("| scene | scheme | cells | steps | error | CPU s | Newton a step |\n|---|---|---|---|---|---|---|")
    table("bar impact: force", bar, (25, 50, 100, 200), tuple(SCHEMES), axes[0])
    table("bouncing bar: height", bouncing, (20, 40, 80), tuple(SCHEMES), axes[1])
    table("Hertz line: pressure", hertz, (5, 10, 20, 40), ("implicit Euler",), axes[2])
    axes[0].set_ylabel("relative error")
    figure.savefig(sys.argv[1], dpi=130)
