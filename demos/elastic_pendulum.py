"""Elastic pendulum: a soft rod on a pin, released from the horizontal, swings through and bends.

Run:  ./with-dolfinx python3 demos/elastic_pendulum.py --picture pendulum.png
      ./with-dolfinx mpirun -n 2 python3 demos/elastic_pendulum.py --dim 3 --fast
      ./with-dolfinx python3 demos/elastic_pendulum.py --study        (orders, error against time)

   pin o=================   rod: length 1 m, height 0.1 m, E = 5 MPa, a floating frame, P2 displacements
                        |
      gravity v         tip
"""

from functools import partial
from pathlib import Path

import numpy as np
from pendulum_references import PinnedFreeBeam, frequency, rigid_tip
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
    rod = fmbd.FloatingBody("rod", mesh, degree=degree, density=rho, elastic=elastic, displacement=displacement)
    scene = fmbd.Scene("elastic pendulum", gravity=(0, -gravity, 0), gravity_ramp=ramp)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0), axis=(0, 0, 1)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("tip velocity", fmbd.velocity(rod.surface("tip")))
    scene.sensor("pin force", fmbd.reaction("pin"))
    return scene


def orders_and_cost(dim):
    """Print orders in step and mesh size and error against time; return the orders in the step as checks."""
    names, quiet = ["tip", "tip velocity", "pin force"], fmbd.Output(energy=False)
    scene = build(dim, 0.2, ramp=0.2)  # loads must be smooth before an order means anything

    def in_step(rho_inf, h):
        return fmbd.solve(scene, t_end=0.5, dt=h, scheme=fmbd.GeneralizedAlpha(rho_inf), output=quiet)

    def in_mesh(degree, size):
        return fmbd.solve(build(dim, size, degree, ramp=0.2), t_end=0.4, dt=4e-3, output=quiet)

    reference = in_step(0.8, 2.5e-4)
    steps = study.orders(partial(in_step, 0.8), [8e-3, 4e-3, 2e-3, 1e-3], reference=reference, names=names)
    demo.say(f"\norders in the step\n{steps}")
    sizes = [0.1, 0.05, 0.025, 0.0125] if dim == 2 else [0.2, 0.1, 0.05]
    fine = in_mesh(2, sizes[-1] / 2)
    for p in (1, 2):
        table = study.orders(partial(in_mesh, p), sizes, reference=fine, names=names, parameter="mesh size")
        demo.say(f"\norders in the mesh size, P{p}, against P2 at {sizes[-1] / 2} m\n{table}")
    runs = [study.Configuration(f"rho_inf {r}", partial(in_step, r), [8e-3, 4e-3, 2e-3]) for r in (0.9, 0.5, 0.0)]
    demo.say(f"\nerror against time\n{study.work_precision(runs, reference=reference, names=names)}\n")
    return [demo.Check(f"order of {n} in the step", steps.order(n), 2.0, 0.15) for n in names]


def main():
    """Swing, report, picture and checks."""
    args = demo.arguments(__doc__, {"--dim": (2, 3), "--study": False})
    dim, fast = args.dim, args.fast
    output = fmbd.Output(snapshots=8, estimate_error=True)
    run = fmbd.solve(build(dim), t_end=0.9 if fast else 2.0, dt=5e-3 if fast else 1e-3, output=output)
    if args.picture:
        run.picture(args.picture, sensor="tip")
    energy = run.total_energy
    stiff = fmbd.solve(build(dim, E=2e11), t_end=0.5, dt=5e-3 if fast else 1e-3)
    beam = PinnedFreeBeam(5e6 / (1 - nu**2) if dim == 2 else 5e6, rho)  # plane strain in the plane
    slender = build(dim, 0.04, height=beam.height, gravity=0.0, displacement=beam.shape)
    swing = fmbd.solve(slender, t_end=2 * beam.period, dt=beam.period / (50 if fast else 200))
    checks = [
        demo.Check(
            "energy lost, share of exchange",
            (energy[0] - energy[-1]) / np.ptp(run.energy["kinetic"]),
            0,
            1e-4,
        ),
        demo.Check("stiff tip y (m)", stiff["tip"][-1, 1], rigid_tip(0.5, 0.1, g)[1], 1e-4 if fast else 1e-5),
        demo.Check.relative("bending (rad/s)", frequency(swing.times, swing["tip"][:, 1]), beam.omega, 0.003),
        demo.Check("elastic factorisations", run.counters["factorisations"], 1, 0),
    ]
    if args.study:
        checks += orders_and_cost(dim)
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
