"""CPU time to an error of 1e-6 and of 1e-9: schemes of this package beside IDA and Exudyn, in one run.

Run:  PYTHONPATH=.:demos:tests:tests/benchmarks ./with-dolfinx python3 tests/benchmarks/time_to_error.py [--write]
      (--write: docs/time_to_error.md; --only NAME; --repeat 3; --longest 10)

Tolerances fall by factors of the root of ten (steps of Exudyn by halves) until the error at the end, relative to the largest
component of the reference, is below 1e-9; of the runs that came to an error the cheapest counts, repeated. No run takes longer
than ``--longest`` seconds of CPU time. IDA needs scikit-sundae, Exudyn an interpreter that has it, EXUDYN_PYTHON or this one;
without them their columns are empty. Exit code 1 where the better of the two was faster.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import andrews_model
import ida_equations
import mechanisms_of_bodies as bodies
import numpy as np
from observatory import PROBLEMS, TooLongError, at_most
from observatory_oscillators import ARM, SPEED, J, M, R

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError

PAGE = Path(__file__).resolve().parents[2] / "docs" / "time_to_error.md"
MODELS = Path(__file__).with_name("observatory_exudyn.py")
QUIET = fmbd.Output(every=10**9, energy=False, progress=False)
NAMES = ("slider crank", "Andrews' mechanism", "car axis", "flexible slider crank")
GOALS = (1e-6, 1e-9)
TOLERANCES = [10.0 ** (-k / 2) for k in range(9, 27)]
SHARE = 0.15  # of IDA's time, that the rigid crank may take to 1e-9


@dataclass(frozen=True)
class Run:
    """One run: error at the end, CPU seconds, evaluations, CPU seconds in functions that a neighbour is given."""

    error: float
    seconds: float
    evaluations: float = 0.0
    given: float = 0.0


@dataclass(frozen=True)
class Row:
    """Who came to an error first of some, and how."""

    label: str
    tolerance: float
    run: Run


# -- runs ---------------------------------------------------------------------------------------------------------------
def error_of(name: str, found: Any) -> float:
    """The largest error over the largest component of the reference, of as many components as this has."""
    exact = np.asarray(PROBLEMS[name].reference(), dtype=float)
    off = np.abs(np.asarray(found, dtype=float)[: len(exact)] - exact)
    return float(np.nanmax(off) / np.nanmax(np.abs(exact)))


SCENES: dict[str, tuple[Callable[[], fmbd.Scene], Callable[[Any], Any]]] = {
    "slider crank": (PROBLEMS["slider crank"].scene, lambda q: q[2:3]),
    "Andrews' mechanism": (bodies.andrews, bodies.andrews_coordinates),
    "car axis": (bodies.car_axis, bodies.car_coordinates),
    "flexible slider crank": (PROBLEMS["flexible slider crank"].scene, lambda q: q),
}
OURS: dict[str, Callable[[float], Any]] = {
    "explicit Runge-Kutta (8)": lambda rtol: fmbd.ExplicitRungeKutta(rtol),
    "Radau(5), index 3": lambda rtol: fmbd.Radau(5, fmbd.Index3(), rtol),
    "Radau(7), GGL": lambda rtol: fmbd.Radau(7, fmbd.GGL(), rtol),
    "Radau(7), index 3": lambda rtol: fmbd.Radau(7, fmbd.Index3(), rtol),
}


def ours(name: str, scheme: str, rtol: float, longest: float) -> Run:
    """A whole run of this package, set-up included."""
    make, coordinates = SCENES[name]
    begun = time.process_time()
    with at_most(longest):
        run = fmbd.solve(make(), t_end=PROBLEMS[name].t_end, scheme=OURS[scheme](rtol), output=QUIET)
    spent = time.process_time() - begun
    return Run(error_of(name, coordinates(run.state.q)), spent, run.counters["residuals"])


def ida(name: str, form: str, rtol: float, longest: float) -> Run:
    """IDA with the equations of :mod:`ida_equations`."""
    q, spent, counted = ida_equations.ida(name, form, rtol, longest)
    return Run(error_of(name, q), spent, counted.calls, counted.spent)


def told(name: str) -> dict[str, Any] | None:
    """A mechanism as lists of numbers for Exudyn: None for those with a driven chord or an elastic rod."""
    if name == "slider crank":
        speed = SPEED * R / 2
        return {
            "bodies": [
                (M[0], J[0], R / 2, 0, 0, 0, speed, SPEED),
                (M[1], J[1], R + ARM / 2, 0, 0, 0, speed, -R / ARM * SPEED),
                (M[2], 1e-4, R + ARM, 0, 0, 0, 0, 0),
            ],
            "hinges": [(-1, 0, 0, 0), (0, 1, R, 0), (1, 2, R + ARM, 0)], "springs": [], "guided": [2], "torques": [],
        }  # fmt: skip
    if name != "Andrews' mechanism":
        return None
    places, point = bodies.andrews_places()
    masses = (
        [getattr(andrews_model, f"M{i}") for i in range(1, 8)],
        [getattr(andrews_model, f"I{i}") for i in range(1, 8)],
    )
    made = [(m, inertia, *at, turn, 0, 0, 0) for m, inertia, (at, turn) in zip(*masses, places, strict=True)]
    hinges = [(a, b, *at) for a, b, at in bodies.andrews_hinges(point)]
    spring = (-1, *point["fixed"], 2, *point["end"], andrews_model.C0, andrews_model.L0)
    return {"bodies": made, "hinges": hinges, "springs": [spring], "guided": [], "torques": [(0, andrews_model.TORQUE)]}


def exudyn(name: str, model: dict[str, Any], steps: float, longest: float) -> Run:
    """Generalized-alpha of Exudyn: its own CPU time, without the start of Python."""
    interpreter = os.environ.get("EXUDYN_PYTHON", sys.executable)
    command = [interpreter, str(MODELS), "mechanism", str(int(steps)), repr(PROBLEMS[name].t_end)]
    text = json.dumps(model, default=float)
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=6 * longest + 20, check=False)
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no message"])[-1])
    found = json.loads(done.stdout.strip().splitlines()[-1])
    return Run(error_of(name, SCENES[name][1](np.array(found["end"]))), found["seconds"], steps)


# -- search -------------------------------------------------------------------------------------------------------------
FAILED = (FmbdError, TooLongError, RuntimeError, np.linalg.LinAlgError, subprocess.TimeoutExpired, ValueError)


def searched(label: str, values: Any, run: Callable[[float], Run], longest: float) -> list[Row]:
    """Runs with finer and finer values until the error is below the smallest goal, or a run takes too long."""
    rows: list[Row] = []
    for value in values:
        begun = time.process_time()
        try:
            rows.append(Row(label, value, run(value)))
        except FAILED as failure:
            if isinstance(failure, TooLongError | subprocess.TimeoutExpired) or time.process_time() - begun > longest:
                break
            continue
        print(
            f"    {label} {value:.1e}: {rows[-1].run.error:.1e}, {1e3 * rows[-1].run.seconds:.1f} ms", file=sys.stderr
        )
        if rows[-1].run.error <= min(GOALS) or rows[-1].run.seconds > 0.8 * longest:
            break
    return rows


def best(rows: list[Row], goal: float, runs: dict[str, Callable[[float], Run]], repeat: int) -> Row | None:
    """The cheapest run that keeps below an error, as all finer ones of its scheme do; its time the least of several."""
    came = []
    for label in runs:
        own = [row for row in rows if row.label == label]
        missed = [i for i, row in enumerate(own) if row.run.error > goal]
        came += own[missed[-1] + 1 if missed else 0 :]
    if not came:
        return None
    first = min(came, key=lambda row: row.run.seconds)
    again = [first.run, *(runs[first.label](first.tolerance) for _ in range(repeat - 1))]
    return Row(first.label, first.tolerance, min(again, key=lambda run: run.seconds))


def of_problem(name: str, given: Any) -> dict[str, tuple[list[Row], dict[str, Callable[[float], Run]]]]:
    """All runs of a problem by who made them."""
    longest = given.longest
    mine = {s: lambda r, s=s: ours(name, s, r, longest) for s in OURS}
    theirs = {form: lambda r, form=form: ida(name, form, r, longest) for form in ida_equations.FORMS}
    model = told(name)
    other = {} if model is None else {"generalized-alpha": lambda n: exudyn(name, model, n, longest)}
    steps = [PROBLEMS[name].steps * 2.0**k for k in range(16)]

    out = {}
    for who, runs, values in (("ours", mine, TOLERANCES), ("IDA", theirs, TOLERANCES), ("Exudyn", other, steps)):
        rows: list[Row] = []
        try:
            for label, run in runs.items():
                rows += searched(label, values, run, longest)
        except ida_equations.NotThereError:
            pass
        out[who] = rows, runs
    return out


# -- page ---------------------------------------------------------------------------------------------------------------
def ms(row: Row | None) -> str:
    """A time, in ms."""
    return "-" if row is None else f"{1e3 * row.run.seconds:.3g}"


def line(name: str, goal: float, found: dict[str, Row | None]) -> tuple[str, bool]:
    """A line of the table, and whether a neighbour was faster, or IDA too near where a share of its time is asked for."""
    mine, theirs = found["ours"], found["IDA"]
    others = [row.run.seconds for who, row in found.items() if who != "ours" and row is not None]
    own = np.inf if mine is None else mine.run.seconds
    late = own > min(others, default=np.inf)
    if name == "slider crank" and goal == 1e-9 and theirs is not None:
        late |= own > SHARE * theirs.run.seconds

    ratio = f"{own / min(others):.2g}" if others and mine is not None else "-"
    scheme = "none" if mine is None else f"{mine.label}, rtol {mine.tolerance:.0e}, {mine.run.evaluations:.0f}"
    inside = "-"
    if theirs is not None:
        inside = f"{theirs.label}, {theirs.run.evaluations:.0f}, {100 * theirs.run.given / theirs.run.seconds:.0f} %"
    cells = (name, f"{goal:.0e}", ms(mine), scheme, ms(theirs), inside, ms(found["Exudyn"]), ratio)
    return "| " + " | ".join(cells) + f" |{' slower' if late else ''}", late


HEAD = """# CPU time to an error

Written by `tests/benchmarks/time_to_error.py --write` (its head says how): CPU time of whole runs, set-up included, kernels kept,
to errors of 1e-6 and 1e-9 at the end, relative to the largest component of the reference: of each scheme the tolerance from which
on all finer ones keep below the error, of the schemes the fastest, the least time of {repeat} runs, in one call on one core of a
machine with other work. No run may take longer than {longest:g} s.

**IDA** of SUNDIALS (scikit-sundae) has the equations in the fewest coordinates, three to seven, in lean functions of NumPy, in
the form that is faster of two: index 1, or stabilised, with multipliers as derivatives that are left out of the error test; its
Jacobian is one call. "in functions" is the share of its time that these functions take, which are Python; the rest is IDA's own.
**Exudyn 1.13.6** has rigid bodies of its own and generalized-alpha with equal steps, of order two; it has no model of the last
two. This package has Andrews' mechanism and the car axis as rigid bodies and joints, 21 and 6 coordinates; the flexible crank is
in coordinates and functions of the user's own on both sides. References: the IVP test set and own tight runs; the rigid crank has
a quadrature of the energy.

"""
COLUMNS = (
    "problem",
    "error",
    "ms here",
    "scheme, tolerance, evaluations",
    "IDA, ms",
    "form, evaluations, in functions",
)
COLUMNS += ("Exudyn, ms", "ratio to the better")
HEAD += f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|\n"


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=NAMES)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--longest", type=float, default=10.0, help="CPU seconds after which a run is given up")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()

    late, text = False, HEAD.format(repeat=given.repeat, longest=given.longest)
    for name in [given.only] if given.only else NAMES:
        made = of_problem(name, given)
        for goal in GOALS:
            found = {who: best(rows, goal, runs, given.repeat) for who, (rows, runs) in made.items()}
            row, slow = line(name, goal, found)
            print(row, flush=True)
            text, late = text + row + "\n", late or slow
    if given.write:
        PAGE.write_text(text)
    sys.exit(int(late))


if __name__ == "__main__":
    main()
