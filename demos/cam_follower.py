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
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--cells": 6})
r, e, w = 0.03, 0.008, 2 * np.pi * 5.0  # m, m, rad/s
E, rho, size = 2e9, 1200.0, (0.02, 0.08)
k, preload = 4e4, 0.02  # N/m, m
t_end = 0.06 if args.fast else 0.4

mesh = fmbd.read_gmsh(
    "meshes/block.py",
    size=size,
    counts=(args.cells, 4 * args.cells),
    origin=(-size[0] / 2, r - e),
    quads=True,
)
follower = fmbd.FloatingBody(
    "follower",
    mesh,
    degree=1,
    density=rho,
    elastic=fmbd.materials.plane_stress(E, 0.3),
    stiffness_damping=2e-5,
)


def turning(t: float) -> tuple[tuple[float, float], float]:
    """Position and angle of the cam's disk: its centre circles the shaft."""
    return (e * np.sin(w * t), -e * np.cos(w * t)), w * t


cam = fmbd.contact("cam", follower.surface("bottom"), fmbd.Obstacle("cam", fmbd.Sphere(r), motion=turning))
scene = fmbd.Scene("cam and follower")
scene.add(follower, cam)
scene.add(fmbd.prismatic("guide", fmbd.ground, follower.surface("top"), axis=(0.0, 1.0)))
top = r - e + size[1]
scene.add(
    fmbd.force("spring", follower.surface("top"), lambda t: (0.0, -k * preload)),
    fmbd.Spring("return", follower.surface("top"), fmbd.ground, point_b=(0.0, top + 1.0), stiffness=k, length=1.0),
)
scene.sensor("top", fmbd.position(follower.surface("top")))
scene.sensor("force", fmbd.contact_force(cam))
scene.sensor("gap", fmbd.contact_gap(cam))
dt = 1e-4 if args.fast else 5e-5
run = fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.ContactMidpoint(theta=0.55))
fmbd.say(run.report())

t = run.times
lift = run["top"][:, 1] - top
exact = (r - e * np.cos(w * t)) - (r - e)
mass = rho * size[0] * size[1]
late = t[1:] > 0.02
force = k * (preload + exact[1:]) + mass * e * w**2 * np.cos(w * t[1:])
mean = np.convolve((run["force"][1:, 1] - force)[late], np.ones(40) / 40, "valid")
checks = [
    Check(
        "lift against the rigid cam law, over the stroke",
        float(np.abs(lift - exact).max() / (2 * e)),
        0.0,
        0.03,
    ),
    Check(
        "force against spring and inertia, mean of 40 steps, relative",
        float(np.abs(mean).max() / force.max()),
        0.0,
        0.05,
    ),
    Check("largest gap, over the stroke", float(run["gap"][t > 0.02].max() / (2 * e)), 0.0, 1e-3),
    Check(
        "Newton iterations per step in contact",
        run.counters["contact_newton_iterations"] / run.counters["contact_steps"],
        0.0,
        6.0,
    ),
]
if args.picture:
    run.plot("top", "force", file=args.picture)
demo.finish(checks, run, args)
