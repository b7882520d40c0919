"""An elastic cylinder rolls on a rigid plane under a load on its hub: Hertz pressure that travels through the mesh.

Run:  ./with-dolfinx python3 demos/rolling_cylinder.py     (also: ./with-dolfinx mpirun -n 2 python3 demos/rolling_cylinder.py)

    a^2 = 4 F R / (pi E*),   p0 = 2 F / (pi a),   rolling without sliding: v = -w R up to strains of order a / R

The body has a floating frame that turns with it; Coulomb friction holds the contact. The load grows slowly and the theta rule
damps vibrations, so each later instant is near the static solution, while contact nodes come and go. On a rigid plane sticking
friction changes the pressure unless the material is nearly incompressible (with nu = 0.3 it adds 3 % to the peak). The static
case is ``hertz.py``. Johnson, Contact Mechanics, doi:10.1017/CBO9781139171731.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import demo, plot
from fmbd_fenicsx.post.demo import Check

args = demo.arguments(__doc__, {"--cells": 10})
R, E, nu, rho, mu = 1.0, 1.0, 0.45, 0.01, 0.3
v0, grow, n = 0.01, 8.0, 6 if args.fast else args.cells  # m/s, s, cells per half width
a = 0.02 * R
F = np.pi * a**2 * E / (1 - nu**2) / (4 * R)
p0 = 2 * F / (np.pi * a)
t_end, down = grow + 2 * a / v0 * (1 if args.fast else 3), -np.pi / 2
span = {"start": down - 2 * a / R, "end": down + (v0 * t_end + 2 * a) / R}  # of the tread with fine cells

mesh = fmbd.read_gmsh("meshes/wheel.py", radius=R, **span, h=a / n, depth=2 * a, coarse=1.5 / n)
elastic, spin = fmbd.materials.linear_elastic(E, nu), -v0 / R
wheel = fmbd.FloatingBody(
    "wheel", mesh, degree=1, density=rho, elastic=elastic, velocity=(v0, 0.0), angular_velocity=spin
)
ground = fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, -R), (0.0, 1.0)))
pair, hub = fmbd.contact("tread", wheel.surface("tread"), ground, friction=mu, search=0.1 * a), wheel.surface("hub")
scene = fmbd.Scene("rolling cylinder")
scene.add(wheel, pair)
scene.add(fmbd.force("load", hub, lambda t: (0.0, -F * np.sin(0.5 * np.pi * min(t / grow, 1.0)) ** 2)))
scene.sensor("pressure", fmbd.contact_pressure(pair))
scene.sensor("hub", fmbd.position(hub))
scene.sensor("angle", fmbd.rotation(hub))
scheme, dt = fmbd.ContactMidpoint(theta=1.0), 0.5 * a / n / v0  # half a cell a step
run = fmbd.solve(scene, t_end=t_end, dt=dt, scheme=scheme, output=demo.snapshots(args))

X = run.system.contacts.traces[0].X
s = R * (np.arctan2(X[:, 1], X[:, 0]) - down)  # arc coordinate of the contact nodes
late = np.flatnonzero(run.times > grow + 0.3 * (t_end - grow))
fits = []
for p in run["pressure"][late]:
    on = p > 0.5 * p.max()
    c2, c1, c0 = np.polyfit(s[on], p[on] ** 2, 2)  # p^2 = p0^2 (1 - (s - s_c)^2 / a^2)
    top = c0 - c1**2 / (4 * c2)
    fits.append((np.sqrt(top), np.sqrt(-top / c2), -c1 / (2 * c2)))
peak, width, place = np.array(fits).T
travel, turned, c = np.ptp(run["hub"][late, 0]), R * np.ptp(run["angle"][late, 0]), run.counters
checks = [
    Check.relative("half width, mean over the roll, m", width.mean(), a, 0.02),
    Check.relative("peak pressure, mean over the roll, N/m^2", peak.mean(), p0, 0.02),
    Check("peak pressure, largest deviation from its mean, relative", np.abs(peak / peak.mean() - 1).max(), 0.0, 0.05),
    Check("way of the contact along the tread less R angle, in cells", (np.ptp(place) - turned) * n / a, 0.0, 0.5),
    Check("way of the hub less R angle, in cells", (travel - turned) * n / a, 0.0, 0.5),
    Check("Newton iterations per step in contact", c["contact_newton_iterations"] / c["contact_steps"], 0.0, 6.0),
]
if args.picture:
    order, around = np.argsort(s), np.linspace(-1, 1, 201)
    with plot.figure(args.picture, title=args.title) as axes:
        for k in np.linspace(0, len(late) - 1, 3).astype(int):
            found = run["pressure"][late[k]][order] / p0
            axes.plot(place[k] / a + around, np.sqrt(1 - around**2), **plot.REFERENCE)
            axes.plot(s[order][found > 0] / a, found[found > 0], "o", ms=4, label=f"t = {run.times[late[k]]:.1f} s")
        axes.lines[0].set_label("Hertz")
        axes.set(xlabel="way along the tread / a", ylabel="pressure / p$_0$")
demo.finish(checks, run, args)
