"""Slider crank with a connecting rod of finite elements: floating and reduced, in the plane and in space, beside the beam.

Run:  ./with-dolfinx python3 demos/slider_crank_fe.py [--fast] [--dim 3] [--study FILE] [--json FILE] [--picture FILE]
      ./with-dolfinx mpirun -n 2 python3 demos/slider_crank_fe.py --fast         (or: demos/slider_crank.py --rod elements)

              knee
             .o-._            crank 0.15 m, driven smoothly to 150 rad/s; rod 0.30 m, a gmsh mesh with two bores,
      main  /     `-._        held by revolute joints on the bores; slider on its guide
      bearing o        `-o=== wrist, slider

The rod's deflection from its chord is compared with the two sine modes of demos/crank_model.py for three heights of the section:
what beam theory leaves out falls with (height / length)^2. --study FILE: error against run time, and its figure.
"""

import crank_fe_model as fe
import crank_model as model

from fmbd_fenicsx import demo, study
from fmbd_fenicsx.faces.demo import Check, say

OWN = {"--dim": (2, 3), "--study": ""}


def compare(heights, dt):
    """Runs of beam and finite elements for each height, and checks of their difference."""
    pairs, checks = {}, []
    for height in heights:
        pairs[height] = fe.beam(height, dt), fe.drive(fe.rod(height, 0.5 * height), dt, snapshots=22)
        s, found = height / model.L2, fe.difference(*pairs[height][::-1])
        name = f"height {1e3 * height:g} mm: deflects more than the beam by"
        checks.append(Check(name, found, fe.expected_difference(s), 2 * s**3 + 2e-4))
    return pairs, checks


def work(dt, file):
    """Print and draw the error of the edges' mean position against run time: cells, modes and steps."""
    size = 16e-3
    fine, sheet = fe.rod(size, size / 8), fe.rod(size, size / 2)
    lines = {
        "floating: cells 16, 8, 4 mm": (lambda h: fe.drive(fe.rod(size, h), dt), [size, size / 2, size / 4]),
        "reduced: 0, 2, 6, 16 modes": (lambda n: fe.drive(fe.reduced(fine, int(n)), dt), [0, 2, 6, 16]),
        "floating: steps 0.8, 0.4, 0.2 ms": (lambda h: fe.drive(sheet, h), [4 * dt, 2 * dt, dt]),
    }
    runs = [study.Configuration(name, *line) for name, line in lines.items()]
    table = study.work_precision(runs, reference=fe.drive(fine, dt / 4), names=["side"], repeats=1)
    say(table)
    table.figure(file)


def main(args):
    """Differences for three heights, mesh refinement, reduced and spatial rods."""
    dt, heights = (fe.END / 320, (32e-3,)) if args.fast else (fe.END / 640, (8e-3, 16e-3, 32e-3))
    pairs, checks = compare(heights, dt)
    height = heights[-1]
    beam, full = pairs[height]
    *sizes, finest = (height / 2**k for k in range(3 if args.fast else 4))
    fine = fe.drive(fe.rod(height, finest), dt)
    cells = study.orders(
        lambda h: fe.drive(fe.rod(height, h), dt), sizes, reference=fine, names=["side"], parameter="cell, m"
    )
    say(cells)
    few = fe.drive(fe.reduced(fe.rod(height, 0.5 * height), 8), dt)
    checks += [
        Check("order of the edges' place in the cell size", cells.order("side"), 3.0, 1.0),
        Check("reduced by 8 modes: deflects more than the field by", fe.difference(few, full), 0.0, 1e-3),
        Check("slider on its guide, m", abs(full["slider"][:, 1]).max(), 0.0, 1e-12),
        Check("factorisations", full.counters["factorisations"], 1, 0),
    ]
    if args.dim == 3:
        solid = fe.drive(fe.reduced(fe.rod(height, 0.5 * height, 3), 16), dt)
        checks.append(Check("in space: deflects more than in the plane by", fe.difference(solid, full), 0.0, 2e-3))
    if args.study:
        work(dt, args.study)
    if args.picture:
        fe.picture(pairs, args.picture)
    demo.finish(checks, full, args)


if __name__ == "__main__":
    main(demo.arguments(__doc__, OWN))
