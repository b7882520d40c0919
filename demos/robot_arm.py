"""A robot arm from its URDF file: six motors lift and turn it, its forearm is rigid, then elastic by one call.

Run:  ./with-dolfinx python3 demos/robot_arm.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

    base ==yaw== turret ==shoulder== upper arm ==elbow== forearm ==roll== wrist ==pitch== hand ==turn== tool

Needs yourdfpy: ./with-dolfinx pip install yourdfpy.  The file is meshes/robot_arm.urdf.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
t_end, dt = (0.2, 4e-3) if args.fast else (1.0, 2e-3)
goals = {"yaw": 0.9, "shoulder": 0.4, "elbow": -0.5, "roll": 0.8, "pitch": 0.6, "turn": 1.5}  # rad from the start
# "pin" and "tip" in the axes of the link
mesh = fmbd.read_gmsh("meshes/rod.py", dim=3, length=0.5, height=0.04, h=0.04)


def way(t):
    """0 to 1 in 0.8 s, with two continuous derivatives."""
    s = min(t / 0.8, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def arm(name, modulus=None):
    """The scene with a motor in each joint; with a forearm of this Young's modulus, or the rigid one of the file."""
    robot = fmbd.read_urdf("meshes/robot_arm.urdf", start={"elbow": 0.3})
    if modulus is not None:
        material = fmbd.materials.linear_elastic(modulus, 0.3)
        bar = fmbd.FloatingBody("bar", mesh, density=2700.0, elastic=material)
        robot.make_elastic("forearm", bar, surfaces={"elbow": "pin", "roll": "tip"}, modes=8)

    scene = robot.scene(name, gravity=(0, 0, -9.81))
    for joint, goal in goals.items():
        phi, begin = robot.coordinate(joint), robot.joints[joint].start
        size = 400.0 if joint in ("yaw", "shoulder", "elbow") else 10.0

        def target(t, begin=begin, goal=goal):
            return begin + goal * way(t)

        scene.add(fmbd.motor(f"motor {joint}", phi, target=target, kp=10 * size, kd=0.2 * size))
        scene.sensor(joint, phi)
    scene.sensor("flange", fmbd.position(scene.bodies["flange"]))
    return scene


rigid, stiff, soft = (
    fmbd.solve(arm(name, modulus), t_end=t_end, dt=dt, output=snapshots(args))
    for name, modulus in (("rigid arm", None), ("stiff forearm", 70e12), ("elastic forearm", 5e9))
)
off = [float(np.abs(run["flange"] - rigid["flange"]).max()) for run in (stiff, soft)]
checks = [
    Check("stiff forearm against the rigid one, m", off[0], 0.0, 1e-5),
    Check("the elastic forearm gives way, m", off[1], 2e-3, 1.9e-3),
    Check.relative("mass of the mesh, kg", stiff.system.parts[0].mass_total, 2.16, 1e-9),
    Check("yaw behind its target, rad", float(0.9 * way(t_end) - rigid["yaw"][-1, 0]), 0.0, 1e-2),
]
show(soft, args, ["flange"])
finish(checks, soft, args)
