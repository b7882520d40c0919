"""CPU time to an error of 1e-6 m of the slider crank with a rod of finite elements: equal steps and those of a scheme's choice.

The middle of the rod's edges is known to 1e-6 m at 61 instants; the reference has two to four times the finest equal steps. Each
kind takes the coarsest of its settings that is enough; CPU times are the least of five, kinds in turn, set-up included.

Run:  cd tests; OMP_NUM_THREADS=1 ../with-dolfinx python3 benchmarks/crank_steps.py        (some minutes)
"""

from __future__ import annotations

import sys
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "demos"))

import crank_fe_model as fe
import crank_model as model

import fmbd_fenicsx as fmbd

WANTED = 1e-6  # m
EQUAL = (36, 72, 144, 288, 576, 1152, 2304, 4608, 9216)
CHOSEN = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
REST = 1.0  # s
TURNS = 5  # of all kinds, whose least CPU time counts


@dataclass(frozen=True)
class Case:
    """A crank: its scene, how long it runs (s), and the number of equal steps of its reference."""

    scene: Callable[[], fmbd.Scene]
    t_end: float
    fine: int


def crank(E: float = model.E, motion: Any = fe.run_up) -> fmbd.Scene:
    """The crank of the demo with a rod of another modulus, or driven in another way."""
    return fe.scene(fe.rod(0.03, 0.03, E=E), motion)


def late(t: float) -> tuple[float, float, float]:
    """At rest for a second, then the run-up of the demo."""
    return fe.run_up(max(t - REST, 0.0))


CASES = {
    "runs up in two turns": Case(crank, fe.END, 9216),
    "a rod of a tenth of the stiffness": Case(lambda: crank(0.1 * model.E), fe.END, 18432),
    "at rest for 1 s, then runs up": Case(lambda: crank(motion=late), REST + fe.END, 36864),
}


def solved(case: Case, **settings: Any) -> tuple[fmbd.Run, float]:
    """A run, and its CPU time (s)."""
    scene = case.scene()
    output = fmbd.Output(times=tuple(np.linspace(0.0, case.t_end, 61)), energy=False, progress=False)
    begun = clock.process_time()
    run = fmbd.solve(scene, t_end=case.t_end, output=output, **settings)
    return run, clock.process_time() - begun


@dataclass(frozen=True)
class Enough:
    """The coarsest settings of a kind that are enough: how to run with them, steps, and the error (m)."""

    settings: dict[str, Any]
    steps: int
    error: float


def cheapest(case: Case, exact: np.ndarray, settings: list[dict[str, Any]]) -> Enough | None:
    """Those of a kind, from coarse to fine; None where none is enough."""
    for chosen in settings:
        try:
            run, _ = solved(case, **chosen)
        except fmbd.errors.ConvergenceError:
            continue
        error = float(np.abs(run["side"] - exact).max())
        if error <= WANTED:
            return Enough(chosen, int(run.counters["steps"]), error)
    return None


def timed(case: Case, found: list[Enough | None]) -> list[str]:
    """A cell of the table for each kind; kinds take turns, so that all meet the same machine."""
    seconds = [[0.0 if one is None else solved(case, **one.settings)[1] for one in found] for _ in range(TURNS)]
    least = np.min(seconds, axis=0)
    return [
        "not reached" if one is None else f"{one.steps} steps, {one.error:.1e} m, {spent:.2f} s"
        for one, spent in zip(found, least, strict=True)
    ]


def main(names: list[str]) -> None:
    """Print the table of docs/accuracy_log.md."""
    solved(CASES["runs up in two turns"], dt=fe.END / 36)  # what is compiled and imported once belongs to no run
    kinds: tuple[Callable[[float], Any], ...] = (
        lambda x: fmbd.GeneralizedAlpha(rtol=x), lambda x: fmbd.Radau(2, rtol=x), lambda x: fmbd.Radau(3, rtol=x)
    )  # fmt: skip
    print("| crank | equal steps | generalized-alpha, own steps | Radau(2) | Radau(3) |\n|---|---|---|---|---|")
    for name in names or CASES:
        case = CASES[name]
        exact = solved(case, dt=case.t_end / case.fine)[0]["side"]
        found = [cheapest(case, exact, [{"dt": case.t_end / n} for n in EQUAL])]
        found += [cheapest(case, exact, [{"scheme": made(x)} for x in CHOSEN]) for made in kinds]
        print(f"| {name} | " + " | ".join(timed(case, found)) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
