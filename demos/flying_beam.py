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
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

L, EA, GA, EI, RHO_A, RHO_I = 10.0, 1e4, 1e4, 1e2, 1.0, 10.0  # m, N, N, N m^2, kg/m, kg m
ANGLE, DIRECTION, END = -atan2(4.0, 3.0), np.array([0.6, -0.8]), 2.5  # rad, -, s: until then the beam is pushed
SECTION = fmbd.Section(EA=EA, EI=EI, GA=GA, rhoA=RHO_A, rhoI=RHO_I)


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
    start = lambda s: [s * DIRECTION[0], s * DIRECTION[1], 0 * s + ANGLE]
    return fmbd.LineBody("beam", L, mass, energy, start=start, cells=cells)


def push(t):
    """1, 0 after END, and half way at the jump, so that sums over steps give the exact impulse."""
    return 1.0 if t < END - 1e-9 else 0.5 if t < END + 1e-9 else 0.0


def fly(beam, dt, t_end):
    """The run; not a line of it knows the formulation."""
    scene = fmbd.Scene("flying beam")
    scene.add(beam, fmbd.force("throw", beam.surface("end"), lambda t: (8.0 * push(t), 0.0)))
    scene.add(fmbd.torque("couple", beam.surface("end"), lambda t: -80.0 * push(t)))
    scene.sensor("end", fmbd.position(beam.surface("end")))
    scene.sensor("nodes", fmbd.coordinates(beam))
    return fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.GeneralizedAlpha(0.9), output=demo.snapshots(args))


args = demo.arguments(__doc__)
cells, dt, t_end = (8, 2e-2, 4.0) if args.fast else (20, 1e-2, 7.5)
run, fine = fly(exact(cells), dt, t_end), fly(exact(2 * cells), dt / 2, t_end)
frame = fly(fmbd.Beam("beam", (0.0, 0.0), L * DIRECTION, SECTION, attached=False), dt, t_end)  # linear strains
momentum, spin = run.momenta()
torque = -np.array([push(t) for t in run.times]) * (80.0 + 8.0 * run["end"][:, 1])
impulse = dt * (torque.sum() - torque[0] / 2)
free = run.total_energy[run.times > END + dt / 2]
tip, other = (np.abs(x["end"][:: round(run.dt / x.dt)] - run["end"]).max() for x in (fine, frame))
checks = [
    Check.relative("momentum is the impulse of the force", momentum[0], 8.0 * END, 1e-9),
    Check("momentum across it", momentum[1], 0.0, 1e-9),
    Check.relative("angular momentum is the impulse of force and couple", spin[0], impulse, 5e-4),
    Check("energy in free flight, relative", np.ptp(free) / free.mean(), 0.0, 1e-3),
    Check("ends against half the step and half the cells (m)", tip, 0.0, 2e-3 * L),
    Check.at_least("the linear frame is off by (m)", other, 1.0),
]
if args.picture:
    with plot.figure(args.picture, size=(9.0, 5.0), title=args.title) as axes:
        for x, look in ((fine, plot.REFERENCE), (run, {"color": "C0"})):
            rows = np.linspace(0, len(x.times) - 1, 6 if args.fast else 7).astype(int)
            places = x.scene.bodies["beam"].curve(x["nodes"][rows])[..., :2]
            lines = axes.plot(*places.transpose(2, 1, 0), **look)
            lines[0].set_label(f"h = {x.dt:g} s, {x.scene.bodies['beam'].cells} cells")
        for k, (row, place) in enumerate(zip(rows, places, strict=True)):
            shift = {"xytext": (4, 4) if k else (-26, -4), "textcoords": "offset points", "size": 9}
            axes.annotate(f"{run.times[row]:.3g} s", place[0], **shift)
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
demo.film(run, args, ["end"])
demo.finish(checks, run, args)
