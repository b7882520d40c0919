"""Bricard's mechanism: six hinges and five rods that Gruebler's count calls rigid (IFToMM A04).

Run:  ./with-dolfinx python3 demos/bricard.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

Rods along the edges of a unit cube, 1 m, 1 kg, section 0.1 m x 0.1 m; axes y, z, x, y, z, x; gravity along -y; from rest.
30 velocities and 30 constraint rows of rank 29: one degree of freedom, one redundant row, multipliers of minimum norm.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
t_end, dt = (1.0, 4e-3) if args.fast else (10.0, 2e-3)

END = {  # P3 by Radau with three stages, tolerances ten times apart agree to 1e-9
    1.0: (0.510501461187, -1.649167599395, 0.140123114553),
    10.0: (0.99999996381, -1.00026901271, 0.99973095111),
}
corners = np.array([(0, 0, 0), (1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)], dtype=float)
axes = np.eye(3)[[1, 2, 0, 1, 2, 0]]
along, across = 0.1**2 / 6, (1 + 0.1**2) / 12
scene = fmbd.Scene("Bricard", gravity=(0, -9.81, 0))
rods = []
for i, (p, q) in enumerate(zip(corners[:-1], corners[1:], strict=True)):
    direction = np.abs(q - p)
    inertia, shape = np.where(direction > 0.5, along, across), fmbd.contacts.Box(np.where(direction > 0.5, 1.0, 0.1))
    rods.append(fmbd.RigidBody(f"rod {i + 1}", 1.0, inertia, position=(p + q) / 2, shape=shape))
scene.add(*rods)
for i, (a, b) in enumerate(zip([fmbd.ground, *rods], [*rods, fmbd.ground], strict=True)):
    scene.add(fmbd.revolute(f"P{i}", a, b, center=corners[i], axis=axes[i]))
scene.sensor("P3", fmbd.position(rods[2], point=corners[3]))

mobility, scheme = scene.check(), fmbd.GeneralizedAlpha(0.9)
runs = [fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, output=snapshots(args)) for h in (2 * dt, dt)]
energy = [np.abs(r.total_energy - r.total_energy[0]).max() for r in runs]
run = runs[-1]
x = (4 * run["P3"][-1] - runs[0]["P3"][-1]) / 3
checks = [
    Check("constraint rows", mobility.rows, 30, 0),
    Check("rank", mobility.rank, 29, 0),
    Check("degrees of freedom", mobility.freedom, 1, 0),
    Check("order of the energy error", float(np.log2(energy[0] / energy[1])), 2.0, 0.25),
    Check("energy error, J", energy[1], 0.0, 1e-3),
    Check("distance of P3 from the reference, m", np.linalg.norm(run["P3"][-1] - END[t_end]), 0.0, 1e-3),
    Check("the same, extrapolated, m", np.linalg.norm(x - END[t_end]), 0.0, 1e-6),
    Check("constraint, m", run.drift[0], 0.0, 1e-11),
]
show(run, args, ["P3"], reference={"P3": (t_end, END[t_end])}, view=fmbd.View(instants=2))
finish(checks, run, args)
