"""A PID-controlled elastic arm reaches a point, against SciPy with rigid links.

Run:  ./with-dolfinx python3 demos/controlled_arm.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

    ground o=== link one ===o=== link two === tip      a PID motor in each hinge, under weight; stiff links against the
                                                       equations of the rigid arm, soft links beside them
"""

import numpy as np
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish, show, snapshots

args = arguments(__doc__)
t_end, dt = (0.25, 2.5e-3) if args.fast else (1.0, 6.25e-4)
g, goal, gains = 9.81, (0.7, -1.1), ((600.0, 500.0, 90.0), (200.0, 200.0, 24.0))
mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1)  # 1 m; surfaces "pin" and "tip"


def arm(name, modulus, modes):
    """Two links of the given Young's modulus by so many modes (0: rigid), a PID motor in each hinge."""
    material = fmbd.materials.linear_elastic(modulus, 0.3)
    scene = fmbd.Scene(name, gravity=(0, -g))
    end = fmbd.ground
    for i, label in enumerate(("one", "two")):
        body = fmbd.FloatingBody(label, mesh.placed((i, 0.0)), density=100.0, elastic=material)
        link = body.reduced(modes=modes)
        hinge = fmbd.revolute(f"hinge {label}", end, link.surface("pin"), center=(i, 0))
        motor = fmbd.pid(f"motor {label}", fmbd.angle(hinge), target=goal[i], gains=gains[i])
        scene.add(link, hinge, motor)
        scene.sensor(f"torque {label}", fmbd.element_effort(motor))
        end = link.surface("tip")
    scene.sensor("tip", fmbd.position(end))
    constants = link.constants
    inertia = float(constants.T[0, 0, 0, 0] + constants.T[0, 0, 1, 1])
    return scene, (constants.mass, inertia)


def rigid(times, mass, inertia):
    """Tip of two equal rigid links of 1 m by Lagrange's equations, (n, 2)."""

    def rate(t, x):
        q, v, z = x[:2], x[2:4], x[4:]
        c, s = np.cos(q[1]), np.sin(q[1])
        arm = mass * (0.25 + 0.5 * c) + inertia
        M = np.array([[mass * (1.5 + c) + 2 * inertia, arm], [arm, 0.25 * mass + inertia]])
        h = 0.5 * mass * s * np.array([-v[1] * (2 * v[0] + v[1]), v[0] ** 2])
        outer = 0.5 * mass * g * np.cos(q.sum())
        weight = np.array([1.5 * mass * g * np.cos(q[0]) + outer, outer])
        k, error = np.array(gains), goal - q
        u = k[:, 0] * error + k[:, 1] * z - k[:, 2] * v
        return np.concatenate((v, np.linalg.solve(M, u - h - weight), error))

    q = solve_ivp(rate, (0, times[-1]), np.zeros(6), "DOP853", t_eval=times, rtol=1e-12, atol=1e-13).y
    return np.stack((np.cos(q[0]) + np.cos(q[0] + q[1]), np.sin(q[0]) + np.sin(q[0] + q[1])), axis=1)


stiff, (mass, inertia) = arm("stiff arm", 1e14, 2)
runs = [fmbd.solve(stiff, t_end=t_end, dt=h) for h in (2 * dt, dt)]
exact = rigid(runs[0].times, mass, inertia)
errors = [np.abs(x - exact).max() for x in (runs[0]["tip"], runs[1]["tip"][::2])]
better = (4 * runs[1]["tip"][::2] - runs[0]["tip"]) / 3  # Richardson's extrapolation
soft = fmbd.solve(arm("soft arm", 2e9, 4)[0], t_end=t_end, dt=dt, output=snapshots(args))
checks = [
    Check("order in the step", float(np.log2(errors[0] / errors[1])), 2.0, 0.2),
    Check("stiff arm against SciPy, m", errors[1], 0.0, 2e-3),
    Check("the same after extrapolation, m", np.abs(better - exact).max(), 0.0, 2e-4 if args.fast else 1e-6),
]
show(soft, args, ["tip", "torque one"])
finish(checks, soft, args)
