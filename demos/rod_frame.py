"""Frames of rods: a right-angle frame kicked out of its plane, and a thin strip that buckles sideways.

Run:  ./with-dolfinx python3 demos/rod_frame.py [--fast] [--json FILE] [--picture FILE]

Right-angle frame: Simo and Vu-Quoc, doi:10.1016/0045-7825(88)90073-4; legs of 10 m, EA = GA = 1e6 N, EI = GJ = 1e3 N m^2, 1 kg/m,
rotary inertia (20, 10, 10) kg m, force across the plane at the elbow, 50 N at 1 s, over at 2 s.
Strip: doi:10.1007/s11044-016-9514-y; a cantilever of 1 m, pulled along its stiff direction by a crank and a link, offset 0.1 mm.
"""

import numpy as np
from rod_model import panels

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.post import demo

args = demo.arguments(__doc__)
LEG = fmbd.RodSection((1e6, 1e6, 1e6, 1e3, 1e3, 1e3), mass=1.0, inertia=(20, 10, 10))


def poses(system, q, rod):
    """Poses of the nodes of one rod."""
    first = system.frame_names.index(f"{rod.name}, node 1")
    return q[: system.n_frames * 7].reshape(-1, 7)[first : first + len(rod.nodes)]


def corner(elements):
    """Two legs, the first clamped."""
    inner = fmbd.Rod("inner", [(0, 0, 0), (10, 0, 0)], LEG, elements=elements)
    outer = fmbd.Rod("outer", [(10, 0, 0), (10, 10, 0)], LEG, elements=elements)
    scene = fmbd.Scene("right-angle frame", breakpoints=(1.0, 2.0))
    scene.add(inner, outer, fmbd.fixed("clamp", fmbd.ground, inner.surface("start")))
    scene.add(fmbd.fixed("elbow", inner.surface("end"), outer.surface("start")))
    kick = fmbd.forces.force("kick", inner.surface("end"), lambda t: (0, 0, max(50.0 * min(t, 2.0 - t), 0.0)))
    scene.add(kick)
    scene.sensor("elbow", fmbd.sensors.position(inner.surface("end")))
    scene.sensor("tip", fmbd.sensors.position(outer.surface("end")))
    return scene, (inner, outer)


def strip(elements):
    """Cantilever, link and crank; axes 2 and 3 of the strip along y and z, its stiff bending about y."""
    sections = {
        "strip": ((7.3e7, 5.025e6, 2.34e7, 877.2, 60830, 608.3), 2.68, (2.25533e-3, 2.233e-3, 2.233e-5)),
        "link": ((3.302e7, 1.081e7, 1.081e7, 914.5, 1189, 1189), 1.212, (8.73e-5, 4.365e-5, 4.365e-5)),
        "crank": ((1.321e8, 4.322e7, 4.322e7, 14630, 19020, 19020), 4.85, (1.3966e-3, 6.983e-4, 6.983e-4)),
    }
    d = 1e-4
    ends = {"strip": ((0, 0, 0), (1, 0, 0)), "link": ((1, d, 0), (1, d, -0.25)), "crank": ((1, d, -0.25), (1, d, -0.3))}
    count = {"strip": elements, "link": 1, "crank": 1}
    beam, link, crank = (
        fmbd.Rod(
            name,
            ends[name],
            fmbd.RodSection(*given),
            elements=count[name],
            normal=(0, 1, 0),
            stations={"middle": 0.5 * size},
        )
        for (name, given), size in zip(sections.items(), (1.0, 0.25, 0.05), strict=True)
    )
    scene = fmbd.Scene("lateral buckling", breakpoints=(0.4,))
    motor = fmbd.revolute("motor", fmbd.ground, crank.surface("end"), axis=(0, 1, 0))
    scene.add(beam, link, crank, motor, fmbd.fixed("clamp", fmbd.ground, beam.surface("start")))
    scene.add(fmbd.spherical("ball", beam.surface("end"), link.surface("start"), center=(1, d, 0)))
    scene.add(fmbd.revolute("pin", link.surface("end"), crank.surface("start"), axis=(0, 1, 0)))
    scene.add(
        fmbd.drive("turn", fmbd.angle(motor), lambda t: 0.5 * np.pi * (1 - np.cos(np.pi * np.minimum(t, 0.4) / 0.4)))
    )
    scene.sensor("middle", fmbd.sensors.position(beam.surface("middle")))
    scene.sensor("root", fmbd.sensors.section_forces(beam.surface("start")))
    return scene, (beam, link, crank)


def apart(name, runs):
    """Root mean square of the difference of two runs over that of the motion of the second."""
    a, b = (np.array([np.interp(runs[0].times, r.times, x) for x in r[name].T]).T for r in runs)
    return float(np.linalg.norm(a - b) / np.linalg.norm(b - b[0]))


t_end, h = (3.0, 0.02) if args.fast else (15.0, 0.02)
frames = [corner(n) for n in (2, 3)]
runs = [
    fmbd.solve(scene, t_end=t_end, dt=k, scheme=fmbd.GeneralizedAlpha(0.8), output=fmbd.Output(snapshots=4))
    for (scene, _), k in ((frames[0], h), (frames[0], h / 2), (frames[1], h / 2))
]
checks = [
    demo.Check("frame: tip, half of the step, 1", apart("tip", runs[:2]), 0.0, 0.02 if args.fast else 0.05),
    demo.Check("frame: tip, 3 elements a leg for 2, 1", apart("tip", runs[1:]), 0.0, 0.01 if args.fast else 0.05),
]
span = np.ptp(runs[2]["tip"][:, 2])
checks.append(demo.Check.at_least("frame: swing of the tip over the leg, 1", span / 10, 0.1))
energy = runs[2].total_energy[runs[2].times > 2.0]
checks.append(demo.Check("frame: energy lost after the kick, 1", 1 - energy[-1] / energy[0], 0.0, 0.02))

strips, k = [strip(n) for n in (4, 6)], 1e-3 if args.fast else 5e-4
until, kept, damped = 0.24 if args.fast else 0.4, fmbd.Output(snapshots=4), fmbd.GeneralizedAlpha(0.5)
buckled = [
    fmbd.solve(scene, t_end=until, dt=step, scheme=damped, output=kept)
    for (scene, _), step in zip(strips, (k, k / 2), strict=True)
]
aside = [np.abs(r["middle"][:, 1]).max() for r in buckled]
checks += [
    demo.Check.at_least("strip: sideways at mid span, m", float(aside[1]), 0.05),
    demo.Check("strip: middle, half of the step and 6 elements for 4, 1", apart("middle", buckled), 0.0, 0.05),
]

if args.picture:
    content = {}
    for title, run, rods in (
        ("right-angle frame", runs[2], frames[1][1]),
        ("buckling strip", buckled[1], strips[1][1]),
    ):
        shapes = [[(rod, poses(run.system, s.q, rod)) for rod in rods] for s in run.snapshots]
        content[title] = [shape for moment in shapes for shape in moment]
    panels(args.picture, content, args.title)
demo.finish(checks, runs[2], args)
