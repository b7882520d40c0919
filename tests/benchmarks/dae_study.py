"""All DAE forms, Radau and BDF, and tolerances on four constrained systems: error against work, failures listed.

Run:  PYTHONPATH=.:demos:tests ./with-dolfinx python3 tests/benchmarks/dae_study.py [--fast] [--markdown FILE]
      (--only pendulum "car axis": these problems)

Pendulum (1 s), car axis (3 s), Andrews' mechanism (0.03 s) and the flexible slider crank (0.1 s; its elastic coordinates only, of
2e-4 m); errors of the coordinates at the end, against the motion in its angle and the references of the test set.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import andrews
import car_axis
import crank_model
import numpy as np
from dae_problems import pendulum, pendulum_at

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study
from fmbd_fenicsx.errors import FmbdError

FORMS = [fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.Baumgarte(20, 20), fmbd.GGL(), fmbd.Projected(fmbd.Index1()),
         fmbd.Overdetermined(), fmbd.StateSpace()]  # fmt: skip
CRANK = np.array(
    [np.nan] * 3 + [1.893192899613509e-4, 2.375751249879174e-5, -5.323896770569702e-6, -8.363313279112129e-6]
)
SCHEMES: dict[str, Any] = {
    "Radau(3)": lambda f, r: fmbd.Radau(3, f, r),
    "Radau(5)": lambda f, r: fmbd.Radau(5, f, r),
    "BDF": lambda f, r: fmbd.BDF(5, f, r),
}
PROBLEMS: dict[str, tuple[Any, float, str, np.ndarray]] = {
    "pendulum": (pendulum, 1.0, "x", pendulum_at(1.0)[0]),
    "car axis": (car_axis.scene, 3.0, "ends", car_axis.REFERENCE),
    "Andrews": (andrews.scene, 0.03, "angles", andrews.REFERENCE),
    "flexible crank": (lambda: crank_model.scene(crank_model.Rod(), crank_model.SMOOTH), 0.1, "coordinates", CRANK),
}


def one(problem: str, scheme: Any) -> dict[str, Any]:
    """Error, CPU seconds and steps of a run, or its failure."""
    scene, t_end, sensor, exact = PROBLEMS[problem]
    begin = time.process_time()
    try:
        run = fmbd.solve(scene(), t_end=t_end, scheme=scheme, output=fmbd.Output(every=10**6, energy=False))
    except FmbdError as error:
        return {"failure": str(error)}
    seconds = time.process_time() - begin
    error = float(np.nanmax(np.abs(run[sensor][-1] - exact)))
    return {"error": error, "seconds": seconds, "steps": run.counters["steps"], "drift": run.drift[0]}


def table(
    problems: list[str], tolerances: list[float]
) -> tuple[list[list[str]], dict[tuple[str, str, str], list[dict[str, Any]]], list[str]]:
    """Rows for the page, the runs by (problem, scheme, form), and the failures."""
    rows = [["problem", "scheme", "form", *(f"{r:.0e}: error / s / steps" for r in tolerances)]]
    runs: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    failures = []
    for problem in problems:
        for name, made in SCHEMES.items():
            for form in FORMS:
                found = [one(problem, made(form, r)) for r in tolerances]
                runs[problem, name, form.name] = found
                cells = [
                    "failed" if "failure" in x else f"{x['error']:.0e} / {x['seconds']:.1f} / {x['steps']:.0f}"
                    for x in found
                ]
                failures += [
                    f"{problem}, {name}, {form.name}, rtol {r:.0e}: {x['failure']}"
                    for r, x in zip(tolerances, found, strict=True)
                    if "failure" in x
                ]
                rows.append([problem, name, form.name, *cells])
                print(" | ".join(rows[-1]), flush=True)
    return rows, runs, failures


def figure(runs: dict[tuple[str, str, str], list[dict[str, Any]]], file: Path) -> None:
    """Error over CPU time: a panel for each problem and scheme, a line for each form."""
    problems = list(dict.fromkeys(problem for problem, _, _ in runs))
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    fig, axes = plt.subplots(
        len(problems),
        len(SCHEMES),
        figsize=(12, 1 + 3 * len(problems)),
        squeeze=False,
        sharex="row",
        sharey="row",
        layout="constrained",
    )
    for i, problem in enumerate(problems):
        for j, name in enumerate(SCHEMES):
            ax = axes[i, j]
            for k, form in enumerate(FORMS):
                good = [x for x in runs[problem, name, form.name] if "failure" not in x]
                style = "o-" if k < 5 else "s--"
                ax.loglog([x["seconds"] for x in good], [x["error"] for x in good], style, ms=4, label=form.name)
            ax.set_title(f"{problem}, {name}")
            ax.grid(alpha=0.3)
            ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.xaxis.set_major_formatter(FormatStrFormatter("%g"))
            ax.xaxis.set_minor_formatter(NullFormatter())
        axes[i, 0].set_ylabel("error of coordinates at the end")
    for ax in axes[-1]:
        ax.set_xlabel("CPU time, s")
    fig.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    fig.savefig(file, dpi=110)


def main() -> None:
    """Table and figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--only", nargs="+", choices=list(PROBLEMS))
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--picture", type=Path)
    args = parser.parse_args()
    problems = args.only or list(PROBLEMS)
    rows, runs, failures = table(problems, [1e-3, 1e-5] if args.fast else [1e-3, 1e-5, 1e-7, 1e-9])
    print("failures:", *(failures or ["none"]), sep="\n")
    if args.markdown:
        args.markdown.write_text(study.markdown(rows) + "\n\n" + "\n".join(failures) + "\n")
    if args.picture:
        figure(runs, args.picture)


if __name__ == "__main__":
    main()
