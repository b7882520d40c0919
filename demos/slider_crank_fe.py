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

import crank_fe_figures as figures
import crank_fe_model as fe
import crank_model as model

from fmbd_fenicsx import demo, study
from fmbd_fenicsx.post.demo import Check

OWN = {"--dim": (2, 3), "--study": ""}


def main(args):
    """Differences for three heights, mesh refinement, reduced and spatial rods."""
    dt, heights = (fe.END / 320, (32e-3,)) if args.fast else (fe.END / 640, (8e-3, 16e-3, 32e-3))
    bodies, pairs, checks = {height: fe.rod(height, 0.5 * height) for height in heights}, {}, []
    for height, body in bodies.items():
        pairs[height] = beam, full = fe.beam(height, dt), fe.drive(body, dt, snapshots=16)
        s, name = height / model.L2, f"height {1e3 * height:g} mm: deflects more than the beam by"
        checks.append(Check(name, fe.difference(full, beam), fe.expected_difference(s), 2 * s**3 + 2e-4))

    *sizes, finest = (height / 2**k for k in range(3 if args.fast else 4))  # of the last, highest rod
    in_cells = lambda h: fe.drive(fe.rod(height, h), dt)
    cells = study.orders(in_cells, sizes, reference=in_cells(finest), names=["side"], parameter="cell, m")
    demo.say(cells)
    few = fe.drive(fe.reduced(body, 8), dt)
    checks += [
        Check("order of the edges' place in the cell size", cells.order("side"), 3.0, 1.0),
        Check("reduced by 8 modes: deflects more than the field by", fe.difference(few, full), 0.0, 1e-3),
        Check("slider on its guide, m", abs(full["slider"][:, 1]).max(), 0.0, 1e-12),
        Check("factorisations", full.counters["factorisations"], 1),
    ]
    if args.dim == 3:
        solid = fe.drive(fe.reduced(fe.rod(height, 0.5 * height, 3), 16), dt)
        checks.append(Check("in space: deflects more than in the plane by", fe.difference(solid, full), 0.0, 2e-3))
    if args.study:
        figures.work(dt, args.study)
    if args.picture:
        figures.picture(pairs, bodies[heights[0]], args.picture)
    demo.finish(checks, full, args)


if __name__ == "__main__":
    main(demo.arguments(__doc__, OWN))
