"""Time and memory of a scene with a large elastic block and the iterative preset: P2 in space, one joint on its left face.

Run:  ./with-dolfinx python3 docs/scripts/large_run.py 34 20            (cells a side, steps; 34 cells: 10^6 unknowns)
      ./with-dolfinx python3 docs/scripts/large_run.py 34 20 --tie      (the face held point by point, by field multipliers)
      ./with-dolfinx python3 docs/scripts/large_run.py 10 20 --direct   (Cholesky, to compare)
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

ROOT = Path(__file__).resolve().parents[2]
E, RHO = 1e7, 1000.0


def total(x: float) -> float:
    """Sum over the ranks."""
    return MPI.COMM_WORLD.allreduce(x)


def main() -> None:
    """March and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cells", type=int)
    parser.add_argument("steps", type=int)
    parser.add_argument("--tie", action="store_true", help="field multipliers instead of six resultants")
    parser.add_argument("--direct", action="store_true", help="Cholesky instead of multigrid")
    args = parser.parse_args()
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0, 1.0), cells=args.cells)
    block = fmbd.AbsoluteBody("block", mesh, density=RHO, elastic=fmbd.materials.linear_elastic(E, 0.3))
    left = block.surface("left")
    scene = fmbd.Scene("large", gravity=(0, -9.81, 0), gravity_ramp=0.1)
    if args.tie:
        scene.add(block, fmbd.tie_surface("clamp", left, fmbd.ground))
    else:
        scene.add(block, fmbd.fixed("clamp", left, fmbd.ground, center=(0, 0.5, 0.5)))
    scene.sensor("tip", fmbd.position(block.surface("right")))
    dt = 1.0 / args.cells / np.sqrt(E / RHO)  # waves cross about one cell a step
    begin, work = time.perf_counter(), time.process_time()
    run = fmbd.solve(
        scene,
        t_end=args.steps * dt,
        dt=dt,
        linear=fmbd.Direct() if args.direct else fmbd.Schur(fmbd.Multigrid(), rtol=1e-6),
        output=fmbd.Output(energy=False, progress=False),
    )
    unknowns = run.system.fields[0][1].field.n_global
    wall, cpu = time.perf_counter() - begin, total(time.process_time() - work)
    c, s = run.counters, run.seconds
    peak = total(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)
    demo.say(f"{unknowns} unknowns, {run.system.n_lam} multipliers, {MPI.COMM_WORLD.size} ranks, {args.steps} steps")
    phases = ", ".join(f"{name} {s[name]:.0f}" for name in ("set-up", "start", "steps"))
    demo.say(f"wall {wall:.0f} s, CPU of all ranks {cpu:.0f} s; of the wall time: {phases} s")
    step, inner = s["steps"] / args.steps, c["elastic_iterations"] / c["back_solves"]
    demo.say(f"a step: {step:.2f} s wall, {cpu / wall * step:.2f} s CPU")
    demo.say(f"{c['back_solves_per_step']:.1f} solves with E a step, {inner:.1f} iterations each")
    demo.say(f"peak memory {peak:.2f} GiB")
    demo.say(f"worst linear residual {c['worst_linear_residual']:.1e}; drift {run.drift[0]:.1e} m")
    demo.say("tip " + " ".join(f"{x:.12g}" for x in run["tip"][-1]))


if __name__ == "__main__":
    main()
