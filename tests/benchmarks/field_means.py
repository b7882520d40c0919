"""Steps of the energy-momentum scheme with elastic fields beside those of generalized-alpha on the same bodies, in one call.

    ./with-dolfinx python3 tests/benchmarks/field_means.py [--cells 7 34]

CPU time a step by the difference of runs of N and 2 N steps; iterations and back-solves of all steps.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.materials import neo_hookean, saint_venant_kirchhoff

MESH = Path(__file__).resolve().parents[2] / "meshes/block.py"
LAWS = {"St. Venant-Kirchhoff": saint_venant_kirchhoff, "neo-Hookean": neo_hookean}
CASES = ("flies", "on a pin", "on a pin and a spring", "two, welded")
QUIET = fmbd.Output(every=1000, progress=False)
DT = 2e-3


def bar(law: Any, cells: int, name: str = "bar", left: float = 0.0, **start: Any) -> fmbd.AbsoluteBody:
    """A soft bar of 1 x 0.2 m that bends by its weight."""
    mesh = fmbd.read_gmsh(MESH, size=(1.0, 0.2), origin=(left, -0.1), cells=cells)
    return fmbd.AbsoluteBody(name, mesh, density=1000.0, energy=law(1e6, 0.3), quadrature=4, **start)


def scene_of(case: str, law: Any, cells: int) -> fmbd.Scene:
    """One of the cases."""
    scene = fmbd.Scene(case, gravity=(0.0, -9.81))
    if case == "flies":
        scene.add(bar(law, cells, velocity=(0.2, 0.1), angular_velocity=2.0))
        return scene
    body = bar(law, cells)
    scene.add(body, fmbd.revolute("pin", fmbd.ground, body.surface("left"), center=(0, 0)))
    if case == "on a pin and a spring":
        anchor = {"point_a": (1.0, 0.5), "point_b": (1.0, 0.0)}
        scene.add(fmbd.Spring("spring", fmbd.ground, body.surface("right"), stiffness=1e3, damping=5.0, **anchor))
    if case == "two, welded":
        second = bar(law, cells, "second", 1.0)
        scene.add(second, fmbd.fixed("weld", body.surface("right"), second.surface("left")))
    return scene


def cost(scene: fmbd.Scene, scheme: Any, steps: int) -> tuple[float, fmbd.Run]:
    """CPU time of a step (ms), and the longer run."""

    def run(count: int) -> tuple[float, fmbd.Run]:
        begun = time.process_time()
        made = fmbd.solve(scene, t_end=count * DT, dt=DT, scheme=scheme, output=QUIET)
        return time.process_time() - begun, made

    run(4)
    (short, _), (long, made) = run(steps), run(2 * steps)
    return 1e3 * (long - short) / steps, made


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="*", default=[7])
    parser.add_argument("--steps", type=int, default=100)
    given = parser.parse_args()
    print(
        "| case | law | unknowns | ms a step, iterations, back-solves | generalized-alpha | ratio |\n|---|---|---|---|---|---|"
    )
    for cells in given.cells:
        for case in CASES:
            for name, law in LAWS.items():
                told = []
                for scheme in (fmbd.EnergyMomentum(), fmbd.GeneralizedAlpha(0.9)):
                    ms, run = cost(scene_of(case, law, cells), scheme, given.steps)
                    counts = (run.counters[x] / (2 * given.steps) for x in ("newton_iterations", "back_solves"))
                    told.append((ms, ", ".join(f"{x:.1f}" for x in (ms, *counts))))
                (one, first), (other, second) = told
                print(f"| {case} | {name} | {run.system.n_v} | {first} | {second} | {one / other:.1f} |", flush=True)


if __name__ == "__main__":
    main()
