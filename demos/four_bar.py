"""Double four-bar mechanism through its singular positions (IFToMM A02, N = 2).

Run:  ./with-dolfinx python3 demos/four_bar.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

    B0 --- B1 --- B2      five uniform links, 1 m and 1 kg each; B0 starts with 1 m/s to the right. Lying flat the mechanism
    |      |      |       has three degrees of freedom instead of one; it passes there with its momentum.
    A0     A1     A2
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
END = {2.0: 0.057815795767660286, 10.0: 0.328458111534}  # x of B0, from one degree of freedom, to 1e-11
t_end, dt = (2.0, 4e-3) if args.fast else (10.0, 2e-3)

scene = fmbd.Scene("double four-bar", gravity=(0, -9.81))
J = 1 / 12
legs = [fmbd.RigidBody(f"leg {i}", 1.0, J, (i, 0.5), np.pi / 2, (0.5, 0.0), -1.0) for i in range(3)]
bars = [fmbd.RigidBody(f"bar {i}", 1.0, J, (i + 0.5, 1.0), 0.0, (1.0, 0.0)) for i in range(2)]
scene.add(*legs, *bars)
for i, leg in enumerate(legs):
    scene.add(fmbd.revolute(f"A{i}", fmbd.ground, leg, center=(i, 0)))
for i, bar in enumerate(bars):
    scene.add(fmbd.revolute(f"B{i}", legs[i], bar, center=(i, 1)))
    scene.add(fmbd.revolute(f"B{i}'", bar, legs[i + 1], center=(i + 1, 1)))
scene.sensor("B0", fmbd.position(legs[0], point=(0, 1)))

mobility, scheme = scene.check(), fmbd.GeneralizedAlpha(0.9)
runs = [fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, output=snapshots(args)) for h in (2 * dt, dt)]
energy = [np.abs(r.total_energy - r.total_energy[0]).max() for r in runs]
run, x = runs[-1], [r["B0"][-1] for r in runs]
extrapolated = (4 * x[1] - x[0]) / 3
checks = [
    Check("degrees of freedom", mobility.freedom, 1, 0),
    Check("order of the energy error", float(np.log2(energy[0] / energy[1])), 2.0, 0.25),
    Check("energy error, J", energy[1], 0.0, 0.02),
    Check("x of B0 at the end, m", x[1][0], END[t_end], 2e-3),
    Check("the same, extrapolated, m", extrapolated[0], END[t_end], 1e-4),
    Check("constraint, m", run.drift[0], 0.0, 1e-11),
]
show(run, args, ["B0 x", "B0 y"], reference={"B0 x": (t_end, END[t_end])})
finish(checks, run, args)
