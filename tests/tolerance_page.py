"""Writes docs/tolerance.md: calls with a tolerance, what they state, what is true, what they cost.

Run:  ./with-dolfinx python3 tests/tolerance_page.py [name ...]            all scenes, or some; some minutes
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from tolerance_more import MORE
from tolerance_scenes import CASES, TIMES, Kept, check

PAGE = Path(__file__).resolve().parents[1] / "docs/tolerance.md"
HEAD = """# Calls with a tolerance

`solve(scene, t_end=..., tol={sensor: tolerance})` for scenes of every kind, two tolerances each. Written by
`tests/tolerance_page.py`; `tests/test_tolerance.py` asserts that calls keep their tolerance. How it works:
[accuracy](accuracy.md).

- *stated*: the certificate's total, *true*: the largest distance to the reference at 81 instants, both in the sensor's unit.
  References are formulas, integrations by SciPy, or runs in clearly finer spaces with other schemes or far smaller steps.
- *cost*: CPU time of the whole call, estimates and all attempts, over that of one plain run with the steps and spaces at
  which it ended, each from a scene that is there; of short runs the median of five pairs made in turn. Marked
  with * where this plain run takes less than a tenth of a second: set-up then counts as much as steps.
"""
COLUMNS = """
| scene | tolerance | stated | true | kept | attempts | cost |
|---|---|---|---|---|---|---|
"""
OTHERS = """
Scenes with other data: units, materials, lengths, loads, schemes, shares of a sensor's range as tolerances, a second sensor
beside the one in the table (`tests/tolerance_more.py`).
"""


def row(found: Kept) -> str:
    """A line of the table."""
    kept = "yes" if found.ok else f"**no** {found.why}"
    few = "*" if found.plain < 0.1 else ""
    numbers = f"{found.tol:.1e} | {found.stated:.1e} | {found.true:.1e}"
    return f"| {found.name} | {numbers} | {kept} | {found.attempts} | {found.cost:.1f}{few} |"


def summary(rows: list[Kept]) -> str:
    """How many are kept, and what they cost."""
    kept, long = sum(r.ok for r in rows), [r.cost for r in rows if r.plain >= 0.1]
    costs = [r.cost for r in rows]
    end = f"{kept} of {len(rows)} calls keep their tolerance. Costs: {np.median(costs):.1f} plain runs in the middle, at most "
    end += f"{max(costs):.1f}; {sum(x > 3 for x in costs)} above 3"
    return f"{end}; of plain runs above a tenth of a second at most {max(long):.1f}.\n" if long else f"{end}.\n"


def main(names: list[str]) -> int:
    """The scenes named, or all of them on the page; how many tolerances were not kept."""
    warm = "mass on spring"  # what is imported once belongs to no call
    check(warm, CASES[warm].tolerances[0])

    page, failed = HEAD, 0
    for text, cases in (("", CASES), (OTHERS, MORE)):
        rows: list[Kept] = []
        for name in [n for n in names or cases if n in cases]:
            case = cases[name]
            exact = case.reference(case, np.linspace(0.0, case.t_end, TIMES))
            for tol in case.tolerances:
                rows.append(check(name, tol, exact, cases))
                print(row(rows[-1]), flush=True)
        if rows:
            page += f"{text}{COLUMNS}" + "\n".join(map(row, rows)) + f"\n\n{summary(rows)}"
            failed += sum(not r.ok for r in rows)
    print(page[len(HEAD) :])
    if not names:
        PAGE.write_text(page)
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
