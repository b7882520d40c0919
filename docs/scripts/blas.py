"""CPU time of one factorisation and one back-solve of an elastic block, and which BLAS did it; P2 in space.

Run:  ./with-dolfinx python3 docs/scripts/blas.py 12
      ./with-dolfinx env LD_LIBRARY_PATH=REFERENCE python3 docs/scripts/blas.py 12

REFERENCE: the folders of the reference BLAS and LAPACK, on Debian 13 /usr/lib/x86_64-linux-gnu/blas and .../lapack, with
a colon between them.
"""

import statistics
import sys
import time
from pathlib import Path

import numpy as np
from petsc4py import PETSc

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.fem.elastic_forms import ElasticForms
from fmbd_fenicsx.fem.fields import Field

ROOT = Path(__file__).resolve().parents[2]


def main(cells: int) -> None:
    """Cholesky by MUMPS and CHOLMOD."""
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0, 1.0, 1.0), cells=cells)
    body = Field("block", mesh, ElasticForms(fmbd.materials.linear_elastic(1.0, 0.3), 1.0, 2))
    E = body.combination(4.0 * cells**2, 1.0)
    E.setOption(PETSc.Mat.Option.SPD, True)
    used = {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "libblas.so" in line}
    demo.say(f"{body.n_global} unknowns, {', '.join(sorted(used))}")
    x, b = E.createVecs()
    b.array[:] = np.sin(np.arange(b.local_size))
    for package in ("mumps", "cholmod"):
        ksp = PETSc.KSP().create(body.comm)
        ksp.setOperators(E)
        ksp.setType("preonly")
        ksp.getPC().setType("cholesky")
        ksp.getPC().setFactorSolverType(package)
        begin = time.process_time()
        ksp.setUp()
        factor, solves = time.process_time() - begin, []
        for _ in range(5):
            begin = time.process_time()
            ksp.solve(b, x)
            solves.append(time.process_time() - begin)
        demo.say(f"{package:8s} factor {factor:.2f} s, back-solve {1e3 * statistics.median(solves):.0f} ms")
        ksp.destroy()


if __name__ == "__main__":
    main(int(sys.argv[1]))
