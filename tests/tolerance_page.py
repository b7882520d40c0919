"""Writes docs/tolerance.md: calls with a tolerance, what they state, what is true, what they cost.

Run:  ./with-dolfinx python3 tests/tolerance_page.py [name ...]            all scenes, or some; some minutes
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from tolerance_scenes import CASES, TIMES, Kept, check

PAGE = Path(__file__).resolve().parents[1] / "docs/tolerance.md"
HEAD = """# Calls with a tolerance

`solve(scene, t_end=..., tol={sensor: tolerance})` for scenes of every kind, two tolerances each. Written by
`tests/tolerance_page.py`; `tests/test_tolerance.py` asserts that each call keeps its tolerance. How it works:
[accuracy](accuracy.md).

- *stated*: the certificate's total, *true*: the largest distance to the reference at 81 instants, both in the sensor's unit.
  References are formulas, integrations by SciPy, or runs in clearly finer spaces with other schemes or far smaller steps.
- *cost*: CPU time of the whole call, estimates and all attempts, over that of one plain run with the steps and spaces at
  which it ended, each from a scene that is there. Marked with * where this plain run takes less than a tenth of a second:
  set-up then counts as much as steps.

| scene | tolerance | stated | true | kept | attempts | cost |
|---|---|---|---|---|---|---|
"""


def row(found: Kept) -> str:
    """A line of the table."""
    kept = "yes" if found.ok else f"**no** {found.why}"
    few = "*" if found.plain < 0.1 else ""
    numbers = f"{found.tol:.0e} | {found.stated:.1e} | {found.true:.1e}"
    return f"| {found.name} | {numbers} | {kept} | {found.attempts} | {found.cost:.1f}{few} |"


def main(names: list[str]) -> int:
    """The scenes named, or all of them on the page; how many tolerances were not kept."""
    warm = "mass on spring"  # what is imported once belongs to no call
    check(warm, CASES[warm].tolerances[0])

    rows: list[Kept] = []
    for name in names or CASES:
        case = CASES[name]
        exact = case.reference(case, np.linspace(0.0, case.t_end, TIMES))
        for tol in case.tolerances:
            rows.append(check(name, tol, exact))
            print(row(rows[-1]), flush=True)

    kept, long = sum(r.ok for r in rows), [r.cost for r in rows if r.plain >= 0.1]
    end = f"\n{kept} of {len(rows)} calls keep their tolerance. "
    end += f"Costs: {np.median([r.cost for r in rows]):.1f} plain runs in the middle, at most {max(r.cost for r in rows):.1f}"
    end += f"; of plain runs above a tenth of a second at most {max(long):.1f}.\n" if long else ".\n"
    print(end)
    if not names:
        PAGE.write_text(HEAD + "\n".join(map(row, rows)) + "\n" + end)
    return len(rows) - kept


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
