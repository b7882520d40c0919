"""What a run with ten times the tolerance knows of the error of a run with error control: their distance over the true error.

Run:  cd tests; ../with-dolfinx python3 benchmarks/looser_runs.py        (two minutes; the last line is in docs/accuracy_log.md)
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tolerance_scenes import CASES, TIMES

import fmbd_fenicsx as fmbd

SCENES = ("pendulum", "mass on spring", "geared chain", "top", "elastic pendulum", "reduced pendulum")
RTOLS = (1e-3, 1e-4, 1e-5, 1e-6)
SCHEMES: dict[str, Callable[[float], Any]] = {
    "generalized-alpha": lambda r: fmbd.GeneralizedAlpha(rtol=r),
    "Radau(2)": lambda r: fmbd.Radau(2, rtol=r),
    "Radau(3)": lambda r: fmbd.Radau(3, rtol=r),
    "BDF": lambda r: fmbd.BDF(rtol=r),
}


def main() -> None:
    """A line for each scene and scheme: how many times the true error a run differs from one with ten times the tolerance."""
    every = []
    for name in SCENES:
        case = CASES[name]
        output = fmbd.Output(times=tuple(np.linspace(0.0, case.t_end, TIMES)), energy=False, progress=False)

        def run(scheme: Any, case: Any = case, output: Any = output) -> Any:
            return fmbd.solve(case.scene(), t_end=case.t_end, scheme=scheme, output=output)[case.sensor]

        exact = run(fmbd.Radau(3, rtol=1e-9))
        for kind, scheme in SCHEMES.items():
            runs = [run(scheme(r)) for r in RTOLS]
            times = [np.abs(a - b).max() / np.abs(b - exact).max() for a, b in zip(runs[:-1], runs[1:], strict=True)]
            print(f"{name:<18} {kind:<18}", *(f"{x:6.1f}" for x in times), flush=True)
            every += times
    print(f"{len(every)} pairs: {min(every):.1f} to {max(every):.1f} times the true error")


if __name__ == "__main__":
    main()
