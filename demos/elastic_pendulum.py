"""Elastic pendulum: a soft rod on a pin, released from the horizontal, swings through and bends.

Run:  ./with-dolfinx python3 demos/elastic_pendulum.py --picture pendulum.png
      ./with-dolfinx mpirun -n 2 python3 demos/elastic_pendulum.py --dim 3 --fast
      ./with-dolfinx python3 demos/elastic_pendulum.py --study          (orders in h and mesh size, error against time)

   pin o=================   rod: length 1 m, height 0.1 m, E = 5 MPa, a floating frame, P2 displacements
                        |
      gravity v         tip
"""

from math import pi, sin, sinh, sqrt
from pathlib import Path

import numpy as np
from scipy.special import ellipj, ellipk
from ufl import Identity, grad, inner, sym, tr

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, study

ROD = Path(__file__).resolve().parents[1] / "meshes/rod.py"
nu, rho, g = 0.3, 1000.0, 9.81  # -, kg/m^3, m/s^2


def build(dim=2, h=0.1, degree=2, E=5e6, height=0.1, gravity=g, ramp=0.0, displacement=None):
    """The scene; sensors "tip", "tip velocity" and "pin force"."""
    mu, lmbda = fmbd.materials.lame(E, nu)

    def elastic(u, v, dx):
        eps = sym(grad(u))
        return inner(2 * mu * eps + lmbda * tr(eps) * Identity(dim), sym(grad(v))) * dx

    mesh = fmbd.read_gmsh(ROD, dim=dim, h=h, height=height)
    rod = fmbd.FloatingBody(
        "rod", mesh, degree=degree, density=rho, elastic=elastic, displacement=displacement
    )
    scene = fmbd.Scene("elastic pendulum", gravity=(0, -gravity, 0), gravity_ramp=ramp)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0), axis=(0, 0, 1)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("tip velocity", fmbd.velocity(rod.surface("tip")))
    scene.sensor("pin force", fmbd.reaction("pin"))
    return scene


def rigid_tip(t, height, dim):
    """Tip of the rigid rod at time t by elliptic functions: sin(theta / 2) = k sn(K - w t), theta from the vertical."""
    w, k = sqrt(g / 2 / (1 / 3 + height**2 / 12)), sin(pi / 4)
    theta = 2 * np.arcsin(k * ellipj(ellipk(k**2) - w * t, k**2)[0])
    return np.array([np.sin(theta), -np.cos(theta), 0.0])[:dim]


def bending(dim, per_period):
    """First frequency (rad/s) of a slender pinned-free rod in a small swing without gravity, and Euler and Bernoulli's."""
    beta, height, E = 3.92660231204792, 0.02, 5e6  # beta: tan(beta) = tanh(beta)
    exact = beta**2 * height * sqrt((E / (1 - nu**2) if dim == 2 else E) / 12 / rho)
    ratio = 1e-4 * sin(beta) / sinh(beta)

    def shape(X):  # the mode w(x) of the axis; cross sections stay normal to it
        w = 1e-4 * np.sin(beta * X[0]) + ratio * np.sinh(beta * X[0])
        slope = beta * (1e-4 * np.cos(beta * X[0]) + ratio * np.cosh(beta * X[0]))
        return np.array([-X[1] * slope, w, 0 * w])[:dim]

    scene = build(dim, 0.04, height=height, gravity=0.0, displacement=shape)
    run = fmbd.solve(scene, t_end=2 * 2 * pi / exact, dt=2 * pi / exact / per_period)
    y = run["tip"][:, 1]
    i = np.flatnonzero(y[:-1] * y[1:] < 0)
    zeros = run.times[i] - y[i] * np.diff(run.times)[i] / np.diff(y)[i]
    return pi / np.diff(zeros).mean(), exact


def order_tables(dim):
    """Orders in the step and in the mesh size, error against run time; the order of three quantities as checks."""
    names, quiet = ["tip", "tip velocity", "pin force"], fmbd.Output(energy=False)
    scene = build(dim, 0.2, ramp=0.2)  # loads must be smooth before an order means anything
    in_h = lambda rho_inf: (
        lambda h: fmbd.solve(scene, t_end=0.5, dt=h, scheme=fmbd.GeneralizedAlpha(rho_inf), output=quiet)
    )
    in_mesh = lambda p: lambda s: fmbd.solve(build(dim, s, p, ramp=0.2), t_end=0.4, dt=4e-3, output=quiet)
    reference = in_h(0.8)(2.5e-4)
    steps = study.orders(in_h(0.8), [8e-3, 4e-3, 2e-3, 1e-3], reference=reference, names=names)
    demo.say(f"\norders in the step\n{steps}")
    sizes = [0.1, 0.05, 0.025, 0.0125] if dim == 2 else [0.2, 0.1, 0.05]
    fine = in_mesh(2)(sizes[-1] / 2)
    for p in (1, 2):
        table = study.orders(in_mesh(p), sizes, reference=fine, names=names, parameter="mesh size")
        demo.say(f"\norders in the mesh size, P{p}, against P2 at {sizes[-1] / 2} m\n{table}")
    configurations = [
        study.Configuration(f"rho_inf {r}", in_h(r), [8e-3, 4e-3, 2e-3]) for r in (0.9, 0.8, 0.5, 0.0)
    ]
    demo.say(
        f"\nerror against time\n{study.work_precision(configurations, reference=reference, names=names)}\n"
    )
    return [demo.Check(f"order of {n} in h", steps.order(n), 2.0, 0.15) for n in names]


def main():
    """Swing, report, picture and checks."""
    args = demo.arguments(__doc__, {"--dim": (2, 3), "--study": False})
    dim, fast = args.dim, args.fast
    output = fmbd.Output(snapshots=8, estimate_error=True)
    run = fmbd.solve(build(dim), t_end=0.9 if fast else 2.0, dt=5e-3 if fast else 1e-3, output=output)
    demo.say(run.report())
    stiff = fmbd.solve(build(dim, E=2e11), t_end=0.5, dt=5e-3 if fast else 1e-3)
    frequency, beam = bending(dim, 50 if fast else 200)
    energy = sum(run.energy.values())
    checks = [
        demo.Check(
            "energy lost, share of exchange",
            (energy[0] - energy[-1]) / np.ptp(run.energy["kinetic"]),
            0.0,
            1e-4,
        ),
        demo.Check(
            "tip of a stiff rod, y (m)",
            stiff["tip"][-1, 1],
            rigid_tip(0.5, 0.1, dim)[1],
            1e-4 if fast else 1e-5,
        ),
        demo.Check.relative("bending frequency (rad/s)", frequency, beam, 0.003),
        demo.Check("elastic factorisations", run.counters["factorisations"], 1, 0),
    ]
    if args.study:
        checks += order_tables(dim)
    if args.picture:
        run.picture(args.picture, sensor="tip")
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
