"""Rods in equilibrium against exact solutions: circle, helix, composite and twisted beam, Princeton beam, objectivity.

Run:  ./with-dolfinx python3 demos/rod_static.py [--fast] [--json FILE] [--picture FILE]

Circle and helix: L = 10 m, EI = GJ = 100 N m^2, end moment 2 pi EI / L, or force 50 N and moment 200 pi N m along z (ten turns).
Composite and twisted beam: Wang et al., doi:10.1002/we.2101. Princeton beam: doi:10.1007/s11044-016-9514-y, by shooting.
"""

import numpy as np
from rod_model import panels
from rod_references import COMPOSITE, COMPOSITE_TIP, HELIX, PRINCETON, TWISTED, TWISTED_TIP

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post.demo import Check, arguments, finish
from fmbd_fenicsx.rotations import quaternion_exp, quaternion_matrix, quaternion_product

args = arguments(__doc__)
plain = fmbd.RodSection((1e4, 1e4, 1e4, 100, 100, 100), mass=1.0, inertia=(2, 1, 1))


def solved(section, length, n, degree=3, *, force=(0, 0, 0), torque=(0, 0, 0), stops=(1.0,), first=0.25, twist=None):
    """A straight cantilever under force and torque at its end, in proportion to the load factors ``stops``."""
    rod = fmbd.Rod("rod", [(0, 0, 0), (length, 0, 0)], section, elements=n, degree=degree, twist=twist)
    scene = fmbd.Scene("cantilever")
    scene.add(rod, fmbd.fixed("clamp", fmbd.ground, rod.surface("start")))
    scene.add(fmbd.forces.force("F", rod.surface("end"), lambda f: f * np.asarray(force)))
    scene.add(fmbd.forces.torque("M", rod.surface("end"), lambda f: f * np.asarray(torque)))
    scene.sensor("tip", fmbd.sensors.position(rod.surface("end")))
    return rod, fmbd.equilibrium(scene, path=fmbd.LoadSteps(stops, first))


checks = []
for degree in (1, 2, 3):
    counts = (8, 16) if args.fast or degree < 3 else (16, 32, 64)
    error = []
    for n in counts:
        _, found = solved(plain, 10.0, n, degree, torque=(0, 0, 20 * np.pi), stops=(0.5, 1.0))
        error.append(np.linalg.norm(found["tip"]))
    order = float(np.log2(error[0] / error[1]))
    checks.append(Check(f"circle: order in the tip, degree {degree}", order, 2 * degree, 0.15 if degree > 1 else 0.4))
checks.append(Check("circle closed, degree 3, m", error[-1], 0.0, 1e-5 if args.fast else 1e-10))

for name, C, F, phi, reference in (
    ("composite", COMPOSITE, (0, 0, 150.0), None, COMPOSITE_TIP),
    ("twisted", TWISTED, (0, 0, -4e6), lambda s: 0.05 * np.pi * s, TWISTED_TIP),
):
    _, found = solved(fmbd.RodSection(C, 1.0, (1, 1, 1)), 10.0, 8 if args.fast else 32, force=F, twist=phi)
    error = np.abs(found["tip"] - (10, 0, 0) - reference).max() / 10
    checks.append(Check(f"{name} beam, tip over length, 1", error, 0.0, 1e-7 if args.fast else 1e-9))

strip, worst = fmbd.RodSection((2.84191e6, 6.40131e5, 9.03881e5, 3.10338, 36.2794, 2.42873), 1.0, (1, 1, 1)), 0.0
for load, angle, *reference in PRINCETON[:: 20 if args.fast else 1]:
    F = load * np.array([0, np.sin(np.radians(angle)), np.cos(np.radians(angle))])
    _, found = solved(strip, 0.508, 8, force=F)
    worst = max(worst, np.abs(found["tip"] - (0.508, 0, 0) - reference).max())
checks.append(Check("Princeton beam, all angles and loads, m", worst, 0.0, 1e-8))

rows = [row for row in HELIX if row[0] <= (0.1 if args.fast else 1.0)]
stops = tuple(row[0] for row in rows)
ends = {"force": (0, 0, 50.0), "torque": (0, 0, 200 * np.pi)}
spring, helix = solved(plain, 10.0, 24 if args.fast else 80, **ends, stops=stops, first=2e-3)
error = np.linalg.norm(helix.path.series["tip"][1:] - [row[1:] for row in rows], axis=1).max()
checks.append(Check(f"helix to {stops[-1] * 10:g} turns, m", error, 0.0, 1e-6 if args.fast else 1e-5))

shapes = [helix.system.frame_poses(point.q) for point in helix.path.points[1:]]
pose, rng, e = shapes[stops.index(0.1)], np.random.default_rng(0), helix.system.elements[0]
before = e.strains(pose)
for _ in range(100):
    axis = rng.normal(size=3)
    turn = quaternion_exp(rng.uniform(0, 40 * np.pi) * axis / np.linalg.norm(axis))
    pose = np.concatenate((pose[:, :3] @ quaternion_matrix(turn).T, quaternion_product(turn, pose[:, 3:])), axis=1)
checks.append(Check("strain by 100 superposed rotations, 1", np.abs(e.strains(pose) - before).max(), 0.0, 1e-12))

if args.picture:
    rolled, circle = solved(plain, 10.0, 16, torque=(0, 0, 20 * np.pi), stops=(0.25, 0.5, 0.75, 1.0))
    panels(args.picture, {
        "end moment: 1/4 to 4/4 of a circle": [(rolled, circle.system.frame_poses(p.q)) for p in circle.path.points[1:]],
        "helix: 1/4, 1/2, 1 turn": [(spring, shapes[stops.index(f)]) for f in (0.025, 0.05, 0.1)],
    }, args.title)  # fmt: skip
finish(checks, None, args)
