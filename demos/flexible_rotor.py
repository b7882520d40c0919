"""A flexible rotor runs through its critical speed: a tube of 6 m with an eccentric disc at mid span, under its weight.

Run:  ./with-dolfinx python3 demos/flexible_rotor.py [--fast] [--json FILE] [--picture FILE] [--animate FILE]

Data: doi:10.1007/s11044-016-9514-y. Both ends held against tilting; the left one is turned with 48 rad/s until 1 s and with
72 rad/s after 1.25 s. Reference: Timoshenko elements with exact shape functions, 64 of them: critical speed 56.8534 rad/s
without eccentricity, sag 3.309816 mm.
"""

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post import demo

args = demo.arguments(__doc__)
AREA, MOMENT = np.pi * (0.05**2 - 0.045**2), np.pi / 4 * (0.05**4 - 0.045**4)
circle = 0.05 * np.array([(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 16, endpoint=False)])
tube = fmbd.RodSection(
    (3.134e8, 6.05e7, 6.05e7, 2.727e5, 3.545e5, 3.545e5),
    7800 * AREA,
    7800 * MOMENT * np.array([2, 1, 1]),
    outline=circle,
)
DISC, RADIUS, WIDTH = 70.573, 0.24, 0.05


def angle(t):
    """rad: speed 48 rad/s after 0.5 s, 72 rad/s after 1.25 s, both approached by a cosine."""

    def ramp(t, start, end):
        s, T = np.clip(t - start, 0.0, end - start), end - start
        return 0.5 * (s - T / np.pi * np.sin(np.pi * s / T)) + np.maximum(t - end, 0.0)

    return 48.0 * ramp(t, 0.0, 0.5) + 24.0 * ramp(t, 1.0, 1.25)


def rotor(elements, offset, gravity=9.81, spinning=True):
    """Shaft, disc and bearings; the disc's centre lies ``offset`` (m) from the axis."""
    shaft = fmbd.Rod("shaft", [(0, 0, 0), (6, 0, 0)], tube, elements=elements, stations={"middle": 3.0})
    across = DISC * (3 * RADIUS**2 + WIDTH**2) / 12
    disc = fmbd.RigidBody("disc", DISC, (0.5 * DISC * RADIUS**2, across, across), position=(3, 0, offset),
                          shape=fmbd.contacts.Cylinder(RADIUS, (1, 0, 0), length=WIDTH))  # fmt: skip
    bearing = fmbd.revolute("bearing", fmbd.ground, shaft.surface("start"), axis=(1, 0, 0))
    scene = fmbd.Scene("rotor", gravity=(0, 0, -gravity), breakpoints=(0.5, 1.0, 1.25))
    scene.add(shaft, disc, bearing, fmbd.fixed("hub", shaft.surface("middle"), disc, center=(3, 0, 0)))
    scene.add(fmbd.cylindrical("guide", fmbd.ground, shaft.surface("end"), axis=(1, 0, 0)))
    scene.add(fmbd.drive("motor", fmbd.angle(bearing), angle if spinning else lambda t: 0.0 * t))
    scene.sensor("middle", fmbd.sensors.position(shaft.surface("middle")))
    scene.sensor("root", fmbd.sensors.section_forces(shaft.surface("start")))
    return scene, shaft


still, _ = rotor(8, 0.0, spinning=False)
sag = -fmbd.equilibrium(still)["middle"][2]
unloaded, _ = rotor(8, 0.0, gravity=0.0, spinning=False)
first = fmbd.modes(unloaded, 2).frequencies * 2 * np.pi
checks = [
    demo.Check.relative("static sag at mid span, m", sag, 3.309816e-3, 1e-3),
    demo.Check.relative("critical speed, rad/s", first[0], 56.8534, 1e-3),
    demo.Check("two equal bending modes, 1", first[1] / first[0] - 1, 0.0, 1e-9),
]

t_end = 1.5 if args.fast else 2.5
scene, _ = rotor(2 if args.fast else 4, 0.05)
runs = [
    fmbd.solve(scene, t_end=t_end, dt=h, scheme=fmbd.GeneralizedAlpha(0.8), output=demo.snapshots(args, 150))
    for h in (2e-3, 1e-3)
]
run = runs[-1]
swing = [np.linalg.norm(r["middle"][:, 1:], axis=1) for r in runs]
largest = [float(x.max()) for x in swing]
checks.append(demo.Check.relative("largest swing with half of the step, m", largest[1], largest[0], 0.05))
when = float(run.times[swing[1].argmax()])
checks.append(demo.Check.at_least("largest swing after the speed has passed the critical one, s", when, 1.0))

if args.picture:
    run.plot("middle y", "middle z", "root M2", file=args.picture)
demo.film(run, args, ["middle y", "middle z"])
demo.finish(checks, run, args)
