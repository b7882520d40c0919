"""An elastic bar hits a rigid wall and rebounds.

Run:  ./with-dolfinx python3 demos/bar_impact.py          (also: ./with-dolfinx mpirun -n 2 python3 demos/bar_impact.py)

    |wall  <- v0  [=========== L ===========]      exact: force rho c v0 A for 0 < t < 2 L / c,
                                                   then rebound with v0

A shock wave runs up the bar and back as a release wave. Contact is a multiplier on the trace, without penalty; the
nodes on the wall carry no inertia, so the force neither oscillates nor makes energy (docs/contact.md).
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--cells": 0})
n = args.cells or (50 if args.fast else 100)
L, E, rho, v0, height = 1.0, 1.0, 1.0, 0.1, 0.1
c = np.sqrt(E / rho)

mesh = fmbd.read_gmsh("meshes/block.py", size=(L, height), counts=(n, 1), quads=True)
elastic = fmbd.materials.linear_elastic(E, 0.0)
bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=rho, elastic=elastic, velocity=(-v0, 0.0))
wall = fmbd.contact("wall", bar.surface("left"), fmbd.Obstacle("wall", fmbd.HalfSpace((0.0, 0.0), (1.0, 0.0))))
scene = fmbd.Scene("bar impact")
scene.add(bar, wall)
scene.sensor("contact force", fmbd.contact_force(wall))
scene.sensor("gap", fmbd.contact_gap(wall))

dt = 0.5 * L / n / c
run = fmbd.solve(scene, t_end=3.0 * L / c, dt=dt, output=demo.snapshots(args))

t = run.times[1:] - dt / 2  # forces act in the middle of a step
p = run["contact force"][1:, 0] / (rho * c * v0 * height)
plateau, energy = p[(t > 0.1) & (t < 1.9)], run.total_energy
checks = [
    Check("plateau RMS of p / (rho c v0) - 1", np.sqrt(np.mean((plateau - 1) ** 2)), 0.0, 0.05),
    Check("openings in (0.1, 1.9)", (plateau <= 0).sum(), 0.0),
    Check("rebound speed over v0", run.momenta()[0][0] / run.system.mass / v0, 1.0, 0.02),
    Check("release time, s", dt * (np.flatnonzero(p > 1e-5)[-1] + 1), 2.0 * L / c, 2 * dt),
    Check("impulse over 2 m v0", p.sum() * dt * c / (2 * L), 1.0, 0.01),
    Check("largest energy gain, relative", energy.max() / energy[0] - 1, 0.0, 1e-8),
    Check("final energy change, relative", energy[-1] / energy[0] - 1, 0.0, 1e-8),
]
if args.picture:
    force = lambda t: rho * c * v0 * height * (t < 2 * L / c)
    known = {"contact force x": force, "gap": lambda t: max(0.0, v0 * (t - 2 * L / c))}
    run.plot("contact force x", "gap", file=args.picture, reference=known)
demo.film(run, args, ["contact force x", "gap"], view=fmbd.View(contact=True))
demo.finish(checks, run, args)
