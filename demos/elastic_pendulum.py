"""Elastic pendulum: a soft rod on a pin, released from the horizontal, swings through and bends.

Run:  ./with-dolfinx python3 demos/elastic_pendulum.py --picture pendulum.png
      ./with-dolfinx mpirun -n 2 python3 demos/elastic_pendulum.py --dim 3 --fast

   pin o=================   rod: length 1 m, height 0.1 m, E = 5 MPa, a floating frame, P2 displacements
                        |
      gravity v         tip

Orders in step and mesh size, and error against time: ``pendulum_orders.py``.
"""

import numpy as np
from pendulum_references import PinnedFreeBeam, frequency, rigid_tip
from ufl import Identity, grad, inner, sym, tr

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo
from fmbd_fenicsx.post.demo import Check

nu, rho, g = 0.3, 1000.0, 9.81  # -, kg/m^3, m/s^2


def build(dim=2, h=0.1, degree=2, E=5e6, height=0.1, gravity=g, ramp=0.0, displacement=None):
    """The scene; sensors "tip", "tip velocity" and "pin force"."""
    mu, lmbda = fmbd.materials.lame(E, nu)

    def elastic(u, v, dx):
        eps = sym(grad(u))
        return inner(2 * mu * eps + lmbda * tr(eps) * Identity(dim), sym(grad(v))) * dx

    mesh = fmbd.read_gmsh("meshes/rod.py", dim=dim, h=h, height=height)
    rod = fmbd.FloatingBody("rod", mesh, degree=degree, density=rho, elastic=elastic, displacement=displacement)
    scene = fmbd.Scene("elastic pendulum", gravity=(0, -gravity, 0), gravity_ramp=ramp)
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0), axis=(0, 0, 1)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    scene.sensor("tip velocity", fmbd.velocity(rod.surface("tip")))
    scene.sensor("pin force", fmbd.reaction_force("pin"))
    return scene


def main():
    """Swing, picture and checks: energy, a stiff rod against the rigid one, a slender one against the beam."""
    args = demo.arguments(__doc__, {"--dim": (2, 3)})
    dim, fast = args.dim, args.fast
    output = demo.snapshots(args, estimate_error=True)
    run = fmbd.solve(build(dim), t_end=0.9 if fast else 2.0, dt=5e-3 if fast else 1e-3, output=output)
    lost = (run.total_energy[0] - run.total_energy[-1]) / np.ptp(run.energy["kinetic"])

    stiff = fmbd.solve(build(dim, E=2e11), t_end=0.5, dt=5e-3 if fast else 1e-3)
    beam = PinnedFreeBeam(5e6 / (1 - nu**2) if dim == 2 else 5e6, rho)  # plane strain in the plane
    slender = build(dim, 0.04, height=beam.height, gravity=0.0, displacement=beam.shape)
    swing = fmbd.solve(slender, t_end=2 * beam.period, dt=beam.period / (50 if fast else 200))
    checks = [
        Check("energy lost, share of exchange", lost, 0, 1e-4),
        Check("stiff tip y (m)", stiff["tip"][-1, 1], rigid_tip(0.5, 0.1, g)[1], 1e-4 if fast else 1e-5),
        Check.relative("bending (rad/s)", frequency(swing.times, swing["tip"][:, 1]), beam.omega, 0.003),
        Check("elastic factorisations", run.counters["factorisations"], 1),
    ]
    demo.show(run, args, ["tip"], view=fmbd.View(instants=8))
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
