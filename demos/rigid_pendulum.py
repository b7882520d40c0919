"""Mathematical pendulum: m = L = 1, released from the horizontal, against elliptic functions (IFToMM A01).

Run:  ./with-dolfinx python3 demos/rigid_pendulum.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

      o----- m        cos(theta / 2) sn and cn: sin(theta / 2) = k sn(K(k) + w t, k), k = sin(theta_0 / 2), w^2 = g / L
"""

import numpy as np
from scipy.special import ellipj, ellipk

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
g = 9.81
t_end, dt = (2.0, 8e-4) if args.fast else (10.0, 4e-4)


def position(t):
    """Exact position of the mass, (n, 2) or (2,)."""
    m = 0.5  # k^2 for the release at 90 degrees
    s = np.sqrt(m) * ellipj(ellipk(m) + np.sqrt(g) * t, m)[0]
    theta = -2 * np.arcsin(s)  # from the vertical, starts on the left
    return np.stack((np.sin(theta), -np.cos(theta)), axis=-1)


mass = fmbd.RigidBody("mass", 1.0, 1.0, position=(-1.0, 0.0))
scene = fmbd.Scene("pendulum", gravity=(0, -g))
scene.add(mass, fmbd.distance("rod", fmbd.ground, mass, point_a=(0, 0), point_b=(-1, 0), length=1.0))
scene.sensor("mass", fmbd.position(mass))
scene.sensor("tension", fmbd.reaction("rod"))


how = {"scheme": fmbd.GeneralizedAlpha(0.9), "output": snapshots(args)}
coarse, run = (fmbd.solve(scene, t_end=t_end, dt=h, **how) for h in (2 * dt, dt))
error = [np.abs(r["mass"] - position(r.times)).max() for r in (coarse, run)]
better = (4 * run["mass"][::2] - coarse["mass"]) / 3  # Richardson's extrapolation
total = run.total_energy
checks = [
    Check("order of the position", float(np.log2(error[0] / error[1])), 2.0, 0.1),
    Check("position error, m", error[1], 0.0, 3e-5),
    Check("position error after extrapolation, m", np.abs(better - position(coarse.times)).max(), 0.0, 1e-7),
    Check.relative("tension at the end, N", run["tension"][-1, 0], -3 * g * position(t_end)[1], 1e-3),
    Check("energy error, J", np.abs(total - total[0]).max(), 0.0, 5e-5),
    Check("constraint, m", run.drift[0], 0.0, 1e-13),
]
known = {"mass": position, "tension": lambda t: -3 * g * position(t)[1]}
show(run, args, ["mass", "tension"], reference=known)
finish(checks, run, args)
