"""The bouncing bar under several schemes: error of the contact forces, energy left.

Run:  ./with-dolfinx python3 docs/scripts/bouncing_schemes.py          (--cells 80; --periods 10)

Problem and exact force as in ``demos/bouncing_bar.py``; dt = h / (2 c).
"""

import argparse
import time

import numpy as np

import fmbd_fenicsx as fmbd

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--cells", type=int, default=40)
parser.add_argument("--periods", type=int, default=1)
args = parser.parse_args()
n, L, E, g, h0, c, period = args.cells, 10.0, 900.0, 10.0, 5.0, 30.0, 16.0 / 3.0
dt = period / (2 * np.ceil(period * c * n / L))
SCHEMES = [
    ("midpoint", fmbd.ContactMidpoint(), 0.0),
    ("midpoint, theta = 0.52", fmbd.ContactMidpoint(theta=0.52), 0.0),
    *((f"alpha({r:g})", fmbd.ContactAlpha(r), 0.0) for r in (0.9, 0.8, 0.6, 0.4, 0.2)),
    ("midpoint, damping 0.03 h/c K", fmbd.ContactMidpoint(), 0.03 * L / n / c),
]

for label, scheme, damping in SCHEMES:
    start = time.process_time()
    mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, L), counts=(1, n), origin=(0.0, h0), quads=True)
    law = fmbd.materials.linear_elastic(E, 0.0)
    bar = fmbd.AbsoluteBody("bar", mesh, degree=1, density=1.0, elastic=law, stiffness_damping=damping)
    ground = fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, 0.0), (0.0, 1.0)))
    floor = fmbd.contact("floor", bar.surface("bottom"), ground)
    scene = fmbd.Scene("bouncing bar", gravity=(0.0, -g))
    scene.add(bar, floor)
    scene.sensor("force", fmbd.contact_force(floor))
    run = fmbd.solve(scene, t_end=args.periods * period, dt=dt, scheme=scheme)
    t = run.times[1:] - (0.5 * dt if isinstance(scheme, fmbd.ContactMidpoint) else 0.0)
    force = run["force"][1:, 1]
    exact = 300 + c * g * np.where(t < 3, t - 1, 13 / 3 - t)
    errors = []
    for begin, end in ((1.1, 1.6), (3.75, 4.25)):
        inside = (t > begin) & (t < end)
        errors.append(np.sqrt(np.mean((force[inside] / exact[inside] - 1) ** 2)))
    energy = sum(run.energy.values())
    fmbd.say(
        f"{label}: RMS of the force {errors[0]:.2%} (first contact), {errors[1]:.2%} (second); energy left "
        f"{energy[-1] / energy[0]:.4f}, largest gain {energy.max() / energy[0] - 1:.0e}; CPU {time.process_time() - start:.1f} s"
    )
