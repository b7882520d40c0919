"""Hertz contact: a half disk (line contact) or half ball (point contact) pressed on a rigid plane.

Run:  ./with-dolfinx python3 demos/hertz.py          (also: --dim 3; ./with-dolfinx mpirun -n 2 python3 demos/hertz.py)

    line:   a^2 = 4 F R / (pi E*),   p0 = 2 F / (pi a)
    point:  a^3 = 3 F R / (4 E*),    p0 = 3 F / (2 pi a^2)

The equilibrium comes from a few large implicit steps. Radius and peak pressure are read from the multipliers, which are
the pressure: p^2 is linear in x^2 over the contact. The pressure has a square-root edge, so its mean error is of first
order (0.88 from 10 to 40 cells). The rolling cylinder is ``rolling_cylinder.py``. Johnson, Contact Mechanics,
doi:10.1017/CBO9781139171731.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--dim": (2, 3), "--cells": 10})
dim, R, E, nu, rho = args.dim, 1.0, 1.0, 0.3, 1.0
a = (0.05 if dim == 3 else 0.005) * R  # half width that the load is chosen for; the theory is exact for small a / R
stiff = E / (1 - nu**2)  # E*, the plane is rigid
F = np.pi * a**2 * stiff / (4 * R) if dim == 2 else 4 * stiff * a**3 / (3 * R)
p0 = 2 * F / (np.pi * a) if dim == 2 else 3 * F / (2 * np.pi * a**2)
up = np.eye(dim)[-1]


def press(cells: int) -> tuple[fmbd.Run, float, float, float]:
    """Run, half width and peak pressure for so many cells per half width, and the RMS error of p over p0."""
    mesh = fmbd.read_gmsh(
        "meshes/half_ball.py",
        dim=dim,
        radius=R,
        h=a / cells,
        near=2 * a,
        coarse=1.5 * R / cells if dim == 2 else 0.15 * R,
    )
    body = fmbd.AbsoluteBody("body", mesh, degree=1, density=rho, elastic=fmbd.materials.linear_elastic(E, nu))
    plane = fmbd.contact(
        "plane", body.surface("contact"), fmbd.Obstacle("plane", fmbd.HalfSpace(0 * up, up)), search=0.1 * a
    )
    scene = fmbd.Scene("Hertz")
    scene.add(body, plane, fmbd.force("load", body.surface("top"), lambda t: -F * up))
    scene.add(fmbd.prismatic("guide", fmbd.ground, body.surface("top"), axis=up))
    scene.sensor("pressure", fmbd.contact_pressure(plane))
    scene.sensor("force", fmbd.contact_force(plane))
    run = fmbd.solve(scene, t_end=160.0, dt=20.0, scheme=fmbd.ContactMidpoint(theta=1.0))
    p = run["pressure"][-1]
    r2 = (run.state.contact.x[:, :-1] ** 2).sum(1)
    inner = (p > 0) & (r2 < (0.9 * a) ** 2)
    slope, top = np.polyfit(r2[inner], p[inner] ** 2, 1)
    exact = p0 * np.sqrt(np.maximum(0.0, 1 - r2 / a**2))
    near = r2 < (1.2 * a) ** 2
    return (
        run,
        float(np.sqrt(-top / slope)),
        float(np.sqrt(top)),
        float(np.sqrt(np.mean((p - exact)[near] ** 2)) / p0),
    )


run, half_width, peak, error = press(args.cells)
fmbd.say(run.report())
checks = [
    Check.relative("half width of the contact, m", half_width, a, 0.02),
    Check.relative("peak pressure, N/m^2", peak, p0, 0.02),
    Check.relative("resultant, N", float(run["force"][-1, -1]), F, 1e-6),
    Check("RMS error of the pressure over p0", error, 0.0, 0.05),
]
if not args.fast and dim == 2:
    errors = [press(n)[3] for n in (10, 20, 40)]
    fmbd.say("cells per half width 10, 20, 40: RMS error of p / p0 " + ", ".join(f"{e:.2e}" for e in errors))
    checks.append(Check("order of the pressure, 10 to 40 cells", float(np.log2(errors[0] / errors[-1]) / 2), 1.0, 0.25))
if args.picture:
    from matplotlib.figure import Figure

    found = run.state.contact
    r = found.x[:, 0] if dim == 2 else np.linalg.norm(found.x[:, :2], axis=1)
    fine = np.linspace(-1 if dim == 2 else 0, 1, 401)
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot(
        xlabel="distance from the middle / a", ylabel="p / p0", title="Hertz pressure: multipliers and theory"
    )
    axes.plot(fine, np.sqrt(1 - fine**2), "k-", lw=1, label="theory")
    axes.plot(r / a, found.pressure / p0, "o", ms=4, label=f"{args.cells} cells per half width")
    axes.set_xlim(-1.3 if dim == 2 else 0, 1.3)
    axes.legend()
    if fmbd.log.world_rank() == 0:
        figure.savefig(args.picture, dpi=150)
demo.finish(checks, run, args)
