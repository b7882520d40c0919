"""Five-link wheel suspension of a quarter car over a bump: five rods, spring and damper, tyre on a road profile.

Run:  ./with-dolfinx python3 demos/wheel_suspension.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

x forward, y to the left, z up; m, kg, N. The data are of this demo, in the range of a passenger car; no published set of the
five-link suspension was found. The car body moves vertically; the rods leave the carrier one degree of freedom of its own.
Reference for the end: weight over tyre stiffness, and the closure of the five rods at that travel by a root finder.
"""

import numpy as np
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
LINKS = {  # points on the car body and on the carrier
    "upper front": ((0.12, 0.40, 0.50), (0.02, 0.65, 0.48)),
    "upper rear": ((-0.15, 0.40, 0.50), (-0.03, 0.65, 0.48)),
    "lower front": ((0.15, 0.35, 0.20), (0.03, 0.68, 0.18)),
    "lower rear": ((-0.20, 0.35, 0.22), (-0.02, 0.68, 0.18)),
    "tie rod": ((0.14, 0.38, 0.30), (0.14, 0.66, 0.29)),
}
A, B = np.array(list(LINKS.values())).swapaxes(0, 1)  # the same, (5, 3) each
LENGTHS, WHEEL, BODY = np.linalg.norm(B - A, axis=1), np.array([0.0, 0.75, 0.30]), np.array([0.0, 0.2, 0.6])
RADIUS, STIFFNESS, SPEED, BUMP, WIDTH = 0.30, 2e5, 10.0, 0.05, 1.0  # m, N/m, m/s, m, m: the road comes towards the car


def road(x, t):
    """Height of the road under the wheel: one smooth bump."""
    s = (x[0] + SPEED * t - 10.0) / WIDTH
    return BUMP * (1 - s * s) ** 4 if abs(s) < 1 else 0.0


body = fmbd.RigidBody("body", 350.0, (40.0, 60.0, 70.0), BODY)
rim = fmbd.contacts.Cylinder(0.18, axis=(0, 1, 0), center=(0, 0.05, 0), length=0.16)
carrier = fmbd.RigidBody("carrier", 35.0, (0.7, 1.1, 0.7), WHEEL, shape=rim)
scene = fmbd.Scene("wheel suspension", gravity=(0, 0, -9.81))
guide = fmbd.prismatic("guide", fmbd.ground, body, axis=(0, 0, 1), center=BODY)
scene.add(body, carrier, guide)
for name, a, b, length in zip(LINKS, A, B, LENGTHS, strict=True):
    scene.add(fmbd.distance(name, body, carrier, point_a=a, point_b=b, length=float(length)))
top, seat = (0.0, 0.48, 0.75), (0.0, 0.62, 0.22)
scene.add(fmbd.Spring("strut", body, carrier, top, seat, stiffness=4e4, damping=4e3, length=0.66))
scene.add(fmbd.Tyre("tyre", carrier, road=road, radius=RADIUS, stiffness=STIFFNESS, damping=300.0, up=(0, 0, 1)))
scene.sensor("lift of the body", fmbd.displacement(guide))
scene.sensor("wheel", fmbd.position(carrier))
scene.sensor("R", fmbd.rotation(carrier))
scene.sensor("tie rod", fmbd.reaction("tie rod"))

mobility = scene.check()
run = fmbd.solve(scene, t_end=4.0, dt=4e-3 if args.fast else 1e-3, output=snapshots(args, 200))
lift, wheel, settled = run["lift of the body"][-1, 0], run["wheel"], RADIUS - 9.81 * (350 + 35) / STIFFNESS


def closure(y):
    """Residuals of the five rods for the wheel centre (x, y, .) and its rotation vector, at the height found."""
    ends = np.array([y[0], y[1], wheel[-1, 2]]) + Rotation.from_rotvec(y[2:]).apply(B - WHEEL)
    return np.linalg.norm(ends - A - [0, 0, lift], axis=1) - LENGTHS


y = fsolve(closure, [0, WHEEL[1], 0, 0, 0], xtol=1e-13)
expected, found = Rotation.from_rotvec(y[2:]).as_matrix(), run["R"][-1].reshape(3, 3)
camber, reference = (np.degrees(np.arctan2(R[2, 1], R[2, 2])) for R in (found, expected))  # rotation about x
checks = [
    Check("degrees of freedom", mobility.freedom, 2),
    Check("redundant rows", mobility.redundant, 0),
    Check("wheel centre at rest, m", wheel[-1, 2], settled, 1e-6),
    Check("track change at rest, m", wheel[-1, 1], y[1], 1e-9),
    Check("camber at rest, deg", camber, reference, 1e-6),
    Check("wheel over the bump, m", wheel[:, 2].max() - settled, BUMP, 0.02),
    Check("rods, m", run.drift[0], 0.0, 1e-10),
]
view = fmbd.View(instants=1, camera=(1.0, 0.9, 0.35))
show(run, args, ["wheel z", "lift of the body", "tie rod"], reference={"wheel z": (4.0, settled)}, view=view)
finish(checks, run, args)
