"""Error against CPU time of steps of equal size and of the scheme's own choice: a rod of finite elements that is knocked once.

Run:  cd tests; OMP_NUM_THREADS=1 ../with-dolfinx python3 benchmarks/controlled_steps.py        (half a minute)
"""

from __future__ import annotations

import sys
import time as clock
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from test_variable_alpha import knocked

import fmbd_fenicsx as fmbd

MESH = Path(__file__).resolve().parents[2] / "meshes/rod.py"
TIMES = tuple(np.linspace(0.0, 1.0, 101))


def solved(**settings: Any) -> tuple[fmbd.Run, float]:
    """The run, and its CPU time (s)."""
    scene = knocked(fmbd.read_gmsh(MESH, dim=2, h=0.1, height=0.1), 0.8, 0.802)
    output = fmbd.Output(times=TIMES, energy=False, progress=False)
    begun = clock.process_time()
    run = fmbd.solve(scene, t_end=1.0, output=output, **settings)
    return run, clock.process_time() - begun


def main() -> None:
    """Print a table for docs/accuracy_log.md."""
    solved(dt=0.01)  # what is compiled and imported once belongs to no run
    exact, _ = solved(scheme=fmbd.Radau(3, rtol=1e-8))
    print("| steps | error (m) | CPU time (s) |\n|---|---|---|")
    equal = [(f"{n} equal ones", {"dt": 1.0 / n}) for n in (400, 1600, 6400)]
    chosen = [(f"rtol = {x:.0e}", {"scheme": fmbd.GeneralizedAlpha(rtol=x)}) for x in (1e-3, 1e-4, 1e-5)]
    for name, settings in (*equal, *chosen):
        run, spent = solved(**settings)
        error = float(np.abs(run["tip"] - exact["tip"]).max())
        print(f"| {name}: {run.counters['steps']:.0f} | {error:.1e} | {spent:.2f} |", flush=True)


if __name__ == "__main__":
    main()
