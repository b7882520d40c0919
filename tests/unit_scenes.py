"""Scenes as functions of a system of units: bodies, joints, forces, contact, loads, each with the sensors that judge it.

A scene takes :class:`Units`, in which every number of it is given by its powers of length, mass and time, and returns itself
with its sensors' powers: the same scene in other units must take the same steps to the same digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import materials

MESHES = Path(__file__).parents[1] / "meshes"
Powers = tuple[int, int, int]

ANGLE, LENGTH, FORCE, MOMENT, PRESSURE = (0, 0, 0), (1, 0, 0), (1, 1, -2), (2, 1, -2), (-1, 1, -2)
RATE, TIME = (0, 0, -1), (0, 0, 1)


class Units:
    """Numbers for quantities given in metres, kilograms and seconds: a force is ``of(12.0, 1, 1, -2)``."""

    def __init__(self, metre: float, kilogram: float, second: float) -> None:
        self.sizes = np.array([metre, kilogram, second])

    def of(self, value: Any, *powers: int) -> Any:
        """A value of a quantity of length, mass and time to these powers."""
        factor = float(np.prod(self.sizes.astype(float) ** np.array(powers)))
        return factor * np.asarray(value, dtype=float) if np.ndim(value) else factor * float(value)

    def metres(self, *value: float) -> Any:
        """A length, or a place from its components."""
        return self.of(value if len(value) > 1 else value[0], 1, 0, 0)


@dataclass
class Drawn:
    """A scene, the powers of its sensors, and what else a run of it is told."""

    scene: fmbd.Scene
    units: Units
    powers: dict[str, Powers] = field(default_factory=dict)
    linear: Any = None

    def sensor(self, name: str, what: Any, powers: Powers) -> None:
        """A sensor and the powers of what it measures."""
        self.scene.sensor(name, what)
        self.powers[name] = powers


def drawn(u: Units, name: str, *things: Any, gravity: tuple[float, ...] | None = (0.0, -9.81), **more: Any) -> Drawn:
    """A scene of these bodies, joints and forces under this gravity (m/s^2)."""
    scene = fmbd.Scene(name, gravity=None if gravity is None else u.of(gravity, 1, 0, -2), **more)
    scene.add(*things)
    return Drawn(scene, u)


@cache
def block(size: tuple[float, ...], counts: tuple[int, ...], origin: tuple[float, ...]) -> Any:
    """A block on a regular grid."""
    return fmbd.read_gmsh(MESHES / "block.py", size=size, counts=counts, origin=origin)


def box(u: Units, size: tuple[float, ...], counts: tuple[int, ...], origin: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Any:
    """A block of so many metres."""
    return block(tuple(u.metres(*size)), counts, tuple(u.metres(*origin)))


def young(u: Units, value: float) -> float:
    """A modulus times the thickness that densities and loads of plane bodies are for."""
    return u.of(value, 0, 1, -2)


# ----------------------------------------------------------------------------------------------------- rigid, in joints


def arm(u: Units, **more: Any) -> tuple[Any, Any]:
    """An arm of 1 m on a hinge at the origin."""
    body = fmbd.RigidBody("arm", u.of(2.0, 0, 1, 0), u.of(0.3, 2, 1, 0), u.metres(0.5, 0.0), **more)
    return body, fmbd.revolute("pin", fmbd.ground, body, center=(0.0, 0.0))


def controlled(u: Units) -> Drawn:
    """A PID, a motor, smooth friction and an elastic stop on two links."""
    one, pin = arm(u)
    two = fmbd.RigidBody("two", u.of(0.5, 0, 1, 0), u.of(0.02, 2, 1, 0), u.metres(1.3, 0.1))
    elbow = fmbd.revolute("elbow", one, two, center=u.metres(1.0, 0.0))
    made = drawn(u, "controlled", one, two, pin, elbow)
    gains = (u.of(60.0, *MOMENT), u.of(300.0, 2, 1, -3), u.of(9.0, 2, 1, -1))
    omega = u.of(4.0, *RATE)
    motor = fmbd.motor("motor", fmbd.angle(elbow), target=0.4, kp=u.of(8.0, *MOMENT), kd=u.of(0.5, 2, 1, -1))
    made.scene.add(
        fmbd.pid("pid", fmbd.angle(pin), target=lambda t: 0.3 * np.sin(omega * t), gains=gains),
        motor,
        fmbd.joint_friction(
            "rub", fmbd.angle(pin), coulomb=u.of(1.0, *MOMENT), speed=u.of(0.2, *RATE), static=u.of(1.4, *MOMENT),
            stribeck=u.of(0.6, *RATE), viscous=u.of(0.1, 2, 1, -1),
        ),
        fmbd.elastic_stop("stop", fmbd.angle(elbow), lower=-0.5, upper=0.02, stiffness=u.of(90.0, *MOMENT), width=0.01),
    )  # fmt: skip
    made.sensor("place", fmbd.position(two), LENGTH)
    made.sensor("turn", fmbd.angle(pin), ANGLE)
    made.sensor("effort", fmbd.element_effort(motor), MOMENT)
    return made


def sampled(u: Units) -> Drawn:
    """A PID that is asked at instants, with a bound on its torque, and dry friction that sticks."""
    one, pin = arm(u)
    made = drawn(u, "sampled", one, pin)
    gains = (u.of(60.0, *MOMENT), u.of(300.0, 2, 1, -3), u.of(9.0, 2, 1, -1))
    made.scene.add(
        fmbd.pid("pid", fmbd.angle(pin), target=0.3, gains=gains, every=u.of(0.02, *TIME), limit=u.of(40.0, *MOMENT)),
        fmbd.dry_friction("rub", fmbd.angle(pin), limit=u.of(2.0, *MOMENT), stick=u.of(400.0, *MOMENT)),
    )
    made.sensor("turn", fmbd.angle(pin), ANGLE)
    made.sensor("pin", fmbd.reaction_force("pin"), FORCE)
    return made


def carriage(u: Units) -> Drawn:
    """A chassis on a tyre, a bushing with a swing arm, and a rack with a screw's and a gear's ratio between coordinates."""
    chassis = fmbd.RigidBody("chassis", u.of(30.0, 0, 1, 0), u.of(4.0, 2, 1, 0), u.metres(0.0, 1.0))
    wheel = fmbd.RigidBody("wheel", u.of(5.0, 0, 1, 0), u.of(0.2, 2, 1, 0), u.metres(0.5, 0.3))
    slide = fmbd.RigidBody("slide", u.of(2.0, 0, 1, 0), u.of(0.1, 2, 1, 0), u.metres(0.0, 1.2))
    made = drawn(u, "carriage", chassis, wheel, slide)
    guide = fmbd.prismatic("guide", fmbd.ground, chassis, axis=(0, 1), center=u.metres(0.0, 1.0))
    rack = fmbd.prismatic("rack", chassis, slide, axis=(1, 0), center=u.metres(0.0, 1.2))
    stiffness = np.array([u.of(4e3, 0, 1, -2), u.of(5e3, 0, 1, -2), u.of(300.0, *MOMENT)])
    road = lambda x, t: u.metres(0.02) * np.sin(x[0] / u.metres(0.1) + t * u.of(9.0, *RATE))
    tyre = fmbd.Tyre(
        "tyre", wheel, road=road, radius=u.metres(0.31), stiffness=u.of(2e4, 0, 1, -2), damping=u.of(90.0, 0, 1, -1)
    )
    made.scene.add(
        guide, rack, tyre,
        fmbd.gear("ratio", fmbd.displacement(guide), fmbd.displacement(rack), ratio=0.4),
        fmbd.bushing(
            "mount", chassis, wheel, stiffness=stiffness, damping=0.02 * stiffness / u.of(3.0, *RATE), center=u.metres(0.4, 0.5)
        ),
        fmbd.Spring(
            "soft", fmbd.ground, slide, u.metres(-0.6, 1.5), u.metres(0.0, 1.2), u.of(70.0, 0, 1, -2), u.of(2.0, 0, 1, -1),
            u.metres(0.5),
        ),
    )  # fmt: skip
    made.sensor("chassis", fmbd.position(chassis), LENGTH)
    made.sensor("wheel", fmbd.position(wheel), LENGTH)
    made.sensor("force", fmbd.element_force(tyre), FORCE)
    return made


def rolling(u: Units) -> Drawn:
    """A wheel with a tread that rolls, leans and turns, beside a blade on ice."""
    moments = u.of((0.06, 0.12, 0.06), 2, 1, 0)
    body = fmbd.RigidBody(
        "wheel", u.of(2.0, 0, 1, 0), moments, u.metres(0.0, 0.0, 0.3), velocity=u.of((1.5, 0.0, 0.0), 1, 0, -1),
        angular_velocity=u.of((0.3, 5.0, 0.4), *RATE),
    )  # fmt: skip
    wheel = fmbd.Wheel(u.metres(0.3), axis=(0, 1, 0), tread=u.metres(0.05))
    made = drawn(u, "rolling", body, gravity=(0.0, 0.0, -9.81))
    made.scene.add(fmbd.rolling("road", fmbd.ground, body, shape=wheel, normal=(0, 0, 1)))
    blade = fmbd.RigidBody(
        "blade", u.of(1.0, 0, 1, 0), moments, u.metres(0.0, 2.0, 0.0), velocity=u.of((1.0, 0.0, 0.0), 1, 0, -1),
        angular_velocity=u.of((0.0, 0.0, 1.0), *RATE),
    )  # fmt: skip
    made.scene.add(blade, fmbd.skate("edge", fmbd.ground, blade, along=(1, 0, 0), center=u.metres(0.0, 2.0, 0.0)))
    made.sensor("place", fmbd.position(body), LENGTH)
    made.sensor("blade", fmbd.position(blade), LENGTH)
    made.sensor("force", fmbd.reaction_force("road"), FORCE)
    return made


def driven(u: Units) -> Drawn:
    """A crank at a prescribed angle drives a slider in space, by a screw and a link of fixed length."""
    moments = u.of((0.02, 0.03, 0.04), 2, 1, 0)
    crank = fmbd.RigidBody("crank", u.of(1.0, 0, 1, 0), moments, u.metres(0.1, 0.0, 0.0))
    nut = fmbd.RigidBody("nut", u.of(3.0, 0, 1, 0), moments, u.metres(0.9, 0.0, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, crank, center=(0, 0, 0), axis=(0, 0, 1))
    thread = fmbd.cylindrical("thread", fmbd.ground, nut, axis=(1, 0, 0), center=u.metres(0.9, 0.0, 0.0))
    made = drawn(u, "driven", crank, nut, pin, thread, gravity=(0.0, 0.0, -9.81))
    ends = {"point_a": u.metres(0.2, 0.0, 0.0), "point_b": u.metres(0.9, 0.0, 0.0)}
    omega = u.of(6.0, *RATE)
    made.scene.add(
        fmbd.distance("link", crank, nut, length=u.metres(0.7), **ends),
        fmbd.screw("screw", thread, lead=u.metres(0.3)),
        fmbd.drive("drive", fmbd.angle(pin), lambda t: 0.7 * (1 - np.cos(omega * t))),
    )
    made.sensor("nut", fmbd.position(nut), LENGTH)
    made.sensor("force", fmbd.reaction("link"), FORCE)
    made.sensor("torque", fmbd.reaction("drive"), MOMENT)
    return made


def own_coordinates(u: Units) -> Drawn:
    """A body of coordinates of its own: a mass on a cubic spring and a constraint, held to an arm by a spring."""
    k, c = u.of(50.0, 0, 1, -2), u.of(1.0, 0, 1, -1)
    body = fmbd.CoordinateBody(
        "own", np.diag([u.of(2.0, 0, 1, 0), u.of(1.0, 0, 1, 0)]),
        lambda q, v, t: -k * q - c * v - k / u.metres(0.1) ** 2 * q**3, u.metres(0.1, 0.05), u.of((0.0, 1.0), 1, 0, -1),
    )  # fmt: skip
    made = drawn(u, "own coordinates", body, *arm(u))
    made.sensor("q", fmbd.coordinates(body), LENGTH)
    return made


# ------------------------------------------------------------------------------------------------------- lines and rods


def section(u: Units, **more: Any) -> fmbd.RodSection:
    """Of a soft rod with more twist than bending."""
    stiffness = np.r_[u.of((1e4, 4e3, 4e3), *FORCE), u.of((30.0, 20.0, 25.0), 3, 1, -2)]
    return fmbd.RodSection(stiffness, u.of(1.0, -1, 1, 0), u.of((2e-3, 1e-3, 1e-3), 1, 1, 0), **more)


def rod(u: Units, *, arms: bool = False, damping: float = 0.0) -> Drawn:
    """A bent rod in space, clamped at one end, with a bob on a ball joint and a load along it."""
    relaxation = [(0.5, u.of(0.02, *TIME)), (u.of((0, 0, 0, 9.0, 9.0, 0), 3, 1, -2), u.of(0.1, *TIME))] if arms else ()
    points = u.metres(1.0) * np.array([(0, 0, 0), (0.5, 0.1, 0.0), (1, 0, 0.1)])
    law = lambda s, t: u.of((0.0, 3.0, 1.0), 0, 1, -2) * np.sin(t * u.of(20.0, *RATE))
    made_of: dict[str, Any] = {
        "elements": 3,
        "degree": 2,
        "damping": u.of(damping, *TIME),
        "loads": [fmbd.RodLoad(law)],
    }
    body = fmbd.Rod("rod", points, section(u, relaxation=relaxation), **made_of)
    bob = fmbd.RigidBody("bob", u.of(0.4, 0, 1, 0), u.of((1e-2,) * 3, 2, 1, 0), u.metres(1.0, 0.0, -0.1))
    made = drawn(u, "rod", body, bob, gravity=(0.0, 0.0, -9.81))
    made.scene.add(fmbd.fixed("clamp", fmbd.ground, body.surface("start")))
    made.scene.add(fmbd.spherical("ball", body.surface("end"), bob, center=u.metres(1.0, 0.0, 0.1)))
    made.sensor("tip", fmbd.position(body.surface("end")), LENGTH)
    made.sensor("bob", fmbd.position(bob), LENGTH)
    made.sensor("clamp", fmbd.reaction_force("clamp"), FORCE)
    return made


def beam(u: Units, dim: int = 2, **more: Any) -> Drawn:
    """A beam on a pin, in a floating frame."""
    of = {"youngs_modulus": u.of(1e8, *PRESSURE), "poisson_ratio": 0.3, "density": u.of(1e3, -3, 1, 0)}
    shape = fmbd.Section.rectangle(**of, width=u.metres(0.1), height=u.metres(0.05))
    ends = (u.metres(0.0, 0.0, 0.0)[:dim], u.metres(1.0, 0.0, 0.0)[:dim])
    body = fmbd.Beam("beam", *ends, shape, elements=3, **more)
    made = drawn(u, "beam", body, gravity=(0.0, -9.81, 0.0)[:dim])
    axis = {} if dim == 2 else {"axis": (0, 0.2, 1)}
    made.scene.add(fmbd.revolute("pin", fmbd.ground, body.surface("start"), center=ends[0], **axis))
    made.sensor("tip", fmbd.position(body.surface("end")), LENGTH)
    made.sensor("pin", fmbd.reaction_force("pin"), FORCE)
    return made


def line(u: Units) -> Drawn:
    """A planar line by its own weak form, on a pin, with a bob at its end."""
    from dolfinx import fem
    from ufl import cos, sin

    def mass(z: Any, w: Any, ds: Any) -> Any:
        rho, J = (fem.Constant(ds.ufl_domain(), x) for x in (u.of(1.0, -1, 1, 0), u.of(1e-3, 1, 1, 0)))
        return (rho * (z[0] * w[0] + z[1] * w[1]) + J * z[2] * w[2]) * ds

    def energy(z: Any, ds: Any) -> Any:
        given = (u.of(1e5, *FORCE), u.of(4e4, *FORCE), u.of(50.0, 3, 1, -2))
        EA, GA, EI = (fem.Constant(ds.ufl_domain(), x) for x in given)
        c, s, x, y = cos(z[2]), sin(z[2]), z[0].dx(0), z[1].dx(0)
        return 0.5 * (EA * (x * c + y * s - 1) ** 2 + GA * (y * c - x * s) ** 2 + EI * z[2].dx(0) ** 2) * ds

    straight = lambda s: [s, 0 * s, 0 * s]
    body = fmbd.LineBody("line", u.metres(2.0), mass, energy, straight, cells=4, mass_damping=u.of(1.0, *RATE))
    bob = fmbd.RigidBody("bob", u.of(0.5, 0, 1, 0), u.of(0.01, 2, 1, 0), u.metres(2.0, -0.3))
    made = drawn(u, "line", body, bob)
    made.scene.add(
        fmbd.revolute("pin", fmbd.ground, body.surface("start"), center=(0, 0)),
        fmbd.revolute("hinge", body.surface("end"), bob, center=u.metres(2.0, 0.0)),
    )
    made.sensor("bob", fmbd.position(bob), LENGTH)
    made.sensor("turn", fmbd.rotation(body.surface("end")), ANGLE)
    made.sensor("pin", fmbd.reaction_force("pin"), FORCE)
    return made


def wires(u: Units) -> Drawn:
    """Two wires on droppers, and a pan head that is pulled off the lower one while it slides."""
    kinds = (
        fmbd.Wire(u.of(1.35, -1, 1, 0), u.of(2e4, *FORCE), u.of(195.0, 3, 1, -2)),
        fmbd.Wire(u.of(1.07, -1, 1, 0), u.of(1.6e4, *FORCE)),
    )
    droppers = tuple(fmbd.Dropper(1, 0, u.metres(x), u.of(1e5, 0, 1, -2)) for x in (5.0, 10.0, 15.0))
    support = (fmbd.PointSupport(1, u.metres(10.0), u.of(1e6, 0, 1, -2)),)
    body = fmbd.Wires(
        "wires", u.metres(20.0), 20, kinds, support, droppers, anchor=u.of(1e7, 0, 1, -2),
        stiffness_damping=u.of(1e-4, *TIME),
    ).hung(0.0, gravity=u.of(9.81, 1, 0, -2))  # fmt: skip
    last = u.of(0.0205, *TIME)  # not where steps end: which of them sees the pull would be roundoff
    pan = fmbd.CoordinateBody(
        "pan", np.diag([u.of(2.0, 0, 1, 0), u.of(1.0, 0, 1, 0)]),
        lambda q, v, t: np.array([u.of(50.0 - 4000.0 * (t > last / 2 and t < last), *FORCE), 0.0]), np.zeros(2),
    )  # fmt: skip
    made = drawn(u, "wires", body, pan, settle=True)
    sliding = {"start": u.metres(8.0), "speed": u.of(20.0, 1, 0, -1), "ramp": u.of(0.01, *TIME), "idle": 1}
    made.scene.add(fmbd.SlidingContact("contact", body, pan, **sliding))
    made.sensor("y", fmbd.coordinates(pan), LENGTH)
    made.sensor("w", fmbd.wire_height(body, 0, u.metres(1.0) * np.array([5.0, 8.0, 12.0])), LENGTH)
    made.sensor("force", fmbd.reaction("contact"), FORCE)
    return made


# --------------------------------------------------------------------------------------------------------------- fields


def plate(u: Units, kind: Any, counts: tuple[int, ...] = (4, 1), **law: Any) -> Any:
    """A strip of 1 m by 0.1 m."""
    return kind("strip", box(u, (1.0, 0.1), counts), density=u.of(1000.0, -2, 1, 0), **law)


def strip(u: Units, kind: str, *, moved: Callable[[Any], Any] | None = None, linear: Any = None, **more: Any) -> Drawn:
    """A strip of one law on a pin, with a spring at its tip."""
    laws: dict[str, tuple[Any, dict[str, Any]]] = {
        "floating": (fmbd.FloatingBody, {"elastic": materials.plane_stress(young(u, 1e8), 0.3)}),
        "absolute": (fmbd.AbsoluteBody, {"elastic": materials.plane_stress(young(u, 1e8), 0.3)}),
        "large": (fmbd.AbsoluteBody, {"energy": materials.saint_venant_kirchhoff(young(u, 1e7), 0.3)}),
        "neo-Hookean": (fmbd.AbsoluteBody, {"energy": materials.neo_hookean(young(u, 1e7), 0.3)}),
        "large, floating": (fmbd.FloatingBody, {"energy": materials.saint_venant_kirchhoff(young(u, 1e7), 0.3)}),
        "pressure": (fmbd.AbsoluteBody, {"elastic": materials.nearly_incompressible(young(u, 1e8), 0.4999)}),
        "rubber": (fmbd.AbsoluteBody, {"energy": materials.neo_hookean_mixed(young(u, 1e7), 0.4999)}),
        "incompressible": (fmbd.AbsoluteBody, {"energy": materials.neo_hookean_incompressible(young(u, 1e7))}),
    }
    of, law = laws[kind]
    body = plate(u, of, **law, **more)
    body = moved(body) if moved else body
    made = drawn(u, kind, body, fmbd.revolute("pin", fmbd.ground, body.surface("left"), center=u.metres(0.0, 0.05)))
    ends = {"point_a": u.metres(1.0, 0.6), "length": u.metres(0.5)}
    made.linear = linear
    made.scene.add(fmbd.Spring("spring", fmbd.ground, body.surface("right"), stiffness=u.of(1e4, 0, 1, -2), **ends))
    made.sensor("tip", fmbd.position(body.surface("right")), LENGTH)
    made.sensor("pin", fmbd.reaction_force("pin"), FORCE)
    return made


def viscous(u: Units) -> Drawn:
    """A soft strip with Kelvin-Voigt damping in its strains."""
    damped = materials.kelvin_voigt(u.of(2e4, 0, 1, -1), u.of(1e4, 0, 1, -1))
    return strip(u, "large", viscous=damped)


def loaded(u: Units) -> Drawn:
    """Pressure, traction, body force and heat on a strip, clamped by a field of multipliers."""
    omega = u.of(40.0, *RATE)
    wave = lambda t: np.sin(omega * t)
    loads = [
        fmbd.pressure("top", young(u, 1e4), time=wave),
        fmbd.loads.traction("right", u.of((2e4, 1e4), 0, 1, -2), time=wave),
        fmbd.body_force(u.of((0.0, 3e3), -1, 1, -2), time=wave),
    ]
    body = plate(u, fmbd.AbsoluteBody, elastic=materials.plane_stress(young(u, 1e8), 0.3), loads=loads)
    made = drawn(u, "loaded", body, fmbd.tie_surface("tie", body.surface("left"), fmbd.ground))
    made.sensor("tip", fmbd.position(body.surface("right")), LENGTH)
    made.sensor("strain", fmbd.sensors.strain(body, point=u.metres(0.55, 0.08)), ANGLE)
    return made


def tied(u: Units) -> Drawn:
    """Two strips on grids that do not match, tied by a field, one stiff and one soft."""
    soft = plate(u, fmbd.AbsoluteBody, elastic=materials.plane_stress(young(u, 1e7), 0.3))
    stiff = fmbd.AbsoluteBody(
        "stiff", box(u, (1.0, 0.1), (3, 2), (0.0, 0.1)), density=u.of(3e3, -2, 1, 0),
        elastic=materials.plane_stress(young(u, 1e9), 0.3),
    )  # fmt: skip
    made = drawn(u, "tied", soft, stiff, fmbd.tie_surface("tie", soft.surface("top"), stiff.surface("bottom")))
    made.scene.add(fmbd.revolute("pin", fmbd.ground, soft.surface("left"), center=u.metres(0.0, 0.05)))
    made.sensor("tip", fmbd.position(stiff.surface("right")), LENGTH)
    made.sensor("pin", fmbd.reaction_force("pin"), FORCE)
    return made


# -------------------------------------------------------------------------------------------------------------- contact


def floor(u: Units, height: float, dim: int = 2) -> fmbd.Obstacle:
    """A half space below this height."""
    up = (0.0, 1.0, 0.0)[:dim]
    return fmbd.Obstacle("floor", fmbd.HalfSpace(u.metres(height) * np.array(up), up))


def bouncing(u: Units) -> Drawn:
    """A rigid plate that falls on its corners, with restitution and friction, beside a ball."""
    body = fmbd.RigidBody(
        "plate", u.of(1.0, 0, 1, 0), u.of(0.0842, 2, 1, 0), u.metres(0.0, 0.1), velocity=u.of((0.5, -1.0), 1, 0, -1),
        angular_velocity=u.of(0.3, *RATE),
    )  # fmt: skip
    feet = fmbd.corners(body, [tuple(u.metres(x, -0.05)) for x in (-0.5, 0.5)])
    ball = fmbd.RigidBody("ball", u.of(0.1, 0, 1, 0), u.of(1e-3, 2, 1, 0), u.metres(3.0, 0.3))
    made = drawn(u, "bouncing", body, ball)
    pairs = (
        fmbd.contact("feet", feet, floor(u, 0.0), friction=0.3, restitution=0.4),
        fmbd.contact("ball", fmbd.ball(ball, u.metres(0.1)), floor(u, 0.0), friction=0.2, restitution=0.8),
    )
    made.scene.add(*pairs)
    made.sensor("plate", fmbd.position(body), LENGTH)
    made.sensor("ball", fmbd.position(ball), LENGTH)
    made.sensor("impulse", fmbd.contact_impulse(pairs[0]), (1, 1, -1))
    return made


def thrown(u: Units) -> Drawn:
    """A plate alone: its size is that of its corners."""
    body = fmbd.RigidBody(
        "plate", u.of(1.0, 0, 1, 0), u.of(0.1, 2, 1, 0), u.metres(0.0, 0.6), velocity=u.of((0.8, -4.0), 1, 0, -1),
        angular_velocity=u.of(2.0, *RATE), rotation=-0.9,
    )  # fmt: skip
    feet = fmbd.corners(body, [tuple(u.metres(x, y)) for x in (-0.5, 0.5) for y in (-0.05, 0.05)])
    pair = fmbd.contact("feet", feet, floor(u, 0.0), friction=0.3, restitution=0.4)
    made = drawn(u, "thrown", body, pair)
    made.sensor("plate", fmbd.position(body), LENGTH)
    made.sensor("impulse", fmbd.contact_impulse(pair), (1, 1, -1))
    return made


def limited(u: Units) -> Drawn:
    """An arm that falls on the stop of its hinge and bounces."""
    body, pin = arm(u)
    made = drawn(u, "limited", body, pin, fmbd.joint_limit("stop", fmbd.angle(pin), lower=-0.05, restitution=0.5))
    made.sensor("turn", fmbd.angle(pin), ANGLE)
    made.sensor("place", fmbd.position(body), LENGTH)
    return made


def landing(u: Units, friction: float = 0.0, kind: Any = fmbd.AbsoluteBody) -> Drawn:
    """An elastic block that hits the floor obliquely."""
    body = kind(
        "block", box(u, (1.0, 0.5), (4, 2)), degree=1, density=u.of(2.0, -2, 1, 0),
        elastic=materials.plane_stress(young(u, 50.0), 0.2), velocity=u.of((0.3, -0.5), 1, 0, -1),
    )  # fmt: skip
    pair = fmbd.contact("floor", body.surface("bottom"), floor(u, -0.01), friction=friction)
    made = drawn(u, "landing", body, pair, gravity=(0.0, -1.0))
    made.sensor("top", fmbd.position(body.surface("top")), LENGTH)
    made.sensor("force", fmbd.contact_force(pair), FORCE)
    return made


def pressed(u: Units) -> Drawn:
    """Two elastic blocks pressed together, with mortar contact between grids that do not match."""
    of = {"degree": 1, "density": u.of(1.0, -2, 1, 0), "elastic": materials.plane_stress(young(u, 1000.0), 0.3)}
    low = fmbd.AbsoluteBody("low", box(u, (1.0, 0.5), (3, 2)), **of)
    high = fmbd.AbsoluteBody("high", box(u, (1.0, 0.5), (4, 2), (0.0, 0.5)), **of)
    pair = fmbd.contact("pair", high.surface("bottom"), low.surface("top"))
    made = drawn(u, "pressed", low, high, pair, gravity=None)
    made.scene.add(
        fmbd.force("press", high.surface("top"), lambda t: u.of((0.0, -10.0), *FORCE)),
        fmbd.fixed("base", fmbd.ground, low.surface("bottom")),
        fmbd.prismatic("guide", fmbd.ground, high.surface("top"), axis=(0, 1), center=u.metres(0.5, 1.0)),
    )
    made.sensor("top", fmbd.position(high.surface("top")), LENGTH)
    made.sensor("force", fmbd.contact_force(pair), FORCE)
    return made
