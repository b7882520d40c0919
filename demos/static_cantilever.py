"""Static cantilever: a soft sheet bends under a load at its end, in one call and without a time step.

Run:  ./with-dolfinx python3 demos/static_cantilever.py --picture cantilever.png
      ./with-dolfinx mpirun -n 2 python3 demos/static_cantilever.py --fast

   ||==================  p   sheet: length 1 m, height 0.1 m, St Venant-Kirchhoff, E = 1 MPa, nu = 0.3
   ||                  |     p = 300 Pa and 900 Pa on its end: tips at 0.11 and 0.30 of the length

Both are compared with Newton's method in DOLFINx alone on the same mesh, energy with the work of the load along a path of
equilibria, small loads with the linear answer.
"""

import time

import numpy as np
from static_references import plain_newton

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

PRESSURES, HEIGHT = (300.0, 900.0), 0.1
ENERGY = fmbd.materials.saint_venant_kirchhoff(1e6, 0.3)


def sheet(cells):
    """Its mesh, ``cells`` through its length."""
    counts = (cells, max(cells // 10, 1))
    return fmbd.read_gmsh("meshes/block.py", size=(1.0, HEIGHT), origin=(0.0, -HEIGHT / 2), counts=counts)


def build(mesh, pressure, linear=False):
    """The sheet under ``pressure`` Pa at t = 1 s, in proportion to t; sensor "tip"."""
    law = {"elastic": fmbd.materials.plane_strain(1e6, 0.3)} if linear else {"energy": ENERGY}
    load = fmbd.traction("right", (0.0, pressure), time=lambda t: t)
    body = fmbd.AbsoluteBody("sheet", mesh, density=1000.0, loads=[load], **law)
    scene = fmbd.Scene("cantilever")
    space = fmbd.Continuous(2, fmbd.Ends.KEPT)
    scene.add(body, fmbd.tie_surface("clamp", body.surface("left"), fmbd.ground, space=space))
    scene.sensor("tip", fmbd.position(body.surface("right")))
    return scene


def beside_dolfinx(mesh, pressure, found):
    """Both displacements of the tip against DOLFINx alone, to 1e-6 of the length."""
    exact = plain_newton(mesh, ENERGY, pressure)
    moved = found["tip"] - (1.0, 0.0)
    return [Check(f"tip {c} at {pressure:g} Pa (m)", a, b, 1e-6) for c, a, b in zip("xy", moved, exact, strict=True)]


def main():
    """Two loads, the same without this package, and a path of equilibria."""
    args = demo.arguments(__doc__)
    mesh, begun = sheet(10 if args.fast else 20), time.process_time()
    found = [fmbd.equilibrium(build(mesh, p), t=1.0) for p in PRESSURES]
    demo.say(f"CPU time of both: {time.process_time() - begun:.2f} s")

    followed = fmbd.equilibrium(build(mesh, PRESSURES[1]), path=fmbd.ArcLength(1.0, step=0.05))
    load, tip = HEIGHT * PRESSURES[1] * np.array(followed.path.parameter), followed.path.series["tip"]
    work = np.trapezoid(load, tip[:, 1])
    state = followed.state
    stored = followed.system.at(0.0, state.q, state.v).energies()["elastic"]
    small = [fmbd.equilibrium(build(mesh, 1e-2, linear), t=1.0)["tip"][1] for linear in (False, True)]
    checks = [
        *(check for p, f in zip(PRESSURES, found, strict=True) for check in beside_dolfinx(mesh, p, f)),
        Check("tip y of the path (m)", tip[-1, 1], found[1]["tip"][1], 1e-9),
        Check("tip x of the path (m)", tip[-1, 0], found[1]["tip"][0], 1e-9),
        Check.relative("energy against work (J/m)", stored, work, 5e-3),
        Check.relative("small load against linear (m)", small[0], small[1], 1e-5),
    ]
    if args.picture:
        with plot.figure(args.picture, title=args.title) as axes:
            axes.plot(tip[:, 1], load, ".-", label="equilibria")
            axes.plot([0.0, small[1] * PRESSURES[1] / 1e-2], [0.0, load[-1]], "--", label="linear")
            axes.set(xlabel="deflection of the tip (m)", ylabel="load (N/m)")
    demo.finish(checks, None, args)


if __name__ == "__main__":
    main()
