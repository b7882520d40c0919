"""More calls with a tolerance: other materials, lengths, units, loads and schemes than those of :mod:`tolerance_scenes`."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from tolerance_scenes import EXACT, MESHES, Case, finer, rise

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import relative as share
from fmbd_fenicsx.materials import linear_elastic, plane_stress


def bar(name: str, *, dim: int = 2, h: float, height: float, length: float = 1.0, law: Any, **more: Any) -> Any:
    """A straight bar of finite elements."""
    mesh = fmbd.read_gmsh(MESHES / "rod.py", dim=dim, h=h, height=height, length=length)
    return fmbd.FloatingBody(name, mesh, elastic=law, **more)


def springs_in_millimetres() -> fmbd.Scene:
    """Two masses on springs with a damper, in tonnes, millimetres and newtons, pulled by a force of 11 rad/s."""
    scene, last = fmbd.Scene("springs in mm"), fmbd.ground
    for k in range(2):
        block = fmbd.RigidBody(f"block {k}", 2e-3, 1.0, (100.0 * (k + 1), 0.0))
        scene.add(block, fmbd.prismatic(f"rail {k}", fmbd.ground, block, axis=(1, 0), center=(0, 0)))
        scene.add(fmbd.Spring(f"spring {k}", last, block, stiffness=1.5, damping=2e-3, length=100.0))
        last = block
    scene.add(fmbd.force("pull", last, lambda t: (20.0 * np.sin(11.0 * t), 0.0)))
    scene.sensor("end", fmbd.position(last))
    scene.sensor("speed", fmbd.velocity(last))
    return scene


def of_springs(case: Case, times: Any) -> Any:
    """The same as four equations of first order."""

    def rate(t: float, y: Any) -> Any:
        x, v = y[:2], y[2:]
        first = 1.5 * x[0] + 2e-3 * v[0]
        second = 1.5 * (x[1] - x[0]) + 2e-3 * (v[1] - v[0])
        return [*v, (second - first) / 2e-3, (20.0 * np.sin(11.0 * t) - second) / 2e-3]

    x = solve_ivp(rate, [0, case.t_end], np.zeros(4), "DOP853", t_eval=times, rtol=1e-11, atol=1e-12).y[1]
    return np.stack((200.0 + x, 0.0 * x), axis=1)


def four_bar() -> fmbd.Scene:
    """A four-bar linkage in the plane, its crank brought to 4 rad/s within a second."""
    joints = ((0.0, 0.0), (0.3, 0.4), (1.5, 0.9), (1.2, 0.0))
    scene, up, last = fmbd.Scene("four bar", gravity=(0.0, -9.81)), rise(1.0), fmbd.ground
    for k, (a, b) in enumerate(zip(joints[:-1], joints[1:], strict=True)):
        middle, length = 0.5 * np.add(a, b), float(np.hypot(*np.subtract(b, a)))
        link = fmbd.RigidBody(f"link {k}", 2.0 * length, 2.0 * length**3 / 12, tuple(middle))
        scene.add(link, fmbd.revolute(f"pin {k}", last, link, center=a))
        last = link
    scene.add(fmbd.revolute("pin 3", last, fmbd.ground, center=joints[3]))
    crank = scene.bodies["link 0"]
    scene.add(fmbd.torque("drive", crank, lambda t: 12.0 * up(t)))
    scene.sensor("coupler", fmbd.position(scene.bodies["link 1"]))
    scene.sensor("bearing", fmbd.reaction("pin 3"))
    return scene


def spatial_chain() -> fmbd.Scene:
    """Three bodies on spherical joints fall from the horizontal, with a spring across."""
    scene, last = fmbd.Scene("spatial chain", gravity=(0, 0, -9.81)), fmbd.ground
    for k in range(3):
        link = fmbd.RigidBody(f"link {k}", 1.0, (0.02, 0.09, 0.1), (k + 0.5, 0.0, 0.0))
        scene.add(link, fmbd.spherical(f"ball {k}", last, link, center=(float(k), 0, 0)))
        last = link
    scene.add(
        fmbd.Spring("across", fmbd.ground, last, point_a=(2.0, 1.5, 0.0), stiffness=20.0, damping=0.5, length=1.0)
    )
    scene.sensor("end", fmbd.position(last))
    return scene


def bouncing_on_spring() -> fmbd.Scene:
    """A ball with e = 0.6 falls by 20 cm onto a floor."""
    ball = fmbd.RigidBody("ball", 0.3, 1e-4, position=(0.0, 0.25))
    floor = fmbd.contact(
        "floor", fmbd.ball(ball, 0.05), fmbd.Obstacle("floor", fmbd.HalfSpace((0, 0), (0, 1))), restitution=0.6
    )
    scene = fmbd.Scene("bouncing", gravity=(0, -9.81))
    scene.add(ball, floor)
    scene.add(fmbd.force("wind", ball, lambda t: (0.2 * np.sin(7.0 * t), 0.0)))
    scene.sensor("ball", fmbd.position(ball))
    return scene


def rebounds(case: Case, times: Any) -> Any:
    """Parabolas between impacts, and the wind across."""
    g, speed = 9.81, np.sqrt(2 * 9.81 * 0.2)
    y, begin, up = np.zeros_like(times), -speed / g, speed  # as if it had been thrown up from the floor
    for _ in range(40):
        there = times >= begin - 1e-15
        t = times - begin
        y = np.where(there, up * t - 0.5 * g * t * t, y)
        begin, up = begin + 2 * up / g, 0.6 * up
    across = 0.2 / 0.3 * (times / 7.0 - np.sin(7.0 * times) / 49.0)
    return np.stack((across, 0.05 + y), axis=1)


def copper_arm() -> fmbd.Scene:
    """A copper strip of 0.4 m, clamped on a shaft that turns by a quarter of a radian and back."""
    strip = bar("strip", h=0.1, height=0.02, length=0.4, law=plane_stress(1.2e11, 0.34), density=8900.0, degree=2)
    scene = fmbd.Scene("copper arm")
    hub = fmbd.RigidBody("hub", mass=0.1, inertia=1e-3, position=(0.0, 0.0))
    scene.add(strip, hub, fmbd.revolute("shaft", fmbd.ground, hub, center=(0, 0)))
    scene.add(fmbd.fixed("clamp", hub, strip.surface("pin")))
    scene.add(fmbd.drive_rotation("turn", fmbd.ground, hub, lambda t: 0.25 * np.sin(np.pi * rise(0.2)(t)) ** 2))
    scene.sensor("tip", fmbd.position(strip.surface("tip")))
    return scene


def frame_of_beams() -> fmbd.Scene:
    """A beam of aluminium on two supports, a load in its middle that swings."""
    section = fmbd.Section.rectangle(youngs_modulus=7e10, poisson_ratio=0.33, density=2700.0, width=0.05, height=0.02)
    left = fmbd.Beam("left", (0.0, 0.0), (1.5, 0.0), section, elements=1, stiffness_damping=1e-4)
    right = fmbd.Beam("right", (1.5, 0.0), (3.0, 0.0), section, elements=1, stiffness_damping=1e-4)
    scene, up = fmbd.Scene("frame"), rise(0.3)
    scene.add(left, right, fmbd.fixed("middle", left.surface("end"), right.surface("start")))
    scene.add(fmbd.revolute("support", fmbd.ground, left.surface("start"), center=(0, 0)))
    scene.add(fmbd.Spring("foot", right.surface("end"), fmbd.ground, point_b=(3.0, -1.0), stiffness=5e4, length=1.0))
    scene.add(fmbd.force("load", left.surface("end"), lambda t: (0.0, -300.0 * up(t))))
    scene.sensor("middle", fmbd.position(left.surface("end")))
    scene.sensor("support", fmbd.reaction("support"))
    return scene


def hanging_rubber() -> fmbd.Scene:
    """A block of soft plastics under its weight, moved as a whole on its upper side."""
    mesh = fmbd.read_gmsh(MESHES / "block.py", size=(0.1, 0.3), counts=(1, 3), origin=(0.0, 0.0))
    block = fmbd.AbsoluteBody("block", mesh, density=1200.0, elastic=linear_elastic(3e6, 0.4), stiffness_damping=2e-3)
    scene = fmbd.Scene("hanging block", gravity=(0.0, -9.81), gravity_ramp=0.15)
    scene.add(block, fmbd.fixed("above", fmbd.ground, block.surface("top")))
    scene.sensor("below", fmbd.position(block.surface("bottom")))
    return scene


def steel_cable() -> fmbd.Scene:
    """A geometrically exact rod in the plane of x and z, hinged at both ends, sags as its weight comes."""
    section = fmbd.RodSection((4e5, 1.5e5, 1.5e5, 5.0, 8.0, 8.0), 0.8, (1e-3, 5e-4, 5e-4))
    rod = fmbd.Rod("cable", [(0, 0, 0), (2, 0, 0)], section, elements=4, degree=2)
    scene = fmbd.Scene("cable", gravity=(0.0, 0.0, -9.81), gravity_ramp=0.5)
    scene.add(rod, fmbd.spherical("left", fmbd.ground, rod.surface("start"), center=(0, 0, 0)))
    scene.add(fmbd.force("right", rod.surface("end"), lambda t: (4.0 * rise(0.5)(t), 0.0, 6.0 * rise(0.5)(t))))
    scene.sensor("end", fmbd.position(rod.surface("end")))
    return scene


def modal_door() -> fmbd.Scene:
    """A reduced plate strip on a hinge, pushed at its free edge."""
    body = bar("door", h=0.2, height=0.08, length=0.8, law=linear_elastic(2e8, 0.25), density=700.0, degree=2)
    door = body.reduced(modes=2)
    scene, up = fmbd.Scene("door"), rise(0.2)
    scene.add(door, fmbd.revolute("hinge", fmbd.ground, door.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("push", door.surface("tip"), lambda t: (0.0, 15.0 * up(t))))
    scene.sensor("edge", fmbd.position(door.surface("tip")))
    return scene


def kicked() -> fmbd.Scene:
    """A bar on a pin that is kicked after 0.3 s, with break points."""
    rod = bar("rod", h=0.25, height=0.1, law=linear_elastic(5e8, 0.3), density=1000.0, stiffness_damping=1e-3)
    scene = fmbd.Scene("kicked", breakpoints=(0.3, 0.304))
    scene.add(rod, fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0)))
    scene.add(fmbd.force("kick", rod.surface("tip"), lambda t: (0.0, 300.0 if 0.3 < t < 0.304 else 0.0)))
    scene.sensor("tip", fmbd.position(rod.surface("tip")))
    return scene


def fine(factor: float, meshes: int = 0, **more: Any) -> Any:
    """A reference by steps that are a ``factor`` smaller than a hundredth of the run, in meshes finer by some levels."""
    return lambda case, times: finer(meshes, dt=case.t_end / (100.0 * factor), **more)(case, times)


MORE = {
    "springs in millimetres": Case(springs_in_millimetres, 2.0, "end", (share(1e-2), share(2e-4)), of_springs),
    "the same, BDF": Case(springs_in_millimetres, 2.0, "end", (2.0, 1e-2), of_springs, {"scheme": fmbd.BDF()}),
    "the same, energy-momentum": Case(
        springs_in_millimetres, 2.0, "end", (5.0, 0.2), of_springs, {"scheme": fmbd.EnergyMomentum()}
    ),
    "four bar": Case(
        four_bar, 1.5, "coupler", (1e-2, 5e-4), finer(0, scheme=EXACT), {}, {"bearing": share(5e-2)}
    ),
    "four bar, Rattle": Case(four_bar, 1.5, "coupler", (1e-2, 1e-3), finer(0, scheme=EXACT), {"scheme": fmbd.Rattle()}),
    "four bar, half-explicit": Case(
        four_bar, 1.5, "coupler", (1e-3, 1e-5), finer(0, scheme=EXACT), {"scheme": fmbd.HalfExplicit()}
    ),
    "spatial chain": Case(spatial_chain, 1.0, "end", (share(1e-2), share(1e-3)), finer(0, scheme=EXACT)),
    "spatial chain, Radau(2)": Case(
        spatial_chain, 1.0, "end", (1e-3, 1e-5), finer(0, scheme=EXACT), {"scheme": fmbd.Radau(2)}
    ),
    "bouncing ball": Case(bouncing_on_spring, 0.8, "ball", (5e-3, 2e-4), rebounds),
    "copper arm": Case(copper_arm, 0.3, "tip", (1e-3, 1e-4), fine(20, 2)),
    "frame of beams": Case(frame_of_beams, 0.6, "middle", (share(2e-2), share(2e-3)), fine(20, 4), {}, {"support": 20.0}),
    "hanging block": Case(hanging_rubber, 0.3, "below", (share(2e-2), share(3e-3)), fine(10, 3)),
    "cable": Case(steel_cable, 0.6, "end", (2e-2, 2e-3), fine(10, 2)),
    "door": Case(modal_door, 0.4, "edge", (2e-2, 2e-3), fine(10, 2)),
    "kicked bar": Case(kicked, 0.6, "tip", (5e-4, 5e-5), finer(2, scheme=fmbd.Radau(3, rtol=1e-8))),
}  # fmt: skip
