"""Static cantilever: a soft sheet bends under a load at its end, in one call and without a time step.

Run:  ./with-dolfinx python3 demos/static_cantilever.py --picture cantilever.png
      ./with-dolfinx mpirun -n 2 python3 demos/static_cantilever.py --fast

   ||==================  F   sheet: length 1 m, height 0.1 m, St Venant-Kirchhoff, E = 1 MPa, nu = 0.3
   ||                  |     F = 22.8 N/m and 86 N/m: tips at about 0.09 and 0.3 of the length

The clamp holds the mean position and rotation of its surface. Forces are checked against the reaction, energy against the work of
the load along a path of equilibria, small loads against the linear answer of the same mesh.
"""

import time

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

LOADS = (22.8, 86.0)


def build(load, h=0.05, linear=False):
    """The sheet under ``load`` N/m at t = 1 s, in proportion to t; sensors "tip" and "clamp"."""
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=h)
    law = {"elastic": fmbd.materials.plane_strain(1e6, 0.3)}
    law = law if linear else {"energy": fmbd.materials.saint_venant_kirchhoff(1e6, 0.3)}
    sheet = fmbd.AbsoluteBody("sheet", mesh, density=1000.0, **law)
    scene = fmbd.Scene("cantilever")
    clamp = fmbd.fixed("clamp", fmbd.ground, sheet.surface("pin"))
    scene.add(sheet, clamp, fmbd.force("load", sheet.surface("tip"), lambda t: (0.0, -load * t)))
    scene.sensor("tip", fmbd.position(sheet.surface("tip")))
    scene.sensor("clamp", fmbd.reaction_force(clamp))
    return scene


def main():
    """Two loads, a path of equilibria, and the time that they take."""
    args = demo.arguments(__doc__)
    h, begun = 0.1 if args.fast else 0.05, time.process_time()
    found = [fmbd.equilibrium(build(load, h), t=1.0) for load in LOADS]
    seconds = time.process_time() - begun

    followed = fmbd.equilibrium(build(LOADS[1], h), path=fmbd.ArcLength(1.0, step=0.05))
    load, tip = LOADS[1] * np.array(followed.path.parameter), followed.path.series["tip"]
    work = np.trapezoid(load, -tip[:, 1])
    state = followed.state
    stored = followed.system.at(0.0, state.q, state.v).energies()["elastic"]
    small = [fmbd.equilibrium(build(1e-3, h, linear), t=1.0)["tip"][1] for linear in (False, True)]
    checks = [
        Check("tip y of the path (m)", tip[-1, 1], found[1]["tip"][1], 1e-9),
        Check("tip x of the path (m)", tip[-1, 0], found[1]["tip"][0], 1e-9),
        Check("reaction (N/m)", abs(found[1]["clamp"][1]), LOADS[1], 1e-6),
        Check.relative("energy against work (J/m)", stored, work, 5e-3),
        Check.relative("small load against linear (m)", small[0], small[1], 1e-5),
        Check.at_least("share of the length", -found[1]["tip"][1], 0.25),
        Check("CPU time of both (s)", seconds, 0.0, 4.0),
    ]
    if args.picture:
        with plot.figure(args.picture, title=args.title) as axes:
            axes.plot(-tip[:, 1], load, ".-", label="equilibria")
            axes.plot([0.0, -small[1] * LOADS[1] / 1e-3], [0.0, LOADS[1]], "--", label="linear")
            axes.set(xlabel="deflection of the tip (m)", ylabel="load (N/m)")
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
