"""The observatory: error against CPU time of all schemes on problems with exact or independent references.

Run:  PYTHONPATH=.:demos:tests:tests/benchmarks ./with-dolfinx python3 tests/benchmarks/observatory.py --write
      (--fast: two values each; --write: docs/observatory.md and its figure;
      --only NAME ...: these problems, all other rows as docs/observatory.md has them;
      --json FILE: keep the runs there after each problem, and do not make again those that it holds;
      --schemes NAME ...: these schemes, all other rows as docs/observatory.md has them)

Every run that fails is a row. Schemes with equal steps run with h, h / 4, h / 16, those with error control with three tolerances;
finer ones are left out where the last took longer than BUDGET seconds of CPU time, and no run takes longer than LONGEST: all of
them end within an hour. Neighbours: IDA needs scikit-sundae; Exudyn an interpreter that has it, EXUDYN_PYTHON or this one.
"""

from __future__ import annotations

import argparse
import json
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from observatory_page import figure, page, rows_of
from observatory_peers import FAILURES, PEERS_CONTROLLED, PEERS_EQUAL, NotForItError
from observatory_problem import Problem
from observatory_problems import PROBLEMS

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError

ROOT = Path(__file__).resolve().parents[2]
BUDGET, FAST_BUDGET = 3.0, 0.5  # s of CPU time of a run, above which no finer one is made
LONGEST = 30.0  # s of CPU time after which a run is given up
TOLERANCES = (1e-3, 1e-5, 1e-7)
FINER = (1, 4, 16)
QUIET = fmbd.Output(every=10**9, energy=False, progress=False)

CONTROLLED: dict[str, Callable[[float], Any]] = {
    "Radau(3), index 3": lambda r: fmbd.Radau(3, fmbd.Index3(), r),
    "Radau(3), GGL": lambda r: fmbd.Radau(3, fmbd.GGL(), r),
    "Radau(5), GGL": lambda r: fmbd.Radau(5, fmbd.GGL(), r),
    "BDF, GGL": lambda r: fmbd.BDF(5, fmbd.GGL(), r),
    "half-explicit": lambda r: fmbd.HalfExplicit(r),
    "explicit Runge-Kutta": lambda r: fmbd.ExplicitRungeKutta(r),
    "generalized-alpha, controlled": lambda r: fmbd.GeneralizedAlpha(rtol=r),
}
EQUAL: dict[str, Callable[[], Any]] = {
    "generalized-alpha": lambda: fmbd.GeneralizedAlpha(0.8),
    "generalized-alpha, GGL": lambda: fmbd.GeneralizedAlpha(0.8, form=fmbd.GGL()),
    "energy-momentum": lambda: fmbd.EnergyMomentum(),
    "RATTLE": lambda: fmbd.Rattle(),
}
IMPACTS: dict[str, Callable[[], Any]] = {
    "contact midpoint": lambda: fmbd.ContactMidpoint(),
    "contact alpha": lambda: fmbd.ContactAlpha(),
    "Moreau": lambda: fmbd.Moreau(),
}


@dataclass(frozen=True)
class Point:
    """One run: its tolerance or number of steps, error at the end over the size of the reference, CPU seconds; or its failure.

    ``steps``: of neighbours the number of evaluations. ``refused``: the scheme does not take the problem.
    """

    problem: str
    scheme: str
    value: float
    error: float
    seconds: float
    steps: float
    failure: str = ""
    refused: bool = False


class TooLongError(Exception):
    """A run took more than its CPU time."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raises TooLongError after so much CPU time of this process."""

    def stop(*_: Any) -> None:
        raise TooLongError(f"given up after {seconds:g} s of CPU time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def one(name: str, scheme: str, value: float) -> Point:
    """A run of this package with a tolerance, or with so many equal steps."""
    problem = PROBLEMS[name]
    made = CONTROLLED[scheme](value) if scheme in CONTROLLED else {**EQUAL, **IMPACTS}[scheme]()
    dt = None if scheme in CONTROLLED else problem.t_end / value
    begun = time.process_time()
    try:
        with at_most(LONGEST):
            run = fmbd.solve(problem.scene(), t_end=problem.t_end, dt=dt, scheme=made, output=QUIET)
    except (FmbdError, TooLongError) as error:
        spent, refused = time.process_time() - begun, isinstance(error, fmbd.errors.InputError)
        return Point(name, scheme, value, np.nan, spent, 0, str(error).splitlines()[0], refused)
    spent = time.process_time() - begun
    return Point(name, scheme, value, _error(problem, run[problem.sensor][-1]), spent, run.counters["steps"])


def peer(name: str, scheme: str, value: float) -> Point | None:
    """A run of a neighbour; None where it does not take the problem."""
    problem, run = PROBLEMS[name], {**PEERS_CONTROLLED, **PEERS_EQUAL}[scheme]
    begun = time.process_time()
    try:
        with at_most(LONGEST):
            end, steps, *own = run(name, problem, value)
    except NotForItError:
        return None
    except (*FAILURES, TooLongError) as error:
        return Point(name, scheme, value, np.nan, time.process_time() - begun, 0, str(error).splitlines()[0])
    spent = own[0] if own else time.process_time() - begun
    return Point(name, scheme, value, _error(problem, end), spent, steps)


def _error(problem: Problem, found: Any) -> float:
    """The largest error of the components that have a reference, over the largest of these."""
    exact = np.asarray(problem.reference(), dtype=float)
    off = np.abs(np.asarray(found, dtype=float)[: len(exact)] - exact)
    return float(np.nanmax(off) / np.nanmax(np.abs(exact)))


def _runs(name: str) -> list[tuple[str, tuple[float, ...], Callable[[str, str, float], Point | None]]]:
    """Schemes and neighbours for a problem, and their values."""
    problem = PROBLEMS[name]
    steps = tuple(float(problem.steps * k) for k in FINER)
    if problem.scene().contacts:
        return [(scheme, steps, one) for scheme in IMPACTS]
    ours = [(s, TOLERANCES, one) for s in CONTROLLED] + [(s, steps, one) for s in EQUAL]
    others = [(s, TOLERANCES, peer) for s in PEERS_CONTROLLED] + [(s, steps, peer) for s in PEERS_EQUAL]
    return [*ours, *others]


def observe(name: str, *, fast: bool, schemes: list[str] | None = None) -> list[Point]:
    """All runs of a problem, or those of some schemes."""
    points: list[Point] = []
    limit = FAST_BUDGET if fast else BUDGET
    for scheme, values, run in (x for x in _runs(name) if schemes is None or x[0] in schemes):
        for value in values[:2] if fast else values:
            found = run(name, scheme, value)
            if found is None:
                break
            points.append(found)
            print(found, flush=True)
            if found.seconds > limit or found.failure:
                break
    return points


def observed(
    names: list[str], *, fast: bool, file: Path | None, schemes: list[str] | None = None
) -> tuple[list[Point], float]:
    """All runs of some problems, or those of some schemes, and their CPU seconds; those that a file holds are taken from it, the
    others go there.
    """
    kept: dict[str, Any] = json.loads(file.read_text()) if file is not None and file.exists() else {}
    keys = {name: name if schemes is None else ", ".join((name, *sorted(schemes))) for name in names}
    for name, key in keys.items():
        if key in kept:
            continue
        begun = time.process_time()
        points = observe(name, fast=fast, schemes=schemes)
        kept[key] = {"points": [asdict(p) for p in points], "seconds": time.process_time() - begun}
        if file is not None:
            file.write_text(json.dumps(kept))
    found = [kept[key] for key in keys.values()]
    return [Point(**p) for x in found for p in x["points"]], sum(x["seconds"] for x in found)


def beside(points: list[Point], problems: list[str], schemes: list[str] | None) -> list[Point]:
    """Runs of some problems, with all schemes or with some, among those of the others that the page holds, to its digits, in the
    order of problems and schemes.
    """
    order = {(n, scheme): values for n in PROBLEMS for scheme, values, _ in _runs(n)}
    kept = []
    for problem, scheme, cells, failure in rows_of((ROOT / "docs/observatory.md").read_text()):
        made_again = problem in problems and (schemes is None or scheme in schemes)
        if made_again or (problem, scheme) not in order:
            continue
        for value, cell in zip(order[problem, scheme], cells, strict=False):
            told = failure.get(f"{value:g}", "")
            numbers = (np.nan, 0.0, 0.0) if cell in ("failed", "refused") else map(float, cell.split(" / "))
            kept.append(Point(problem, scheme, value, *numbers, told, cell == "refused"))
    places = {key: i for i, key in enumerate(order)}
    return sorted([*kept, *points], key=lambda p: places[p.problem, p.scheme])


def main() -> None:
    """Run, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--only", nargs="+", choices=list(PROBLEMS))
    parser.add_argument("--json", type=Path, help="keep the runs in this file, and take from it those that it holds")
    parser.add_argument("--schemes", nargs="+", choices=[*CONTROLLED, *EQUAL, *IMPACTS])
    args = parser.parse_args()

    fast = bool(args.fast)
    points, spent = observed(args.only or list(PROBLEMS), fast=fast, file=args.json, schemes=args.schemes)
    setting = f"with{' `--fast`: two' if fast else ' three'} values for each scheme"
    if args.schemes or args.only:
        points = beside(points, args.only or list(PROBLEMS), args.schemes)
        listed = ", ".join(f"**{name}**" for name in [*(args.schemes or []), *(args.only or [])])
        setting += f".\nRows of {listed} were made last, beside those of the page before: those come from earlier code"
    text = page(points, setting, (FAST_BUDGET if fast else BUDGET, LONGEST, spent))
    print(text)
    if args.write:
        (ROOT / "docs/observatory.md").write_text(text)
        figure(points, ROOT / "docs/pictures/observatory.png")


if __name__ == "__main__":
    main()
