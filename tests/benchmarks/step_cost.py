"""What a step costs beside the factor: time in back-solves, and peak memory beside that of the bare
factorisation.

Run:  ./with-dolfinx python3 tests/benchmarks/step_cost.py               (10^5 unknowns, P2 in space; about
two minutes)
      ./with-dolfinx python3 tests/benchmarks/step_cost.py --unknowns 20000

Time: the median of the steps of an elastic pendulum over the median of one back-solve with the same factor, both CPU
time of one process; under gravity that grows within half a second, and under gravity that is there at once. Memory: peak
resident size of a process that makes the whole run over that of one that reads the mesh, assembles E = M + s K with
DOLFINx, factors it and solves once. Exit code 1 when a bound is missed.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
STEP, RHO = 1e-3, 0.8
TIME_BOUND, MEMORY_BOUND = 3.0, 1.3


def mesh_of(unknowns: int) -> Any:
    """A rod of about so many P2 unknowns."""
    import fmbd_fenicsx as fmbd

    h = 0.0132 * (1e5 / unknowns) ** (1 / 3)
    return fmbd.read_gmsh(ROOT / "meshes/rod.py", dim=3, h=h)


def peak() -> float:
    """Peak resident size of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def bare(unknowns: int) -> dict[str, float]:
    """Assemble, factor and solve once, with DOLFINx and PETSc alone."""
    import dolfinx.fem.petsc as fp
    import ufl
    from dolfinx import fem
    from petsc4py import PETSc

    mesh = mesh_of(unknowns).dolfinx
    V = fem.functionspace(mesh, ("Lagrange", 2, (3,)))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu, lmbda, s = 5e6 / 2.6, 5e6 * 0.3 / 1.3 / 0.4, 0.3e-6
    eps = ufl.sym(ufl.grad(u))
    sigma = 2 * mu * eps + lmbda * ufl.tr(eps) * ufl.Identity(3)
    E = fp.assemble_matrix(
        fem.form(1000.0 * ufl.inner(u, v) * ufl.dx + s * ufl.inner(sigma, ufl.sym(ufl.grad(v))) * ufl.dx)
    )
    E.assemble()
    E.setOption(PETSc.Mat.Option.SPD, True)
    ksp = PETSc.KSP().create(mesh.comm)
    ksp.setOperators(E)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.getPC().setFactorSolverType("cholmod" if mesh.comm.size == 1 else "mumps")
    ksp.setUp()
    x, b = E.createVecs()
    b.set(1.0)
    ksp.solve(b, x)
    return {"peak": peak(), "unknowns": float(E.size[0])}


def whole(unknowns: int, ramp: float = 0.5) -> dict[str, float]:
    """A run of 30 steps with gravity growing within ``ramp`` (s); medians of a step and of a back-solve."""
    import numpy as np

    import fmbd_fenicsx as fmbd
    from fmbd_fenicsx.linear.condensation import StepSolver
    from fmbd_fenicsx.schemes.consistent import consistent

    elastic = fmbd.materials.linear_elastic(5e6, 0.3)
    rod = fmbd.FloatingBody("rod", mesh_of(unknowns), density=1000.0, elastic=elastic)
    scene = fmbd.Scene("cost", gravity=(0, -9.81, 0), gravity_ramp=ramp)
    scene.add(rod, fmbd.revolute("pin", rod.surface("pin"), fmbd.ground, center=(0, 0, 0)))
    system, state, _ = scene.build()
    built = peak()
    solver, newton = StepSolver(system), fmbd.Newton()
    state, _ = consistent(system, state, solver)
    stepper = fmbd.GeneralizedAlpha(RHO).stepper(system, solver, newton, state)
    stepper.advance(STEP)
    solves, iterations = solver.elastic.back_solves, newton.iterations
    steps, backs = [], []
    factor = solver.blocks[0].factor.factor.factor.matrix
    x, b = factor.createVecs()
    b.array[:] = np.random.default_rng(0).standard_normal(b.local_size)
    for _ in range(30):
        begin = time.process_time()
        stepper.advance(STEP)
        steps.append(time.process_time() - begin)
        begin = time.process_time()
        factor.solve(b, x)
        backs.append(time.process_time() - begin)
    return {
        "peak": peak(),
        "peak_built": built,
        "step": statistics.median(steps),
        "back_solve": statistics.median(backs),
        "iterations": (newton.iterations - iterations) / 30,
        "back_solves": (solver.elastic.back_solves - solves) / 30,
    }


def child(what: str, unknowns: int) -> dict[str, float]:
    """One measurement in a process of its own: peaks of memory do not mix."""
    done = subprocess.run(
        [sys.executable, __file__, "--unknowns", str(unknowns), "--measure", what],
        check=True,
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> int:
    """Measure, print and judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--unknowns", type=int, default=100_000)
    parser.add_argument("--measure", choices=["bare", "whole", "sudden"], help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    if args.measure:
        made = bare(args.unknowns) if args.measure == "bare" else whole(args.unknowns, 0.5 * (args.measure == "whole"))
        print(json.dumps(made))
        return 0
    factor, run, sudden = (child(what, args.unknowns) for what in ("bare", "whole", "sudden"))
    ratios, memory = [r["step"] / r["back_solve"] for r in (run, sudden)], run["peak"] / factor["peak"]
    print(f"unknowns            {factor['unknowns']:12.0f}")
    for how, r, ratio in zip(("gravity grows", "gravity at once"), (run, sudden), ratios, strict=True):
        print(f"{how:20}{1e3 * r['step']:12.1f} ms a step, {1e3 * r['back_solve']:.1f} ms a back-solve")
        print(f"  Newton iterations {r['iterations']:12.2f}   back-solves {r['back_solves']:.2f}")
        print(f"  in back-solves    {ratio:12.2f}   (at most {TIME_BOUND})")
    print(f"peak of the factor  {factor['peak']:12.0f} MB")
    print(f"peak of the run     {run['peak']:12.0f} MB (before the factorisation {run['peak_built']:.0f} MB)")
    print(f"  ratio             {memory:12.2f}   (at most {MEMORY_BOUND})")
    ok = max(ratios) <= TIME_BOUND and memory <= MEMORY_BOUND
    if args.json:
        found = {"factor": factor, "run": run, "sudden": sudden, "time": ratios, "memory": memory, "ok": ok}
        args.json.write_text(json.dumps(found))
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main())
