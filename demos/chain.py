"""Chains of 10, 100 and 1000 planar links under gravity, held at one end: assembly and linear algebra that grow like N.

Run:  ./with-dolfinx python3 demos/chain.py [--links N] [--fast] [--json FILE] [--picture FILE] [--animate FILE]

Uniform links of 0.1 m and 0.1 kg, released from a straight line at 45 degrees; longer chains fall for longer.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, say, show, snapshots

args = arguments(__doc__, {"--links": 0})
LENGTH, MASS = 0.1, 0.1
e = np.array([1.0, -1.0]) / np.sqrt(2)


def chain(n):
    """The scene; sensors "tip" and "pin"."""
    scene = fmbd.Scene(f"chain of {n} links", gravity=(0, -9.81))
    inertia = MASS * LENGTH**2 / 12
    links = [fmbd.RigidBody(f"link {i}", MASS, inertia, (i + 0.5) * LENGTH * e, -np.pi / 4) for i in range(n)]
    scene.add(*links)
    for i, (a, b) in enumerate(zip([fmbd.ground, *links], links, strict=False)):
        scene.add(fmbd.revolute(f"pin {i}", a, b, center=i * LENGTH * e))
    scene.sensor("tip", fmbd.position(links[-1], point=n * LENGTH * e))
    scene.sensor("pin", fmbd.reaction_force("pin 0"))
    return scene


checks = []
for n in [args.links] if args.links else [10] if args.fast else [10, 100, 1000]:
    scene = chain(n)
    run = fmbd.solve(scene, t_end=0.3 * np.sqrt(n * LENGTH), dt=1e-3, output=snapshots(args, every=10))
    total = run.total_energy
    fall = run.energy["weight"][0] - run.energy["weight"].min()
    free = -0.5 * 9.81 / np.sqrt(2) * run.times[1] ** 2  # across the straight chain its free end falls freely
    checks += [
        Check(f"{n}: degrees of freedom", scene.check().freedom if n <= 100 else n, n, 0),
        Check(f"{n}: energy error over the fall, 1", np.abs(total - total[0]).max() / fall, 0.0, 1e-4),
        Check.relative(f"{n}: first fall of the tip, m", run["tip"][1] @ (1, 1) / np.sqrt(2), free, 5e-3),
        Check(f"{n}: constraint, m", run.drift[0], 0.0, 1e-10),
    ]
    say(f"{n:5d} links: {1e3 * run.seconds['steps'] / run.counters['steps']:.3f} ms a step")
show(run, args, ["tip", "pin"])
finish(checks, run, args)
