"""Flying beam: a free, very flexible beam is thrown by a force and a couple at its end and tumbles; own weak form in 20 lines.

Run:  ./with-dolfinx python3 demos/flying_beam.py            (--fast; --picture flying_beam.png)

   (couple 80 N m, force 8 N until t = 2.5 s)  start o==================== end     10 m, at atan(4/3) to the ground

Geometrically exact planar beam: sections move by (x, y) and turn by theta, with the strains Gamma = R^T x' - e_1 and theta'.
Data of the flying spaghetti: Simo and Vu-Quoc, doi:10.1115/1.3171871. The paper shows pictures, no numbers; the reference is a
run on a mesh twice as fine with half the step. A linear beam in a floating frame cannot follow.
"""

from math import atan2

import numpy as np
from ufl import as_vector, cos, sin

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo

L, EA, GA, EI, RHO_A, RHO_I = 10.0, 1e4, 1e4, 1e2, 1.0, 10.0  # m, N, N, N m^2, kg/m, kg m
ANGLE, END = -atan2(4.0, 3.0), 2.5  # rad, s


def mass(z, w, ds):
    """Inertia of the sections."""
    return (RHO_A * (z[0] * w[0] + z[1] * w[1]) + RHO_I * z[2] * w[2]) * ds


def energy(z, ds):
    """Stretch, shear and bending of the geometrically exact beam, J."""
    axis, across = as_vector((cos(z[2]), sin(z[2]))), as_vector((-sin(z[2]), cos(z[2])))
    tangent = as_vector((z[0].dx(0), z[1].dx(0)))
    stretch, shear = tangent[0] * axis[0] + tangent[1] * axis[1] - 1, tangent[0] * across[0] + tangent[1] * across[1]
    return 0.5 * (EA * stretch**2 + GA * shear**2 + EI * z[2].dx(0) ** 2) * ds


def exact(cells):
    """The beam by the weak form above."""
    return fmbd.LineBody(
        "beam", L, mass, energy, start=lambda s: [s * np.cos(ANGLE), s * np.sin(ANGLE), 0 * s + ANGLE], cells=cells
    )


def linear():
    """The same beam with linear strains in a floating frame."""
    section = fmbd.Section(EA=EA, EI=EI, GA=GA, rhoA=RHO_A, rhoI=RHO_I)
    return fmbd.Beam("beam", (0.0, 0.0), (L * np.cos(ANGLE), L * np.sin(ANGLE)), section, attached=False)


def push(t):
    """1, 0 after END, and half way at the jump, so that sums over steps give the exact impulse."""
    return 1.0 if t < END - 1e-9 else 0.5 if t < END + 1e-9 else 0.0


def fly(beam, dt, t_end):
    """The run; not a line of it knows the formulation."""
    scene = fmbd.Scene("flying beam")
    scene.add(beam, fmbd.force("throw", beam.surface("end"), lambda t: (8.0 * push(t), 0.0)))
    scene.add(fmbd.torque("couple", beam.surface("end"), lambda t: -80.0 * push(t)))
    for name in ("start", "end"):
        scene.sensor(name, fmbd.position(beam.surface(name)))
    scene.sensor("nodes", fmbd.coordinates(beam))
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.GeneralizedAlpha(0.9))


def main():
    args = demo.arguments(__doc__)
    cells, dt, t_end = (8, 2e-2, 4.0) if args.fast else (20, 1e-2, 7.5)
    run, fine = fly(exact(cells), dt, t_end), fly(exact(2 * cells), dt / 2, t_end)
    frame = fly(linear(), dt, t_end)
    momentum, spin = run.system.at(run.state.t, run.state.q, run.state.v).momenta()
    torque = -np.array([push(t) for t in run.times]) * (80.0 + 8.0 * run["end"][:, 1])
    impulse = dt * (torque.sum() - torque[0] / 2)
    energy_ = run.total_energy[run.times > END + dt / 2]
    tip, other = (
        float(np.abs(x["end"][:: (len(x.times) - 1) // (len(run.times) - 1)] - run["end"]).max()) for x in (fine, frame)
    )
    demo.say(f"a linear beam in a floating frame: {other:.3g} m from it; half step and cells: {tip:.2g} m")
    checks = [
        demo.Check.relative("momentum is the impulse of the force", momentum[0], 8.0 * END, 1e-9),
        demo.Check("momentum across it", momentum[1], 0.0, 1e-9),
        demo.Check.relative("angular momentum is the impulse of force and couple", spin[0], impulse, 5e-4),
        demo.Check("energy in free flight, relative", float(np.ptp(energy_) / energy_.mean()), 0.0, 1e-3),
        demo.Check("ends against half the step and half the cells (m)", tip, 0.0, 2e-3 * L),
        demo.Check("the linear frame is off by more than a metre", float(other > 1.0), 1.0, 0.0),
    ]
    if args.picture:
        from fmbd_fenicsx.faces.plot import plot_curves

        order, rows = np.argsort(run["nodes"][0, 0::3]), np.linspace(0, len(run.times) - 1, 6).astype(int)
        shapes = {f"t = {run.times[k]:.2g} s": run["nodes"][k].reshape(-1, 3)[order, :2].T for k in rows}
        plot_curves(shapes, args.picture, ("x (m)", "y (m)"))
    demo.finish(checks, run, args)


if __name__ == "__main__":
    main()
