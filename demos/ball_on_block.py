"""An elastic ball drops on an elastic block: contact of two bodies with meshes that do not match, in space.

Run:  ./with-dolfinx python3 demos/ball_on_block.py     (also: ./with-dolfinx mpirun -n 2 python3 demos/ball_on_block.py)

Half a ball falls with v0 on a block that lies on a frictionless floor. Mortar rows with dual multipliers on the finer
surface carry the force; momentum is exchanged, energy never grows. Hertz's impact theory gives the largest force
approximately.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--h": 0.0})
h = args.h or (0.06 if args.fast else 0.04)
R, v0, E, nu, rho = 0.5, 0.05, 1.0, 0.3, 1.0
gap = 0.002

ball_mesh = fmbd.read_gmsh("meshes/half_ball.py", dim=3, radius=R, h=h, near=0.2, coarse=0.25)
size = (1.2, 1.2, 0.6)
block_mesh = fmbd.read_gmsh("meshes/block.py", size=size, cells=6 if args.fast else 10, origin=(-0.6, -0.6, -0.6 - gap))
elastic = fmbd.materials.linear_elastic(E, nu)
ball = fmbd.AbsoluteBody("ball", ball_mesh, degree=1, density=rho, elastic=elastic, velocity=(0.0, 0.0, -v0))
block = fmbd.AbsoluteBody("block", block_mesh, degree=1, density=rho, elastic=elastic)
floor = fmbd.Obstacle("floor", fmbd.HalfSpace((0.0, 0.0, -0.6 - gap), (0.0, 0.0, 1.0)))
hit = fmbd.contact("hit", ball.surface("contact"), block.surface("front"))
scene = fmbd.Scene("ball on block")
scene.add(ball, block, hit, fmbd.contact("floor", block.surface("back"), floor))
scene.sensor("force", fmbd.contact_force(hit))
scene.sensor("impulse", fmbd.contact_impulse("hit"))
scene.sensor("floor", fmbd.contact_impulse("floor"))
scene.sensor("work", fmbd.contact_work())
scene.sensor("gap", fmbd.contact_gap(hit))

dt = 0.05
run = fmbd.solve(scene, t_end=2.0 if args.fast else 6.0, dt=dt)
fmbd.say(run.report())

energy = sum(run.energy.values())
p, _ = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
mass = next(part.field.mass_total for part in run.system.parts if part.name == "ball")
sign = -1.0 if run["force"][:, 2].sum() < 0 else 1.0  # which side carries the multipliers is chosen by mesh size
balance = p[2] - (-mass * v0 + run["floor"][-1, 2])
checks = [
    Check("momentum balance over m v0", float(balance / (mass * v0)), 0.0, 1e-9),
    Check("largest energy gain, relative", float(energy.max() / energy[0] - 1), 0.0, 1e-6),
    Check("largest penetration over R", float(max(0.0, -run["gap"].min()) / R), 0.0, 1e-3),
    Check(
        "the ball was stopped: impulse over m v0",
        float(sign * run["impulse"][-1, 2] / (mass * v0)),
        1.0 if args.fast else 1.7,
        0.8,
    ),
    Check(
        "Newton iterations per step in contact",
        run.counters["contact_newton_iterations"] / run.counters["contact_steps"],
        0.0,
        6.0,
    ),
]
if args.picture:
    from matplotlib.figure import Figure

    found = run.state.contact
    on = found.of("hit")
    x, pressure = found.x[on], found.pressure[on]
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.set(xlabel="time (s)", ylabel="force on the block or ball (N)")
    left.plot(run.times, sign * run["force"][:, 2])
    right.set(
        xlabel="distance from the axis (m)", ylabel="pressure (N/m^2)", title=f"at t = {run.state.t:g} s", xlim=(0, 0.4)
    )
    right.plot(np.linalg.norm(x[:, :2], axis=1), pressure, "o", ms=3)
    if fmbd.log.world_rank() == 0:
        figure.savefig(args.picture, dpi=150)
demo.finish(checks, run, args)
