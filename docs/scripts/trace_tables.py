"""The tables of docs/traces.md: inf-sup constants in space, MINRES counts along all axes, chains, BDDC
beside multigrid.

Run:  ./with-dolfinx python3 docs/scripts/trace_tables.py space|axes|chain          mpirun -n 8 ...
trace_tables.py bddc
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from test_presets import chain  # noqa: E402
from tied import block, manufactured, release, tied  # noqa: E402

import fmbd_fenicsx as fmbd  # noqa: E402
from fmbd_fenicsx import demo  # noqa: E402
from fmbd_fenicsx.linear.precondition import Lumped, ScaledMass  # noqa: E402
from fmbd_fenicsx.linear.presets import FieldSplit, Multigrid, set_bddc  # noqa: E402
from fmbd_fenicsx.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends  # noqa: E402
from fmbd_fenicsx.traces.stability import infsup  # noqa: E402

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


def count(preset: FieldSplit, **case: float) -> str:
    """MINRES iterations, and the error where it is large."""
    s = tied(**{"cells": 16, **case})
    f, g, error = manufactured(s)
    try:
        solver = preset.solver(s)
        found = solver.solve(f, g)
        out = f"{found.iterations}" + ("" if error(found) < 1e-5 else f" (error {error(found):.0e})")
        solver.destroy()
    except fmbd.errors.LinearSolveError:
        out = "-"
    release(s)
    return out


def axes() -> None:
    """Counts over h, dt, E, rho, nu for several preconditioners, P2, two blocks of which one floats."""
    for name, preset in (("fractional", FieldSplit()), ("fractional, multigrid", FieldSplit(Multigrid(2))),
                         ("lumped", FieldSplit(multiplier=Lumped())),
                         ("h-weighted mass", FieldSplit(multiplier=ScaledMass()))):  # fmt: skip
        for step, label in ((1e-3, "1e-3 h"), (1.0, "h"), (10.0, "10 h"), (None, "static")):
            h = [count(preset, step=step, cells=n) for n in (8, 16, 32, 64)]
            E = [count(preset, step=step, E=e) for e in (1e-6, 1e-3, 1e3, 1e6)]
            rho = [count(preset, step=step, rho=r) for r in (1e-6, 1e6)]
            demo.say(
                f"| {name} | {label} | {' '.join(h)} | {' '.join(E)} | {' '.join(rho)} | {count(preset, step=step, nu=0.4999)} |"
            )


def links() -> None:
    """Counts for chains of tied links."""
    for n in (1, 2, 4, 8, 16, 32):
        s = chain(n)
        solver = FieldSplit().solver(s)
        f, g, _ = manufactured(s)
        demo.say(f"{n} links, {s.n_multipliers} multipliers: {solver.solve(f, g).iterations}")
        solver.destroy()
        release(s)


def bddc() -> None:
    """Counts of CG on the elastic block of one distributed body."""
    from petsc4py import PETSc

    from fmbd_fenicsx.linear.domain_decomposition import unassembled
    from fmbd_fenicsx.linear.saddle import Elastic, elastic_matrix

    for dim, n in ((2, 24), (3, 6)):
        body = block("body", dim, n, 2)
        for step in (1.0, 10.0, 100.0):
            cm, counts = 4 * (n / step) ** 2, []
            split, whole = unassembled(body, cm, 1.0), elastic_matrix(body, cm, 1.0)
            b = whole.createVecLeft()
            b.array[:] = np.repeat(np.sin(300 * body.X_world.sum(1))[:, None], dim, 1).ravel()
            for kind in ("bddc", "plain bddc", "gamg", "hypre"):
                ksp = PETSc.KSP().create(body.comm)
                ksp.setOptionsPrefix(f"{kind.replace(' ', '_')}_{dim}{int(step)}_")
                ksp.setOperators(split if "bddc" in kind else whole)
                if kind == "hypre":
                    ksp.getPC().setType("hypre")
                elif kind == "gamg":
                    Multigrid().set_up(ksp, Elastic(body, cm))
                else:
                    set_bddc(ksp, 2.0 if kind == "bddc" else 0.0)
                ksp.setType("cg")
                ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
                ksp.setTolerances(rtol=1e-8, max_it=500)
                ksp.setFromOptions()
                x = b.duplicate()
                ksp.solve(b, x)
                counts.append(str(ksp.getIterationNumber()) if ksp.getConvergedReason() > 0 else "-")
                ksp.destroy(), x.destroy()
            demo.say(f"| {dim}D | {body.comm.size} | {step:g} h | {' | '.join(counts)} |")
            split.destroy(), whole.destroy(), b.destroy()


if __name__ == "__main__":
    {"space": space, "axes": axes, "chain": links, "bddc": bddc}[sys.argv[1]]()
