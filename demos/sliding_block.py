"""An elastic block slides down an incline with Coulomb friction, or stays, at two scales.

Run:  ./with-dolfinx python3 demos/sliding_block.py

    gravity turned by the slope's angle a: slides when tan a > mu, with acceleration g (sin a - mu cos a), else sticks

The same block is run at sizes 1 and 1/1000 (lengths and times scaled alike): friction and contact are tested in the
units of the compliance of the contact, so the Newton counts are equal.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__)
g, mu, E, rho, cells = 9.81, 0.3, 1e7, 1000.0, 4 if args.fast else 8


def slide(angle, scale):
    """0.2 s at scale 1; lengths and E grow with the scale, so that weight and elastic forces keep their ratio."""
    mesh = fmbd.read_gmsh("meshes/block.py", size=(0.4 * scale, 0.2 * scale), cells=cells)
    block = fmbd.AbsoluteBody("block", mesh, degree=1, density=rho, elastic=fmbd.materials.plane_stress(E * scale, 0.3))
    plane = fmbd.Obstacle("slope", fmbd.HalfSpace((0, 0), (0, 1)))
    slope = fmbd.contact("slope", block.surface("bottom"), plane, friction=mu)
    scene = fmbd.Scene(f"block at {scale:g}", gravity=(g * np.sin(angle), -g * np.cos(angle)))
    scene.add(block, slope)
    scene.sensor("speed", fmbd.velocity(block.surface("top")))
    scene.sensor("force", fmbd.contact_force(slope))
    scene.sensor("work", fmbd.contact_work())
    time = np.sqrt(scale)
    return fmbd.solve(scene, t_end=0.2 * time, dt=1e-3 * time, scheme=fmbd.ContactMidpoint(theta=0.6),
        output=demo.snapshots(args))  # fmt: skip


steep, flat = np.arctan(0.6), np.arctan(0.2)
large, small, stuck = slide(steep, 1.0), slide(steep, 1e-3), slide(flat, 1.0)

exact, weight = g * (np.sin(steep) - mu * np.cos(steep)), rho * 0.4 * 0.2 * g
fast, slow = (run.momenta()[0][0] / run.system.mass / run.state.t for run in (large, small))
force, c = large["force"][20:].mean(0), large.counters
checks = [
    Check.relative("acceleration of sliding, m/s^2", fast, exact, 0.01),
    Check.relative("the same at 1:1000", slow, exact, 0.01),
    Check("friction over normal force, sliding", force[0] / force[1], -mu, 1e-6),
    Check("final speed of the stuck block, m/s", stuck["speed"][-1, 0], 0.0, 1e-3),
    Check.relative("its friction force, N", stuck["force"][100:, 0].mean(), -weight * np.sin(flat), 0.02),
    Check("Newton iterations, large minus small", c["newton_iterations"] - small.counters["newton_iterations"], 0.0),
    Check("Newton iterations per step in contact", c["contact_newton_iterations"] / c["contact_steps"], 0, 6.0),
]
if args.picture:
    normal = weight * np.cos(steep)
    known = {"speed x": lambda t: exact * t, "force x": lambda t: -mu * normal, "force y": lambda t: normal}
    large.plot("speed x", "force x", "force y", file=args.picture, reference=known)
demo.film(large, args, ["speed x", "force"], view=fmbd.View(contact=True))
demo.finish(checks, large, args)
