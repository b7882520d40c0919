"""Figures of demos/pantograph_catenary.py: the drive, error against run time, the contact force at the borders of elements.

Three spans at 250 km/h. The error is that of the contact force filtered to 20 Hz, root mean square over the last two spans,
against the finest run; the share at the rate at which the contact crosses element borders is that of the multiplier itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import catenary_model as model
import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import plot
from fmbd_fenicsx.log import say
from fmbd_fenicsx.ranks import world_rank

SPEED, SECTION = 250 / 3.6, (60.0, 150.0)  # m/s, m


@dataclass(frozen=True)
class Drive:
    """One drive: form of the constraint, step (s), cell (m)."""

    form: str
    h: float
    cell: float

    def run(self) -> fmbd.Run:
        """Three spans, constant steps."""
        form = fmbd.GGL() if self.form == "GGL" else fmbd.Index3()
        scheme = fmbd.Unilateral(fmbd.GeneralizedAlpha(0.6, form=form))
        scene, t_end = model.scene(SPEED, spans=3, h=self.cell), 150 / SPEED + model.RAMP / 2
        return fmbd.solve(scene, t_end=t_end, dt=t_end / round(t_end / self.h), scheme=scheme, output=QUIET)


QUIET = fmbd.Output(energy=False)
STEPS = [4e-3, 2e-3, 1e-3]
LINES = {
    "index 3, cells 0.5 m": [Drive("index 3", h, 0.5) for h in STEPS],
    "GGL, cells 0.5 m": [Drive("GGL", h, 0.5) for h in STEPS[:2]],
    "index 3, 1 ms: cells 0.5, 0.25 m": [Drive("index 3", 1e-3, c) for c in (0.5, 0.25)],
}
FINEST = Drive("index 3", 5e-4, 0.25)


def force(run: fmbd.Run, x: np.ndarray) -> np.ndarray:
    """Filtered contact force at places x, N."""
    at = 10.0 + SPEED * (run.times - 0.5 * model.RAMP)
    return np.interp(x, at, model.low_pass(run.times, run["contact"][:, 0]))


def border_share(run: fmbd.Run, cell: float) -> float:
    """Amplitude (N) of the multiplier within 2 per cent of the rate of element borders; nan where the steps are too long."""
    at = 10.0 + SPEED * (run.times - 0.5 * model.RAMP)
    inside = (at > SECTION[0]) & (at < SECTION[1])
    x, t = run["contact"][inside, 0], run.times[inside]
    amplitude = 2 * np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)))) / np.hanning(len(x)).sum()
    frequency = np.fft.rfftfreq(len(x), t[1] - t[0])
    near = np.abs(frequency * cell / SPEED - 1) < 0.02
    return float(amplitude[near].max()) if near.any() else float("nan")


def work(file: str) -> dict[str, list[tuple[float, float]]]:
    """Print and draw: name -> (seconds, error in N) of each run."""
    x = np.linspace(*SECTION, 2000)
    exact = force(FINEST.run(), x)
    found: dict[str, list[tuple[float, float]]] = {}
    for name, drives in LINES.items():
        for drive in drives:
            run = drive.run()
            off = force(run, x) - exact
            error, real = float(np.sqrt((off**2).mean())), run.seconds["steps"] / run.times[-1]
            found.setdefault(name, []).append((run.seconds["steps"], error))
            say(
                f"{drive.form:<8} h {1e3 * drive.h:4.2g} ms, cell {drive.cell:5.3g} m: error {error:6.3f} N, largest "
                f"{abs(off).max():6.3f} N, at element borders {border_share(run, drive.cell):.1e} N, rate off the wire "
                f"{run.drift[1]:.1e} m/s, {run.seconds['steps']:.2f} s, {real:.2f} times real time"
            )
    with plot.figure(file) as axes:
        for name, points in found.items():
            axes.loglog(*np.array(points).T, "o-", label=name)
        axes.set(xlabel="time in steps (s)", ylabel="error of the contact force up to 20 Hz (N)")
    return found


def picture(runs: Mapping[int, fmbd.Run], file: object) -> None:
    """The wires over the pantograph at one instant, contact forces over the place, and the uplift; rank 0 writes."""
    if world_rank() != 0:
        return
    look = {"size": (9.5, 9.8), "title": "Pantograph and catenary: wires, contact forces, uplift"}
    with plot.figure(file, len(runs) + 2, 1, **look) as (top, *axes):
        _wires(top, next(iter(runs.values())), next(iter(runs)))
        _forces(axes, runs)


def _forces(axes: Any, runs: Mapping[int, fmbd.Run]) -> None:
    """Contact force of each run over the place of the pantograph; on the last axes the uplift of a support."""
    for ax, (kmh, run) in zip(axes, runs.items(), strict=False):
        x = 10.0 + kmh / 3.6 * (run.times - model.RAMP / 2)
        ax.plot(x, run["contact"][:, 0], color="0.8", lw=0.6, label="multiplier")
        ax.plot(x, model.low_pass(run.times, run["contact"][:, 0]), color="C0", lw=1.2, label="up to 20 Hz")
        ax.set(ylabel=f"force at {kmh} km/h (N)", xlim=(0, x[-1]), ylim=(0, None))
        ax.vlines(model.SPAN * np.arange(1, int(x[-1] / model.SPAN) + 1), 0, 20, color="0.3", lw=1)
        at = min(3, run["supports"].shape[1] - 1)
        axes[-1].plot(x, 1e3 * (run["supports"][:, at] - run["supports"][0, at]), label=f"{kmh} km/h")
        axes[-1].set(xlim=(0, x[-1]))
    axes[-1].set(ylabel=f"uplift at support {at + 1} (mm)", xlabel="place of the pantograph (m); supports: ticks")


def _wires(ax: Any, run: fmbd.Run, kmh: int, grow: float = 20.0, apart: float = 3.0) -> None:
    """Wires, droppers and pantograph at the last snapshot but one; the wires' shape and displacements grown."""
    state = run.snapshots[-2]
    number, part = next((k, p) for k, p in enumerate(run.system.parts) if hasattr(p, "sliders"))
    u, field = run.system.local_q(state.q, number), part.field  # type: ignore[attr-defined]
    rest = run.system.local_q(run.snapshots[0].q, number)
    here = 10.0 + kmh / 3.6 * (state.t - model.RAMP / 2)
    x = np.linspace(max(here - 100, 0), min(here + 80, field.body.length), 721)

    def height(wire: int, at: float) -> float:
        return apart * wire + float((field.row(wire, at) @ (4 * rest + grow * (u - rest)))[0])

    for wire, name in enumerate(("contact wire", "messenger wire")):
        ax.plot(x, [height(wire, xi) for xi in x], color=("C0", "C2")[wire], lw=1.5, label=name)
    tensions = field.tension(u)[0]
    for d, N in zip(field.body.droppers, tensions, strict=True):
        if x[0] < d.x < x[-1]:
            color, style = ("0.5", "-") if N > 0 else ("r", ":")
            ax.plot([d.x, d.x], [height(0, d.x), height(1, d.x)], color=color, ls=style, lw=0.8)
    for s in field.body.supports:
        if x[0] < s.x < x[-1] and s.wire == 1:
            ax.plot([s.x, s.x], [-3.5, apart + 0.6], color="k", lw=3, alpha=0.3)
    y = height(0, here)
    ax.plot([here - 1.5, here + 1.5], [y - 0.1, y - 0.1], color="k", lw=4, solid_capstyle="round")
    ax.plot([here, here + 4.0, here], [y - 0.1, 0.5 * (y - 3.6), -3.5], color="k", lw=1.5)
    ax.plot([x[0], x[-1]], [-3.5, -3.5], color="0.5", lw=3)
    ax.annotate("", (here + 16, -2.4), (here + 6, -2.4), arrowprops={"arrowstyle": "->"})
    ax.set(xlim=(x[0], x[-1]), ylim=(-4, apart + 2), yticks=[], xlabel="x (m)")
    ax.set_title(
        f"{kmh} km/h, t = {state.t:.2f} s: shape at rest x 4, displacements x {grow:g}; red: slack droppers",
        fontsize=10,
    )
