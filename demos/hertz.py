"""Hertz contact: a half disk (line contact) or half ball (point contact) pressed on a rigid plane.

Run:  ./with-dolfinx python3 demos/hertz.py          (also: --dim 3; ./with-dolfinx mpirun -n 2 python3 demos/hertz.py)

    line:   a^2 = 4 F R / (pi E*),   p0 = 2 F / (pi a)
    point:  a^3 = 3 F R / (4 E*),    p0 = 3 F / (2 pi a^2)

The equilibrium comes from a few large implicit steps. Radius and peak pressure are read from the multipliers, which are the
pressure: p^2 is linear in x^2 over the contact. The pressure has a square-root edge, so its mean error is of first order (0.88
from 10 to 40 cells). Rolling: ``rolling_cylinder.py``. Johnson, Contact Mechanics, doi:10.1017/CBO9781139171731.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--dim": (2, 3), "--cells": 10})
dim, R, E, nu = args.dim, 1.0, 1.0, 0.3
a, stiff, up = (0.05 if dim == 3 else 0.005) * R, E / (1 - nu**2), np.eye(dim)[-1]  # half width << R; E*; normal
F = np.pi * a**2 * stiff / (4 * R) if dim == 2 else 4 * stiff * a**3 / (3 * R)
p0 = 2 * F / (np.pi * a) if dim == 2 else 3 * F / (2 * np.pi * a**2)


def press(cells):
    """Run for so many cells per half width; distances of its nodes from the middle / a, pressures / p0, their RMS error."""
    coarse = 1.5 * R / cells if dim == 2 else 0.15 * R
    mesh = fmbd.read_gmsh("meshes/half_ball.py", dim=dim, radius=R, h=a / cells, near=2 * a, coarse=coarse)
    body = fmbd.AbsoluteBody("body", mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(E, nu))
    obstacle = fmbd.Obstacle("plane", fmbd.HalfSpace(0 * up, up))
    plane = fmbd.contact("plane", body.surface("contact"), obstacle, search=0.1 * a)
    scene = fmbd.Scene("Hertz")
    scene.add(body, plane, fmbd.force("load", body.surface("top"), lambda t: -F * up))
    scene.add(fmbd.prismatic("guide", fmbd.ground, body.surface("top"), axis=up))
    scene.sensor("force", fmbd.contact_force(plane))
    run = fmbd.solve(scene, t_end=160.0, dt=20.0, scheme=fmbd.ContactMidpoint(theta=1.0))
    r, p = np.linalg.norm(run.state.contact.x[:, :-1], axis=1) / a, run.state.contact.pressure / p0
    return run, r, p, np.sqrt(np.mean((p - np.sqrt(np.maximum(0.0, 1 - r**2)))[r < 1.2] ** 2))


run, r, p, error = press(args.cells)
inner = (p > 0) & (r < 0.9)
slope, top = np.polyfit(r[inner] ** 2, p[inner] ** 2, 1)
checks = [
    Check.relative("half width of the contact, m", a * np.sqrt(-top / slope), a, 0.02),
    Check.relative("peak pressure, N/m^2", p0 * np.sqrt(top), p0, 0.02),
    Check.relative("resultant, N", run["force"][-1, -1], F, 1e-6),
    Check("RMS error of the pressure over p0", error, 0.0, 0.05),
]
if not args.fast and dim == 2:
    errors = [press(n)[-1] for n in (10, 20, 40)]
    fmbd.say("cells per half width 10, 20, 40: RMS error of p / p0 " + ", ".join(f"{e:.2e}" for e in errors))
    checks.append(Check("order of the pressure, 10 to 40 cells", np.log2(errors[0] / errors[-1]) / 2, 1.0, 0.25))
if args.picture:
    fine = np.linspace(-1.0, 1.0, 401)
    with plot.figure(args.picture, title=args.title) as axes:
        axes.plot(fine, np.sqrt(1 - fine**2), **plot.REFERENCE, label="Hertz")
        axes.plot(r * np.sign(run.state.contact.x[:, 0]), p, "o", ms=4, label=f"{args.cells} cells per half width")
        axes.set(xlabel="distance from the middle / a", ylabel="pressure / p$_0$", xlim=(-1.3, 1.3))
demo.finish(checks, run, args)
