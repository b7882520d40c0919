"""An elastic ball drops on an elastic block: contact of two bodies with meshes that do not match, in space.

Run:  ./with-dolfinx python3 demos/ball_on_block.py     (also: ./with-dolfinx mpirun -n 2 python3 demos/ball_on_block.py)

Half a ball falls with v0 on a block that lies on a frictionless floor. Mortar rows with dual multipliers on the finer
surface carry the force; momentum is exchanged, energy never grows. Beside it: Hertz's law at the same approach, for a ball
on a half space.
"""

import numpy as np
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--h": 0.0})
h, cells, t_end = (0.06, 6, 2.0) if args.fast else (0.035, 10, 6.0)
R, v0, E, nu, rho, gap, low = 0.5, 0.05, 1.0, 0.3, 1.0, 0.002, -0.602

ball_mesh = fmbd.read_gmsh("meshes/half_ball.py", dim=3, radius=R, h=args.h or h, near=0.2, coarse=0.25)
block_mesh = fmbd.read_gmsh("meshes/block.py", size=(1.2, 1.2, 0.6), cells=cells, origin=(-0.6, -0.6, low))
elastic = fmbd.materials.linear_elastic(E, nu)
ball = fmbd.AbsoluteBody("ball", ball_mesh, degree=1, density=rho, elastic=elastic, velocity=(0.0, 0.0, -v0))
block = fmbd.AbsoluteBody("block", block_mesh, degree=1, density=rho, elastic=elastic)
floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0, low), (0.0, 0.0, 1.0)))
hit = fmbd.contact("hit", ball.surface("contact"), block.surface("front"))
scene = fmbd.Scene("ball on block")
scene.add(ball, block, hit, fmbd.contact("floor", block.surface("back"), floor))
scene.sensor("force", fmbd.contact_force(hit))
scene.sensor("impulse", fmbd.contact_impulse("hit"))
scene.sensor("floor", fmbd.contact_impulse("floor"))
scene.sensor("gap", fmbd.contact_gap(hit))
scene.sensor("pressure", fmbd.contact_pressure(hit))
run = fmbd.solve(scene, t_end=t_end, dt=0.05, output=demo.snapshots(args))

energy, c = run.total_energy, run.counters
mass = next(part.field.mass_total for part in run.system.parts if part.name == "ball")
balance = run.momenta()[0][2] + mass * v0 - run["floor"][-1, 2]
stopped = run["impulse"][-1, 2] / (mass * v0)
checks = [
    Check("momentum balance over m v0", balance / (mass * v0), 0.0, 1e-9),
    Check("largest energy gain, relative", energy.max() / energy[0] - 1, 0.0, 1e-6),
    Check("largest penetration over R", max(0.0, -run["gap"].min()) / R, 0.0, 1e-3),
    Check("the ball was stopped: impulse over m v0", stopped, 1.0 if args.fast else 1.7, 0.8),
    Check("Newton iterations per step in contact", c["contact_newton_iterations"] / c["contact_steps"], 0.0, 6.0),
]
if args.picture:
    k, force, r = E / (1 - nu**2) * 2 / 3, run["force"][:, 2], np.linspace(0.0, 1.0, 101)  # k: 4/3 E*
    hertz = lambda d: k * np.sqrt(R) * np.maximum(d, 0.0) ** 1.5
    free = solve_ivp(lambda t, y: (y[1], -hertz(y[0]) / mass), (0.0, t_end), (-gap, v0), max_step=0.02)
    top = force.argmax()
    a, nodes = (force[top] * R / k) ** (1 / 3), run.state.contact.x[run.state.contact.of("hit")]
    with plot.figure(args.picture, 1, 2, title=args.title) as (left, right):
        left.plot(free.t, hertz(free.y[0]), **plot.REFERENCE, label="rigid ball on Hertz's spring")
        left.plot(run.times, force, label=f"elastic ball and block, cells of {h:g} m")
        left.set(xlabel="time (s)", ylabel="force (N)")
        right.plot(
            a * r, 1.5 * force[top] / (np.pi * a**2) * np.sqrt(1 - r**2), **plot.REFERENCE, label="Hertz, this force"
        )
        right.plot(
            np.linalg.norm(nodes[:, :2], axis=1), run["pressure"][top], "o", ms=3, label=f"t = {run.times[top]:g} s"
        )
        right.set(xlabel="distance from the axis (m)", ylabel="pressure (N/m$^2$)", xlim=(0, 0.4))
demo.finish(checks, run, args)
