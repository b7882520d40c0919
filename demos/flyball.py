r"""Stiff flyball governor: two rods with balls, a slider held by stiff springs and dampers (IFToMM A05).

Run:  ./with-dolfinx python3 demos/flyball.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

    --+--        shaft and rods 1 m x 0.01 m x 0.01 m, slider a cube of 0.1 m, density 3000 kg/m^3, balls 5 kg at the ends of
     /|\\         the rods, which are hinged at x = +-0.05 m on top of the shaft, 30 degrees below the horizontal; springs
    / # \\        8e5 N/m and dampers 4e4 N s/m from their middles to the slider; 2 pi rad/s, free to spin.
   o  |  o       Reference: the three coordinates (spin, rod angle, slider height) by Radau at 1e-12, tests/test_demos_rigid.py.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
HEIGHT = {1.0: 0.501420922380, 10.0: 0.619622917061}  # of the slider, m
t_end, dt = (1.0, 2e-3) if args.fast else (10.0, 1e-3)

spin = np.array([0, 0, 2 * np.pi])
thin, ball = 3000 * 0.01**2, 5.0
m = thin + ball
c = (0.5 * thin + ball) / m  # centre of rod and ball from the hinge
J = np.array([thin * 1e-4 / 6, 0.0, 0.0])
J[1:] = thin * (1 + 1e-4) / 12 + thin * (c - 0.5) ** 2 + ball * (1 - c) ** 2

shaft = fmbd.RigidBody(
    "shaft", thin, np.array([1 + 1e-4, 1 + 1e-4, 2e-4]) * thin / 12, (0, 0, 0.5), angular_velocity=spin
)
slider = fmbd.RigidBody(
    "slider", 3.0, np.full(3, 3.0 * 0.01 / 6), (0, 0, 0.5), angular_velocity=spin, shape=fmbd.contacts.Box((0.1,) * 3)
)
scene = fmbd.Scene("flyball governor", gravity=(0, 0, -9.81))
scene.add(shaft, slider)
guide = fmbd.prismatic("guide", shaft, slider, axis=(0, 0, 1), center=(0, 0, 0.5))
scene.add(fmbd.revolute("bearing", fmbd.ground, shaft, center=(0, 0, 0)), guide)
for name, side in (("right", 1.0), ("left", -1.0)):
    d = np.array([side * np.cos(np.pi / 6), 0, -np.sin(np.pi / 6)])
    hinge, e = np.array([0.05 * side, 0, 1.0]), np.array([0, 1.0, 0])
    R, x = np.stack((d, e, np.cross(d, e)), axis=1), hinge + c * d
    shape = [fmbd.contacts.Sphere(0.08, (1 - c, 0, 0)), fmbd.contacts.Box((1.0, 0.02, 0.02), (0.5 - c, 0, 0))]
    rod = fmbd.RigidBody(name, m, J, x, R, velocity=np.cross(spin, x), angular_velocity=R.T @ spin, shape=shape)
    scene.add(rod, fmbd.revolute(f"hinge {name}", shaft, rod, center=hinge, axis=e))
    ends = (hinge + 0.5 * d, (0.05 * side, 0, 0.5))
    scene.add(fmbd.Spring(f"spring {name}", rod, slider, *ends, stiffness=8e5, damping=4e4, length=0.5))
scene.sensor("slider", fmbd.displacement(guide))
scene.sensor("spin", fmbd.joint_rate(fmbd.angle(scene.joints["bearing"])))

scheme = fmbd.GeneralizedAlpha(0.8)
runs = [fmbd.solve(scene, t_end=t_end, dt=h, scheme=scheme, output=snapshots(args)) for h in (2 * dt, dt)]
run, z = runs[-1], [0.5 + r["slider"][-1, 0] for r in runs]
before, after = (run.momenta(state)[1][2] for state in (scene.build()[1], run.state))
checks = [
    Check("degrees of freedom", scene.check().freedom, 4, 0),
    Check("slider height, m", z[1], HEIGHT[t_end], 1e-4),
    Check("the same, extrapolated, m", (4 * z[1] - z[0]) / 3, HEIGHT[t_end], 1e-6),
    Check.relative("angular momentum about the shaft, N m s", after, before, 1e-5),
    Check("constraint, m", run.drift[0], 0.0, 1e-11),
]
view = fmbd.View(instants=1, camera=(0.3, -1.0, 0.3))
show(run, args, ["slider", "spin"], reference={"slider": (t_end, HEIGHT[t_end] - 0.5)}, view=view)
finish(checks, run, args)
