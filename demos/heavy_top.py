"""Heavy top: a fast gyroscope on a ball joint, with the rotation on SO(3).

Run:  ./with-dolfinx python3 demos/heavy_top.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

m = 15 kg, J = diag(0.234375, 0.46875, 0.234375) kg m^2 about the centre of mass, 1 m from the fixed point along the axis of
figure; spin 150 rad/s, weight along -z. Reference: Euler's equations by an explicit Runge-Kutta method of order 8 (1e-13).
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
REFERENCE = {0.1: (0.4212966589253617, 0.8945719743456066, -0.14916470056193187),
             0.2: (0.6055505613769779, 0.5989576817949871, -0.5239830274300896)}  # fmt: skip
t_end, dt = (0.1, 2e-4) if args.fast else (0.2, 1e-4)

J = np.array([0.234375, 0.46875, 0.234375])
spin = np.array([0.0, 150.0, -4.61538])
center = np.array([0.0, 1.0, 0.0])
disk = fmbd.contacts.Cylinder(0.25, axis=(0, 1, 0), length=0.0375)  # has this inertia
motion = {"velocity": np.cross(spin, center), "angular_velocity": spin}
top = fmbd.RigidBody("top", 15.0, J, center, shape=disk, **motion)
scene = fmbd.Scene("heavy top", gravity=(0, 0, -9.81))
scene.add(top)
scene.add(fmbd.spherical("tip", fmbd.ground, top, center=(0, 0, 0)))
scene.sensor("centre", fmbd.position(top))
scene.sensor("R", fmbd.rotation(top))
scene.sensor("support", fmbd.reaction_force("tip"))

scheme = fmbd.GeneralizedAlpha(0.9)
runs = [fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, output=snapshots(args)) for h in (2 * dt, dt)]
x = [r["centre"][-1] for r in runs]
error = [np.linalg.norm(xi - REFERENCE[t_end]) for xi in x]
run = runs[-1]
total = run.total_energy
R = run["R"].reshape(-1, 3, 3)
checks = [
    Check("order of the position", float(np.log2(error[0] / error[1])), 2.0, 0.1),
    Check("position at the end, m", error[1], 0.0, 1e-4),
    Check("the same, extrapolated, m", np.linalg.norm((4 * x[1] - x[0]) / 3 - REFERENCE[t_end]), 0.0, 1e-6),
    Check("energy error over the start, 1", np.abs(total / total[0] - 1).max(), 0.0, 1e-6),
    Check("orthogonality of R, 1", np.abs(R.swapaxes(1, 2) @ R - np.eye(3)).max(), 0.0, 1e-13),
    Check("constraint, m", run.drift[0], 0.0, 1e-12),
]
show(run, args, ["centre", "support"], reference={"centre": (t_end, REFERENCE[t_end])})
finish(checks, run, args)
