"""Time and memory of the iterative preset on a large clamped block, 3D P2, one trace joint, trapezoidal steps.

Run:  ./with-dolfinx python3 docs/scripts/large_run.py 34 20          (cells a side, steps; 34 cells: 10^6 unknowns)
"""

import resource
import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.linear.presets import FieldSplit, Multigrid
from fmbd_fenicsx.linear.saddle import Elastic, SaddlePoint, hold
from fmbd_fenicsx.traces.fields import ElasticForms, Field
from fmbd_fenicsx.traces.multipliers import Continuous
from fmbd_fenicsx.traces.traces import trace_of

ROOT = Path(__file__).resolve().parents[2]


def memory() -> float:
    """Peak of all ranks, GiB."""
    return MPI.COMM_WORLD.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 2**20


def main(cells: int, steps: int) -> None:
    """March and report."""
    dt, start = 1.0 / cells, time.perf_counter()
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0, 1.0), cells=cells)
    body = Field("block", mesh, ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 2))
    clamp = hold("clamp", 0, Continuous(1).on(trace_of(body.space, mesh, "left")))
    system = SaddlePoint([Elastic(body, 4 / dt**2)], [clamp])
    solver = FieldSplit(Multigrid(), rtol=1e-6).solver(system)
    ready = time.perf_counter()
    load = body.mass(np.ones((body.n, 3)) * [0.0, -1e-3, 0.0]).ravel()
    u, v, a, counts = np.zeros(system.rows[0]), np.zeros(system.rows[0]), np.zeros(system.rows[0]), []
    for _ in range(steps):
        history = (4 / dt**2 * u + 4 / dt * v + a).reshape(-1, 3)
        found = solver.solve([load + body.mass(history).ravel()], [np.zeros(clamp.rows)])
        new = 4 / dt**2 * (found.u[0] - u) - 4 / dt * v - a
        u, v, a = found.u[0], v + dt / 2 * (a + new), new
        counts.append(found.iterations)
    seconds = (time.perf_counter() - ready) / steps
    peak = memory()
    demo.say(f"{body.n_global} unknowns, {clamp.rows} multipliers, {MPI.COMM_WORLD.size} ranks: set-up {ready - start:.1f} s, "
             f"{seconds:.2f} s a step, {np.mean(counts):.1f} MINRES iterations, peak {peak:.2f} GiB")  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
