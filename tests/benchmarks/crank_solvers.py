"""The flexible slider crank by our schemes and by general DAE solvers, in one process: error against CPU time.

Run:  PYTHONPATH=.:demos PYTHON tests/benchmarks/crank_solvers.py [--json FILE] [--fast]

PYTHON is an interpreter with scikit-sundae (IDA of SUNDIALS) and scipy-dae; a solver that is not installed is left out. All solve
the published problem over 0.1 s with the same Python functions of demos/crank_model.py, from the same consistent start, on one
thread. Forms for the general solvers: ``ind1``, G v' + gamma = 0 with lambda; ``sti1``, GGL with the multipliers as derivatives,
so that the index is 1. Errors: phi2 (rad), and the largest relative error of the four elastic coordinates, against the reference
of 2006. Absolute tolerances: rtol times 0.45 for angles and lengths of the mechanism, 4.5e-4 for elastic coordinates, and the
fastest rate of each kind.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from pathlib import Path
from typing import Any

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"

import crank_model as model
import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent

END = np.array(
    [-0.331173498825626, 1.893192899613509e-4, 2.375751249879174e-5, -5.323896770569702e-6, -8.363313279112129e-6]
)
T_END, ROD = 0.1, model.Rod()
SIZES = np.array([0.45] * 3 + [4.5e-4] * 4)
RATES = np.array([150.0] * 3 + [0.5] * 4)


def start() -> Any:
    """Consistent state: positions and rates, accelerations, multipliers."""
    system, given, _ = model.scene(ROD, model.SMOOTH).build()
    return consistent(system, given, StepSolver(system))[0]


def acceleration_level(t: float, y: np.ndarray, yp: np.ndarray) -> np.ndarray:
    """Residual of ``ind1``, y = (q, v, lambda)."""
    q, v, lam, vd = y[:7], y[7:14], y[14:17], yp[7:14]
    G = model.jacobian(q, t)
    balance = model.mass_matrix(ROD, q) @ vd - model.forces(ROD, q, v) + G.T @ lam
    return np.concatenate((yp[:7] - v, balance, G @ vd + model.gamma(q, v, t)))


def stabilised(t: float, y: np.ndarray, yp: np.ndarray) -> np.ndarray:
    """Residual of ``sti1``, y = (q, v, integral of lambda, integral of mu)."""
    q, v, vd = y[:7], y[7:14], yp[7:14]
    G = model.jacobian(q, t)
    balance = model.mass_matrix(ROD, q) @ vd - model.forces(ROD, q, v) + G.T @ yp[14:17]
    kinematics = yp[:7] - v + G.T @ yp[17:20]
    return np.concatenate((kinematics, balance, G @ v + model.rate(q, t), model.constraints(q, t)))


FORMS = {"ind1": (acceleration_level, [14, 15, 16]), "sti1": (stabilised, [])}


def given(form: str, state: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """y, y' at the start, and the sizes of y."""
    q, v, a, lam = state.q, state.v, state.a, state.lam
    if form == "ind1":
        return np.r_[q, v, lam], np.r_[v, a, np.zeros(3)], np.r_[SIZES, RATES, [400.0] * 3]
    return np.r_[q, v, np.zeros(6)], np.r_[v, a, lam, np.zeros(3)], np.r_[SIZES, RATES, [1.0] * 3, [1e-3] * 3]


def ida(form: str, rtol: float, state: Any) -> np.ndarray:
    """IDA by scikit-sundae."""
    from sksundae.ida import IDA

    function, algebraic = FORMS[form]

    def residual(t: float, y: np.ndarray, yp: np.ndarray, out: np.ndarray) -> None:
        out[:] = function(t, y, yp)

    y, yp, sizes = given(form, state)
    options = {"algebraic_idx": algebraic} if algebraic else {}
    solver = IDA(residual, rtol=rtol, atol=rtol * sizes, max_num_steps=10**6, **options)
    found = solver.solve(np.array([0.0, T_END]), y, yp)
    if not found.success:
        raise RuntimeError(found.message)
    return np.asarray(found.y[-1])


def scipy_dae(method: str) -> Any:
    """Radau or BDF of scipy-dae."""

    def run(form: str, rtol: float, state: Any) -> np.ndarray:
        from scipy_dae.integrate import solve_dae

        y, yp, sizes = given(form, state)
        found = solve_dae(
            FORMS[form][0], (0.0, T_END), y, yp, method=method, rtol=rtol, atol=rtol * sizes, t_eval=[T_END]
        )
        if not found.success:
            raise RuntimeError(found.message)
        return np.asarray(found.y[:, -1])

    return run


def ours(scheme: Any) -> np.ndarray:
    """A scheme of this package."""
    run = fmbd.solve(
        model.scene(ROD, model.SMOOTH), t_end=T_END, scheme=scheme, output=fmbd.Output(every=10**6, energy=False)
    )
    return np.asarray(run["coordinates"][-1])


def cases(fast: bool) -> list[tuple[str, float, Any]]:
    """(label, rtol, callable -> coordinates)."""
    state = start()
    stages = {7: (1e-6,)} if fast else {7: (1e-5, 1e-6, 1e-7, 1e-8), 5: (1e-6, 1e-7, 1e-8), 3: (1e-4, 1e-5, 1e-6)}
    made: list[tuple[str, float, Any]] = []
    for s, ladder in stages.items():
        made += [(f"Radau IIA({s}), GGL", r, lambda s=s, r=r: ours(fmbd.Radau(s, fmbd.GGL(), r))) for r in ladder]
    tried = {"IDA": ida, "scipy-dae Radau": scipy_dae("Radau"), "scipy-dae BDF": scipy_dae("BDF")}
    for name, solve in tried.items():
        ladder = (1e-5,) if fast else (1e-7, 1e-8, 1e-9, 1e-10, 1e-11) if name == "IDA" else (1e-5, 1e-6, 1e-7)
        for form in FORMS:
            made += [(f"{name}, {form}", r, lambda s=solve, f=form, r=r: s(f, r, state)) for r in ladder]
    if not fast:
        made += [("BDF, GGL", r, lambda r=r: ours(fmbd.BDF(5, fmbd.GGL(), r))) for r in (1e-4, 1e-5, 1e-6)]
    return made


def measure(fast: bool, repeats: int, longest: float = 40.0) -> list[dict[str, Any]]:
    """All cases in turn: CPU seconds (median), errors, or the failure. A line stops after a run longer than ``longest`` s."""
    ours(fmbd.Radau(7, fmbd.GGL(), 1e-3))  # warm
    rows: list[dict[str, Any]] = []
    stopped: set[str] = set()
    for label, rtol, run in cases(fast):
        row: dict[str, Any] = {"label": label, "rtol": rtol}
        if label in stopped:
            continue
        try:
            seconds = []
            for _ in range(repeats):
                begin = time.process_time()
                y = run()
                seconds.append(time.process_time() - begin)
                if seconds[-1] > 10.0:
                    break
            row |= {"seconds": statistics.median(seconds), "phi2": float(abs(y[1] - END[0]))}
            row["elastic"] = float(np.abs(y[3:7] / END[1:] - 1).max())
            if row["seconds"] > longest:
                stopped.add(label)
        except ImportError:
            continue
        except Exception as error:
            row["failure"] = f"{type(error).__name__}: {str(error)[:80]}"
        rows.append(row)
        print(row, flush=True)
    return rows


def time_to(rows: list[dict[str, Any]], label: str, kind: str, error: float) -> float:
    """CPU seconds of the fastest run of a label that reaches an error, inf where none does."""
    return min((r["seconds"] for r in rows if r["label"] == label and r.get(kind, np.inf) <= error), default=np.inf)


def main() -> None:
    """Table, and JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    rows = measure(args.fast, args.repeats)
    print("\nCPU seconds to reach an error: phi2 1e-9, 1e-11 rad; elastic coordinates 1e-4, 1e-6, 1e-8")
    for label in dict.fromkeys(r["label"] for r in rows):
        found = [time_to(rows, label, "phi2", e) for e in (1e-9, 1e-11)]
        found += [time_to(rows, label, "elastic", e) for e in (1e-4, 1e-6, 1e-8)]
        print(f"{label:26s}" + "".join(f"{x:9.2f}" if np.isfinite(x) else f"{'-':>9s}" for x in found))
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
