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
from fmbd_fenicsx import demo
from fmbd_fenicsx.faces.demo import Check

args = demo.arguments(__doc__, {"--cells": 10})
R, E, nu, rho, mu = 1.0, 1.0, 0.45, 0.01, 0.3
n = 6 if args.fast else args.cells
a = 0.02 * R
F = np.pi * a**2 * E / (1 - nu**2) / (4 * R)
p0 = 2 * F / (np.pi * a)
v0, grow = 0.01, 8.0  # m/s, s
dt = 0.5 * a / n / v0  # half a cell a step
t_end = grow + 2 * a / v0 * (1 if args.fast else 3)

down, roll = -np.pi / 2, v0 * t_end / R
mesh = fmbd.read_gmsh(
    "meshes/wheel.py",
    radius=R,
    start=down - 2 * a / R,
    end=down + roll + 2 * a / R,
    h=a / n,
    depth=2 * a,
    coarse=1.5 / n,
)
wheel = fmbd.FloatingBody(
    "wheel", mesh, degree=1, density=rho, elastic=fmbd.materials.linear_elastic(E, nu), velocity=(v0, 0.0),
    angular_velocity=-v0 / R,
)  # fmt: skip
ground = fmbd.Obstacle("ground", fmbd.HalfSpace((0.0, -R), (0.0, 1.0)))
pair = fmbd.contact("tread", wheel.surface("tread"), ground, friction=mu, search=0.1 * a)
scene = fmbd.Scene("rolling cylinder")
scene.add(wheel, pair)
scene.add(fmbd.force("load", wheel.surface("hub"), lambda t: (0.0, -F * np.sin(0.5 * np.pi * min(t / grow, 1.0)) ** 2)))
scene.sensor("force", fmbd.contact_force(pair))
scene.sensor("pressure", fmbd.contact_pressure(pair))
scene.sensor("hub", fmbd.position(wheel.surface("hub")))
scene.sensor("angle", fmbd.rotation(wheel.surface("hub")))
run = fmbd.solve(scene, t_end=t_end, dt=dt, scheme=fmbd.ContactMidpoint(theta=1.0))
fmbd.say(run.report())

trace = run.system.contacts.traces[0]
s = R * (np.arctan2(trace.X[:, 1], trace.X[:, 0]) - down)  # arc coordinate of the contact nodes
late = np.flatnonzero(run.times > grow + 0.3 * (t_end - grow))
fits = []
for p in run["pressure"][late]:
    on = p > 0.5 * p.max()
    c2, c1, c0 = np.polyfit(s[on], p[on] ** 2, 2)  # p^2 = p0^2 (1 - (s - s_c)^2 / a^2)
    peak2 = c0 - c1**2 / (4 * c2)
    fits.append((np.sqrt(peak2), np.sqrt(-peak2 / c2), -c1 / (2 * c2)))
peak, width, place = np.array(fits).T
travel, turned = (float(np.ptp(run[name][late].reshape(len(late), -1)[:, 0])) for name in ("hub", "angle"))
steps = run.counters["contact_steps"]
checks = [
    Check.relative("half width, mean over the roll, m", float(width.mean()), a, 0.02),
    Check.relative("peak pressure, mean over the roll, N/m^2", float(peak.mean()), p0, 0.02),
    Check(
        "peak pressure, largest deviation from its mean, relative",
        float(np.abs(peak / peak.mean() - 1).max()),
        0.0,
        0.05,
    ),
    Check(
        "way of the contact along the tread less R angle, in cells", float(np.ptp(place) - R * turned) * n / a, 0.0, 0.5
    ),
    Check("way of the hub less R angle, in cells", (travel - R * turned) * n / a, 0.0, 0.5),
    Check("Newton iterations per step in contact", run.counters["contact_newton_iterations"] / steps, 0.0, 6.0),
]
if args.picture:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.add_subplot(
        xlabel="way along the tread / a", ylabel="p / p0", title="Pressure on the tread while it rolls"
    )
    order = np.argsort(s)
    for k, color in zip(late[:: len(late) // 4], ("C0", "C1", "C2", "C3", "C4"), strict=False):
        axes.plot(
            s[order] / a, run["pressure"][k][order] / p0, "o-", color=color, ms=3, lw=0.5, label=f"{run.times[k]:.1f} s"
        )
        around = np.linspace(-1, 1, 201)
        axes.plot(np.interp(k, late, place) / a + around, np.sqrt(1 - around**2), "k-", lw=0.8)
    axes.legend()
    if fmbd.log.world_rank() == 0:
        figure.savefig(args.picture, dpi=150)
demo.finish(checks, run, args)
