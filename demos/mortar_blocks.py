"""Two blocks with meshes that do not match, glued by field multipliers on the true intersections of their facets.

Run:  ./with-dolfinx python3 demos/mortar_blocks.py          (--fast: three meshes; --picture FILE: errors against h)

      +---------+
      |  upper  |   7 n cells a side      Patch test: constant stress passes to roundoff.
      +---------+   glue, multipliers     Smooth solution: orders 2 / 1 (P1) and 3 / 2 (P2) of u in L2 / H1, and the order of
      |  lower  |   5 n cells a side      the interface traction in H^-1/2 and in the h-weighted L2 norm.
      +---------+   the rest of the boundary is held weakly; cross-points by merged ends (blocks_model.py)
"""

import blocks_model as model
import numpy as np
from blocks_model import BEND, PATCH

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot, study
from fmbd_fenicsx.fem.traces.stability import DualNorm
from fmbd_fenicsx.post.demo import Check

NAMES = ("u L2", "u H1", "traction H^-1/2", "traction L2")


def errors(degree, n, solution):
    """Errors of u (L2, H1) and of the traction (H^-1/2, h-weighted L2) on meshes of 7 n and 5 n cells."""
    meshes = [fmbd.read_gmsh("meshes/block.py", cells=c * n, origin=(0.0, y)) for c, y in ((7, 1.0), (5, 0.0))]
    found = model.solve(degree, meshes, solution)
    (mu, lam), exact = model.glue(found), lambda x: model.interface_traction(solution, x)
    traction = DualNorm(mu, times=2).error(lam, exact), np.sqrt(1 / (7 * n)) * mu.error(lam, exact)
    return dict(zip(NAMES, (*model.errors(found, solution), *traction), strict=True))


args = demo.arguments(__doc__)
checks, tables, counts = [], {}, (1, 2, 4) if args.fast else (1, 2, 4, 8)
for degree in (1, 2):
    patch = max(errors(degree, 1, PATCH).values())
    checks.append(Check(f"P{degree} patch test, u and traction", patch, 0.0, 1e-12))
    found = [errors(degree, n, BEND) for n in counts]
    series = {name: np.array([e[name] for e in found]) for name in NAMES}
    tables[degree] = table = study.OrderTable(f"P{degree}: h (m)", 1 / (7 * np.array(counts)), series)
    demo.say(table)
    for name, least in zip(NAMES, (degree + 1, degree, degree, degree), strict=True):
        checks.append(Check.at_least(f"P{degree} order of {name}", table.pairwise(name)[-1], least - 0.1))
if args.picture:
    with plot.figure(args.picture, 1, 2, title=args.title) as panels:
        for axes, (degree, table) in zip(panels, tables.items(), strict=True):
            for name, error in table.errors.items():
                axes.loglog(table.values, error, "o-", label=f"{name}: order {table.pairwise(name)[-1]:.2f}")
            axes.set(xlabel="cell size of the upper block (m)", ylabel=f"error, P{degree}")
demo.finish(checks, None, args)
