"""The tables of docs/traces.md: inf-sup constants in space, MINRES counts along all axes, chains, BDDC
beside multigrid.

Run:  ./with-dolfinx python3 docs/scripts/trace_tables.py space|axes|axes3|chain
      ./with-dolfinx mpirun -n 8 python3 docs/scripts/trace_tables.py bddc|ranks
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from tied import chain, tied, unit_field  # noqa: E402

import fmbd_fenicsx as fmbd  # noqa: E402
from fmbd_fenicsx import demo  # noqa: E402
from fmbd_fenicsx.fem.fields import Field  # noqa: E402
from fmbd_fenicsx.fem.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends  # noqa: E402
from fmbd_fenicsx.fem.traces.stability import infsup  # noqa: E402
from fmbd_fenicsx.linear.blocks.domain_decomposition import unassembled  # noqa: E402
from fmbd_fenicsx.linear.blocks.elastic_blocks import (  # noqa: E402
    Elastic,  # noqa: E402
    Multigrid,
    set_bddc,
)
from fmbd_fenicsx.linear.presets import FieldSplit, Preset, Schur  # noqa: E402
from fmbd_fenicsx.linear.rigid_modes import elastic_matrix  # noqa: E402
from fmbd_fenicsx.linear.tie_preconditioner import Lumped  # noqa: E402

SIDES = ("left", "right", "back", "front")


def space() -> None:
    """Inf-sup constants on the unit cube, tetrahedra, n = 2, 4, 8."""
    kept, p1 = Continuous(ends=Ends.KEPT), Continuous(1, Ends.KEPT)
    rows = [
        (1, kept),
        (1, Continuous()),
        (1, Dual()),
        (1, Discontinuous(0)),
        (1, Aggregated()),
        (2, kept),
        (2, Continuous()),
    ]
    rows += [(2, p1), (2, Continuous(1)), (2, Discontinuous(0)), (2, Discontinuous(1)), (2, Aggregated())]
    mesh = {n: fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * 3, cells=n) for n in (2, 4, 8, 16)}
    for degree, multipliers in rows:
        cells = []
        for held in ((), SIDES):
            for n in (2, 4, 8):
                r = infsup(
                    (mesh[n], "bottom"),
                    multipliers,
                    degree=degree,
                    clamped=held,
                    reference=(mesh[2 * n if n < 8 else 16], 2),
                )
                cells.append(f"{r.constant:.3f} ({r.zero_modes})")
        demo.say(f"| {r.name} | {' '.join(cells[:3])} | {' '.join(cells[3:])} |")


def count(preset: Preset, **case: float) -> str:
    """Iterations, and the error where it is large."""
    try:
        iterations, error = tied(**{"cells": 16, **case}).tried(preset)
    except (fmbd.errors.LinearSolveError, fmbd.errors.ConvergenceError):
        return "-"
    return f"{iterations}" + ("" if error < 1e-5 else f" (error {error:.0e})")


PRESETS = {
    "Schur, fractional": Schur(limit=0, rtol=1e-8),
    "FieldSplit, fractional": FieldSplit(),
    "FieldSplit, fractional, multigrid (2 cycles)": FieldSplit(Multigrid(2)),
    "FieldSplit, fractional, multigrid": FieldSplit(Multigrid()),
    "FieldSplit, lumped": FieldSplit(multiplier=Lumped()),
}


def axes(dim: int = 2) -> None:
    """Counts over h, dt, E, rho, nu for several preconditioners, P2, two blocks of which one floats."""
    cells, base = ((8, 16, 32, 64), 16) if dim == 2 else ((2, 3, 4, 6), 4)
    for name, preset in list(PRESETS.items())[: 5 if dim == 2 else 3]:
        for step, label in ((1e-3, "1e-3 h"), (1.0, "h"), (10.0, "10 h"), (None, "static")):
            case = {"step": step, "dim": dim, "cells": base}
            h = [count(preset, **{**case, "cells": n}) for n in cells]
            E = [count(preset, **case, E=e) for e in (1e-6, 1e-3, 1e3, 1e6)]
            rho = [count(preset, **case, rho=r) for r in (1e-6, 1e6)]
            nu = "" if "multigrid" in name else count(preset, **case, nu=0.4999)
            demo.say(f"| {name} | {label} | {' '.join(h)} | {' '.join(E)} | {' '.join(rho)} | {nu} |")


def ranks() -> None:
    """Counts of the corners of all axes on the ranks of this run, P2 in the plane and in space."""
    for dim, cells in ((2, 16), (3, 3)):
        for name, preset in list(PRESETS.items())[:3]:
            found = [
                count(preset, dim=dim, cells=cells, step=step, E=E, rho=rho)
                for step in (1.0, 10.0)
                for E, rho in ((1.0, 1.0), (1e6, 1.0), (1.0, 1e-6))
            ]
            demo.say(f"| {name} | {dim}D | {fmbd_ranks()} | {' '.join(found)} |")


def fmbd_ranks() -> int:
    """Ranks of this run."""
    from mpi4py import MPI

    return int(MPI.COMM_WORLD.size)


def links() -> None:
    """Counts for chains of tied links."""
    for n in (1, 2, 4, 8, 16, 32):
        s = chain(n)
        whole, multipliers = (s.tried(preset)[0] for preset in (FieldSplit(), Schur(limit=0, rtol=1e-8)))
        demo.say(f"{n} links, {s.system.n_lam} multipliers: MINRES {whole}, GMRES on S {multipliers}")


def bddc() -> None:
    """Counts of CG on the elastic block of one distributed body, rtol 1e-8 in the true residual."""
    for dim, n in ((2, 24), (3, 6)):
        body = unit_field(dim, n, 2)
        for step in (1.0, 10.0, 100.0):
            counts = [one_body(body, 4 * (n / step) ** 2, kind) for kind in ENGINES]
            demo.say(f"| {dim}D | {body.comm.size} | {step:g} h | {' | '.join(counts)} |")
        body.destroy()


ENGINES = ("bddc", "plain bddc", "fetidp", "multigrid", "gamg", "hypre")


def one_body(body: Field, cm: float, kind: str) -> str:
    """Iterations of one engine; "-" where its answer misses 1e-6 in the true residual of the assembled matrix."""
    from petsc4py import PETSc

    split, whole = unassembled(body, cm, 1.0), elastic_matrix(body, cm, 1.0)
    b = whole.createVecLeft()
    b.array[:] = np.repeat(np.sin(300 * body.X_world.sum(1))[:, None], body.dim, 1).ravel()
    ksp, options = PETSc.KSP().create(body.comm), PETSc.Options()
    prefix = f"{kind.replace(' ', '_')}_{body.dim}{int(cm)}_"
    ksp.setOptionsPrefix(prefix)
    ksp.setOperators(split if "bddc" in kind or kind == "fetidp" else whole)
    if kind == "fetidp":
        ksp.setType("fetidp")
        options[prefix + "fetidp_ksp_type"], options[prefix + "fetidp_ksp_rtol"] = "cg", 1e-8
        options[prefix + "fetidp_ksp_max_it"] = 500
        options[prefix + "fetidp_bddc_pc_bddc_use_deluxe_scaling"] = True
        options[prefix + "fetidp_bddc_pc_bddc_deluxe_singlemat"] = True
        options[prefix + "fetidp_bddc_pc_bddc_adaptive_threshold"] = 2.0
    else:
        ksp.setType("cg")
        ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        if kind == "multigrid":
            Multigrid().set_up(ksp, Elastic(body, cm))
        elif "bddc" in kind:
            set_bddc(ksp, 2.0 if kind == "bddc" else 0.0)
        else:
            ksp.getPC().setType(kind)
        ksp.setType("cg")
        ksp.setTolerances(rtol=1e-8, max_it=500)
    ksp.setFromOptions()
    x, r = b.duplicate(), b.duplicate()
    ksp.solve(b, x)
    whole.mult(x, r)
    r.axpy(-1.0, b)
    found = f"{ksp.getIterationNumber()}" if r.norm() <= 1e-6 * b.norm() else "-"
    for obj in (ksp, x, r, b, split, whole):
        obj.destroy()
    return found


if __name__ == "__main__":
    {"space": space, "axes": axes, "axes3": lambda: axes(3), "ranks": ranks, "chain": links, "bddc": bddc}[
        sys.argv[1]
    ]()
