"""Time and memory of an equilibrium and of modes of a large block: linear displacements, clamped by one joint, multigrid.

Run:  ./with-dolfinx python3 docs/scripts/large_statics.py 69                 (cells a side; 69 cells: 10^6 unknowns)
      ./with-dolfinx python3 docs/scripts/large_statics.py 16 --degree 2      (quadratic)
      ./with-dolfinx python3 docs/scripts/large_statics.py 20 --direct        (Cholesky, to compare)
"""

import argparse
import resource
import time
from pathlib import Path

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

ROOT = Path(__file__).resolve().parents[2]
E, RHO = 1e7, 1000.0


def main() -> None:
    """Solve and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cells", type=int)
    parser.add_argument("--degree", type=int, default=1)
    parser.add_argument("--modes", type=int, default=3)
    parser.add_argument("--direct", action="store_true", help="Cholesky instead of multigrid")
    args = parser.parse_args()
    linear = fmbd.Direct() if args.direct else fmbd.Schur(fmbd.Multigrid(), rtol=1e-8)
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0, 1.0), cells=args.cells)
    law = fmbd.materials.linear_elastic(E, 0.3)
    block = fmbd.AbsoluteBody("block", mesh, density=RHO, elastic=law, degree=args.degree)
    scene = fmbd.Scene("large", gravity=(0, -9.81, 0))
    scene.add(block, fmbd.fixed("clamp", block.surface("left"), fmbd.ground, center=(0, 0.5, 0.5)))
    scene.sensor("tip", fmbd.position(block.surface("right")))

    begin, work = time.perf_counter(), time.process_time()

    def told(what: str) -> None:
        nonlocal begin, work
        wall, cpu = time.perf_counter() - begin, time.process_time() - work
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        demo.say(f"{what}: {cpu:.0f} s CPU, {wall:.0f} s wall, peak memory {peak:.2f} GiB")
        begin, work = time.perf_counter(), time.process_time()

    told("mesh")
    found = fmbd.equilibrium(scene, linear=linear)
    told("equilibrium")
    demo.say(f"{found.system.fields[0][1].field.n_global} unknowns, {found.counters}")
    demo.say("tip " + " ".join(f"{x:.10g}" for x in found["tip"]))
    modes = fmbd.modes(scene, args.modes, at=found, linear=linear)
    told(f"{args.modes} modes")
    demo.say("Hz " + " ".join(f"{x:.8g}" for x in modes.frequencies))


if __name__ == "__main__":
    main()
