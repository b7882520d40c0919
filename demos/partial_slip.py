"""Partial slip of two elastic cylinders under a tangential force (Cattaneo and Mindlin).

Run:  ./with-dolfinx python3 demos/partial_slip.py          (also: ./with-dolfinx mpirun -n 2 python3 demos/partial_slip.py)

    p = p0 sqrt(1 - x^2 / a^2),     q = mu p0 (sqrt(1 - x^2 / a^2) - (c / a) sqrt(1 - x^2 / c^2)),     c = a sqrt(1 - Q / (mu P))

Two half disks of the same material are pressed together by P, then sheared by Q < mu P: the middle |x| < c sticks, the borders
slip. Pressure and traction are the multipliers of contact and friction on meshes that do not match. Equal materials
decouple them. Johnson, Contact Mechanics, section 7.2, doi:10.1017/CBO9781139171731.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--cells": 24})
R, E, nu, mu, share = 1.0, 1.0, 0.3, 0.3, 0.6
a = 0.01 * R
P = np.pi * a**2 * E / (1 - nu**2) / (4 * R)  # 1/R and 1/E* are both doubled by the second cylinder
p0, Q, c = 2 * P / (np.pi * a), share * mu * P, a * np.sqrt(1 - share)
n = 12 if args.fast else args.cells
press, shear, dt = 400.0, 400.0, 100.0  # s: times of pressing and of shearing, and a step of a hundred wave transits

bodies = []
for name, cells, mirrored in (("upper", n, False), ("lower", 0.8 * n, True)):
    mesh = fmbd.read_gmsh(
        "meshes/half_ball.py", dim=2, radius=R, h=a / cells, near=2 * a, coarse=1.5 / n, mirrored=mirrored
    )
    elastic = fmbd.materials.linear_elastic(E, nu)
    bodies.append(fmbd.AbsoluteBody(name, mesh, degree=1, density=1.0, elastic=elastic))
upper, lower = bodies


def load(t: float) -> tuple[float, float]:
    """First the pressing force, then the tangential one grows."""
    return Q * min(max((t - press) / shear, 0.0), 1.0), -P


pair = fmbd.contact("pair", upper.surface("contact"), lower.surface("contact"), friction=mu, search=0.1 * a)
scene = fmbd.Scene("partial slip")
scene.add(upper, lower, pair, fmbd.force("load", upper.surface("top"), load))
scene.add(fmbd.fixed("base", fmbd.ground, lower.surface("top")))
scene.add(fmbd.drive_rotation("no turning", fmbd.ground, upper.surface("top"), lambda t: 0.0))
scene.sensor("force", fmbd.contact_force(pair))
run = fmbd.solve(scene, t_end=press + shear + 300.0, dt=dt, scheme=fmbd.ContactMidpoint(theta=1.0))
fmbd.say(run.report())

found = run.state.contact
x = found.x[:, 0] - 0.5 * (found.x[found.normal_force > 0, 0].min() + found.x[found.normal_force > 0, 0].max())
q = np.abs(found.force[:, 0]) * found.pressure / np.where(found.normal_force > 0, found.normal_force, 1.0)
outer, inner = (np.sqrt(np.maximum(0.0, 1 - (x / r) ** 2)) for r in (a, c))
exact = mu * p0 * (outer - c / a * inner)
near = np.abs(x) < 1.2 * a
slips = (found.pressure > 0) & (q > 0.99 * mu * found.pressure)
stick = 0.5 * (x[slips & (x > 0)].min() - x[slips & (x < 0)].max())  # from the first slipping node on either side
spacing = a / n
checks = [
    Check.relative("normal force, N", float(np.abs(run["force"][-1, 1])), P, 1e-6),
    Check.relative("tangential force, N", float(np.abs(run["force"][-1, 0])), Q, 1e-6),
    Check.relative("peak pressure, N/m^2", float(found.pressure.max()), p0, 0.02),
    Check("half width of the stick zone over a", float(stick / a), c / a, 1.5 * spacing / a),
    Check(
        "RMS error of the traction over mu p0", float(np.sqrt(np.mean((q - exact)[near] ** 2)) / (mu * p0)), 0.0, 0.05
    ),
]
if args.picture:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.add_subplot(
        xlabel="x / a", ylabel="over p0", title="Partial slip: pressure and friction times 1 / mu"
    )
    order, fine = np.argsort(x), np.linspace(-1, 1, 801)
    outer, inner = (np.sqrt(np.maximum(0.0, 1 - (fine * a / r) ** 2)) for r in (a, c))
    axes.plot(fine, outer, "k-", lw=1, label="Hertz")
    axes.plot(fine, outer - c / a * inner, "k--", lw=1, label="Cattaneo and Mindlin")
    axes.plot(x[order] / a, found.pressure[order] / p0, "o", ms=4, label="p / p0")
    axes.plot(x[order] / a, q[order] / (mu * p0), "s", ms=4, label="q / (mu p0)")
    axes.set_xlim(-1.2, 1.2)
    axes.legend()
    if fmbd.log.world_rank() == 0:
        figure.savefig(args.picture, dpi=150)
demo.finish(checks, run, args)
