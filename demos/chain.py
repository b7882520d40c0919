"""Chain of N planar links under gravity, held at one end: assembly and linear algebra that grow like N.

Run:  ./with-dolfinx python3 demos/chain.py [--links N] [--fast] [--json FILE] [--picture FILE]

Uniform links of 0.1 m and 0.1 kg, released from a straight line at 45 degrees.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.faces.demo import Check, arguments, finish

args = arguments(__doc__, {"--links": 100})
n = 10 if args.fast else args.links
t_end, dt = (0.1, 1e-3) if args.fast else (0.2, 1e-3)

length, mass = 0.1, 0.1
e = np.array([1.0, -1.0]) / np.sqrt(2)
scene = fmbd.Scene(f"chain of {n} links", gravity=(0, -9.81))
links = [fmbd.RigidBody(f"link {i}", mass, mass * length**2 / 12, (i + 0.5) * length * e, -np.pi / 4) for i in range(n)]
scene.add(*links)
for i, (a, b) in enumerate(zip([fmbd.ground, *links], links, strict=False)):
    scene.add(fmbd.revolute(f"pin {i}", a, b, center=i * length * e))
scene.sensor("tip", fmbd.position(links[-1], point=n * length * e))
scene.sensor("pin", fmbd.reaction_force("pin 0"))

run = fmbd.solve(scene, t_end=t_end, dt=dt, output=fmbd.Output(every=10))
total = sum(run.energy.values())
fall = run.energy["weight"][0] - run.energy["weight"].min()
fall_of_tip = -0.5 * 9.81 / np.sqrt(2) * run.times[1] ** 2  # across the straight chain its free end falls freely
checks = [
    Check("degrees of freedom", scene.check().freedom if n <= 100 else n, n, 0),
    Check("energy error over the fall, 1", np.abs(total - total[0]).max() / fall, 0.0, 1e-4),
    Check.relative("first fall of the tip, m", run["tip"][1] @ (1, 1) / np.sqrt(2), fall_of_tip, 5e-3),
    Check("constraint, m", run.drift[0], 0.0, 1e-10),
]
if args.picture:
    run.plot("tip", "pin", file=str(args.picture))
finish(checks, run, args)
