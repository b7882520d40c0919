"""Partial slip of two elastic cylinders under a tangential force (Cattaneo and Mindlin).

Run:  ./with-dolfinx python3 demos/partial_slip.py          (also: ./with-dolfinx mpirun -n 2 python3 demos/partial_slip.py)

    p = p0 sqrt(1 - x^2 / a^2),     q = mu p0 (sqrt(1 - x^2 / a^2) - (c / a) sqrt(1 - x^2 / c^2)),     c = a sqrt(1 - Q / (mu P))

Two half disks of the same material are pressed together by P, then sheared by Q < mu P: the middle |x| < c sticks, the borders
slip. Pressure and traction are the multipliers of contact and friction on meshes that do not match. Equal materials
decouple them. Johnson, Contact Mechanics, section 7.2, doi:10.1017/CBO9781139171731.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--cells": 24})
R, E, nu, mu, share, n = 1.0, 1.0, 0.3, 0.3, 0.6, 12 if args.fast else args.cells
a = 0.01 * R
P = np.pi * a**2 * E / (1 - nu**2) / (4 * R)  # 1/R and 1/E* are both doubled by the second cylinder
p0, Q, c = 2 * P / (np.pi * a), share * mu * P, a * np.sqrt(1 - share)
press, shear, dt = 400.0, 400.0, 100.0  # s: times of pressing and of shearing, and a step of a hundred wave transits


def half_disk(name, cells, mirrored):
    """One cylinder with so many cells per half width of the contact."""
    near = {"h": a / cells, "near": 2 * a, "coarse": 1.5 / n}
    mesh = fmbd.read_gmsh("meshes/half_ball.py", dim=2, radius=R, mirrored=mirrored, **near)
    return fmbd.AbsoluteBody(name, mesh, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(E, nu))


def exact(x):
    """Pressure and traction / mu over p0."""
    outer, inner = (np.sqrt(np.maximum(0.0, 1 - (x / r) ** 2)) for r in (a, c))
    return outer, outer - c / a * inner


def load(t):
    """First the pressing force, then the tangential one grows."""
    return Q * min(max((t - press) / shear, 0.0), 1.0), -P


upper, lower = half_disk("upper", n, False), half_disk("lower", 0.8 * n, True)
pair = fmbd.contact("pair", upper.surface("contact"), lower.surface("contact"), friction=mu, search=0.1 * a)
scene = fmbd.Scene("partial slip")
scene.add(upper, lower, pair, fmbd.force("load", upper.surface("top"), load))
scene.add(fmbd.fixed("base", fmbd.ground, lower.surface("top")))
scene.add(fmbd.drive_rotation("no turning", fmbd.ground, upper.surface("top"), lambda t: 0.0))
scene.sensor("force", fmbd.contact_force(pair))
kept = {"scheme": fmbd.ContactMidpoint(theta=1.0), "output": demo.snapshots(args)}
run = fmbd.solve(scene, t_end=press + shear + 300.0, dt=dt, **kept)

found = run.state.contact
on, p = found.normal_force > 0, found.pressure
x = found.x[:, 0] - 0.5 * (found.x[on, 0].min() + found.x[on, 0].max())
q = np.abs(found.force[:, 0]) * p / np.where(on, found.normal_force, 1.0)
slips, error = (p > 0) & (q > 0.99 * mu * p), (q / (mu * p0) - exact(x)[1])[np.abs(x) < 1.2 * a]
stick = 0.5 * (x[slips & (x > 0)].min() - x[slips & (x < 0)].max())  # from the first slipping node on either side
checks = [
    Check.relative("normal force, N", np.abs(run["force"][-1, 1]), P, 1e-6),
    Check.relative("tangential force, N", np.abs(run["force"][-1, 0]), Q, 1e-6),
    Check.relative("peak pressure, N/m^2", p.max(), p0, 0.02),
    Check("half width of the stick zone over a", stick / a, c / a, 1.5 / n),
    Check("RMS error of the traction over mu p0", np.sqrt(np.mean(error**2)), 0.0, 0.05),
]
if args.picture:
    fine = np.linspace(-1, 1, 801)
    with plot.figure(args.picture, title=args.title) as axes:
        for curve, name in zip(exact(a * fine), ("Hertz", "Cattaneo and Mindlin"), strict=True):
            axes.plot(fine, curve, **plot.REFERENCE | {"linestyle": "-" if name == "Hertz" else ":"}, label=name)
        axes.plot(x / a, p / p0, "o", ms=4, label="pressure / p$_0$")
        axes.plot(x / a, q / (mu * p0), "s", ms=4, label="traction / ($\\mu$ p$_0$)")
        axes.set(xlabel="x / a", ylabel="over p$_0$", xlim=(-1.2, 1.2))
demo.finish(checks, run, args)
