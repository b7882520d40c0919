"""A rigid cam drives an elastic follower: moving obstacle, sliding contact, a guide and a return spring.

Run:  ./with-dolfinx python3 demos/cam_follower.py          (also: ./with-dolfinx mpirun -n 2 python3 demos/cam_follower.py)

        | spring                 cam: a disk of radius r, turned about a point at distance e from its centre
       [ ]  elastic follower     lift of a flat-faced follower: y(t) = r - e cos(w t), exact in contact
       (o)  cam, w

The elastic follower carries the contact as multipliers on its foot, the guide as a joint. With a stiff spring it
follows the cam; the force on the cam is spring plus inertia.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check, show, snapshots

args = demo.arguments(__doc__, {"--cells": 6})
r, e, w = 0.03, 0.008, 2 * np.pi * 5.0  # m, m, rad/s
E, rho, k, preload = 2e9, 1200.0, 4e4, 0.02  # Pa, kg/m^3, N/m, m
size = width, length = 0.02, 0.08
t_end, dt = (0.06, 1e-4) if args.fast else (0.4, 5e-5)

counts = args.cells, 4 * args.cells
mesh = fmbd.read_gmsh("meshes/block.py", size=size, counts=counts, origin=(-width / 2, r - e), quads=True)
elastic = fmbd.materials.plane_stress(E, 0.3)
follower = fmbd.FloatingBody("follower", mesh, degree=1, density=rho, elastic=elastic, stiffness_damping=2e-5)
head, top = follower.surface("top"), r - e + length


def turning(t):
    """Position and angle of the cam's disk: its centre circles the shaft."""
    return (e * np.sin(w * t), -e * np.cos(w * t)), w * t


def force(t):
    """Force of a rigid follower on the cam: spring and inertia."""
    return k * (preload + e * (1 - np.cos(w * t))) + rho * width * length * e * w**2 * np.cos(w * t)


cam = fmbd.contact("cam", follower.surface("bottom"), fmbd.Obstacle("cam", fmbd.Sphere(r), motion=turning))
scene = fmbd.Scene("cam and follower")
scene.add(follower, cam, fmbd.prismatic("guide", fmbd.ground, head, axis=(0.0, 1.0)))
scene.add(fmbd.force("preload", head, lambda t: (0.0, -k * preload)))
scene.add(fmbd.Spring("return", head, fmbd.ground, point_b=(0.0, top + 0.1), stiffness=k, length=0.1))
scene.sensor("top", fmbd.position(head))
scene.sensor("force", fmbd.contact_force(cam))
scene.sensor("gap", fmbd.contact_gap(cam))
run = fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.ContactMidpoint(theta=0.55), output=snapshots(args))

t, c, late = run.times, run.counters, run.times > 0.02
off = np.abs(run["top"][:, 1] - top - e * (1 - np.cos(w * t))).max()
mean = np.convolve(run["force"][late, 1] - force(t[late]), np.ones(40) / 40, "valid")
checks = [
    Check("lift against the rigid cam law, over the stroke", off / (2 * e), 0.0, 0.03),
    Check(
        "force against spring and inertia, mean of 40 steps, relative", np.abs(mean).max() / force(t).max(), 0.0, 0.05
    ),
    Check("largest gap, over the stroke", run["gap"][late].max() / (2 * e), 0.0, 1e-3),
    Check("Newton iterations per step in contact", c["contact_newton_iterations"] / c["contact_steps"], 0.0, 6.0),
]
known = {"top y": lambda t: top + e * (1 - np.cos(w * t)), "force y": force}
show(run, args, ["top y", "force y"], reference=known, view=fmbd.View(instants=1, contact=True))
demo.finish(checks, run, args)
