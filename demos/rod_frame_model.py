"""Frames of rods and what they are compared with; used by ``rod_frame.py``.

Right-angle frame: Simo and Vu-Quoc, doi:10.1016/0045-7825(88)90073-4; legs of 10 m, EA = GA = 1e6 N, EI = GJ = 1e3 N m^2, 1 kg/m,
rotary inertia (20, 10, 10) kg m, force across the plane at the elbow, 50 N at 1 s, over at 2 s.
Strip and four-bar: doi:10.1007/s11044-016-9514-y.
"""

import numpy as np

import fmbd_fenicsx as fmbd

LEG = fmbd.RodSection((1e6, 1e6, 1e6, 1e3, 1e3, 1e3), mass=1.0, inertia=(20, 10, 10))


def poses(system, q, rod):
    """Poses of the nodes of one rod."""
    first = system.frame_names.index(f"{rod.name}, node 1")
    return system.frame_poses(q)[first : first + len(rod.nodes)]


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


def strip(elements, solid=None):
    """Cantilever, link and crank; axes 2 and 3 of the strip along y and z, its stiff bending about y.

    ``solid``: a body with surfaces "left" and "right" in the place of the strip.
    """
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
    if solid is None:
        start, end, middle = (beam.surface(place) for place in ("start", "end", "middle"))
        where = fmbd.sensors.position(middle)
    else:
        beam, start, end = solid, solid.surface("left"), solid.surface("right")
        where = fmbd.sensors.position(solid, point=(0.5, 0, 0))

    scene = fmbd.Scene("lateral buckling", breakpoints=(0.4,))
    motor = fmbd.revolute("motor", fmbd.ground, crank.surface("end"), axis=(0, 1, 0))
    scene.add(beam, link, crank, motor, fmbd.fixed("clamp", fmbd.ground, start))
    scene.add(fmbd.spherical("ball", end, link.surface("start"), center=(1, d, 0)))
    scene.add(fmbd.revolute("pin", link.surface("end"), crank.surface("start"), axis=(0, 1, 0)))
    scene.add(
        fmbd.drive("turn", fmbd.angle(motor), lambda t: 0.5 * np.pi * (1 - np.cos(np.pi * np.minimum(t, 0.4) / 0.4)))
    )
    scene.sensor("middle", where)
    scene.sensor("tip", fmbd.sensors.position(end))
    scene.sensor("torque", fmbd.sensors.reaction("turn"))
    return scene, (beam, link, crank)


BARS = {"crank": ((0, 0, 0), (0, 0.12, 0), 0.016), "coupler": ((0, 0.12, 0), (0.24, 0.12, 0), 0.016),
        "rocker": ((0.24, 0.12, 0), (0.24, 0, 0), 0.008)}  # fmt: skip
STEEL = {"youngs_modulus": 207e9, "poisson_ratio": 0.3, "density": 7800.0}


def bar(name, solid):
    """A square bar as a rod, or as a solid with 8 modes beside those of its ends."""
    start, end, side = BARS[name]
    if not solid:
        return fmbd.Rod(name, [start, end], fmbd.RodSection.rectangle(**STEEL, width=side, height=side), elements=3)
    along = np.subtract(end, start)
    mesh = fmbd.read_gmsh("meshes/rod.py", dim=3, length=float(np.linalg.norm(along)), height=side, h=0.7 * side)
    law = fmbd.materials.linear_elastic(STEEL["youngs_modulus"], STEEL["poisson_ratio"])
    angle = 0.5 * float(np.arctan2(along[1], along[0]))
    there = mesh.placed(start, (0, 0, np.sin(angle), np.cos(angle)))
    body = fmbd.FloatingBody(name, there, degree=2, density=STEEL["density"], elastic=law)
    return body.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 8))


def four_bar(solid):
    """Crank, coupler and rocker; the hinge between the last two is turned by 5 degrees, so that the bars must bend."""
    crank, coupler, rocker = (bar(name, solid) for name in BARS)
    start, end = ("pin", "tip") if solid else ("start", "end")
    tilted = (np.sin(np.radians(5)), 0, np.cos(np.radians(5)))
    scene = fmbd.Scene("four-bar")
    scene.add(
        crank, coupler, rocker, fmbd.revolute("B", crank.surface(end), coupler.surface(start), center=(0, 0.12, 0))
    )
    motor = fmbd.revolute("A", fmbd.ground, crank.surface(start), center=(0, 0, 0))
    scene.add(motor, fmbd.drive("turn", fmbd.angle(motor), lambda t: 0.6 * t))
    scene.add(fmbd.revolute("C", coupler.surface(end), rocker.surface(start), center=(0.24, 0.12, 0), axis=tilted))
    scene.add(fmbd.revolute("D", rocker.surface(end), fmbd.ground, center=(0.24, 0, 0)))
    scene.sensor("C", fmbd.sensors.position(coupler.surface(end)))
    scene.sensor("torque", fmbd.sensors.reaction("turn"))
    return scene, (crank, coupler, rocker)
