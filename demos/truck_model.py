"""The planar truck of Eich-Soellner and Fuehrer: data, suspension, and the scene for a loading area of any kind.

Rear wheel, chassis, front wheel, cab and loading area; nine coordinates (five heights, three pitch angles, the loading area's x).
A spring-damper of the source is a line element with the tension N = k s + d s' + f, f its nominal force and s the distance of
its two points, so its unstressed length is -f / k. The source prints nominal forces to 1e-8 N; those that recur as decimals,
weights times arms, have more digits here. They tell where the points are: at the start every body is in equilibrium, which
fixes the distances 0.16 m (wheels to chassis), 0.90 m (cab, loading area) and the arms. The road moves the
lower ends of the two tyres; tyres can pull, as in the source.

Source: E. Eich-Soellner, C. Fuehrer, Numerical Methods in Multibody Dynamics (1998), doi:10.1007/978-3-663-09828-7. All in
SI units, x forward, y up, in the frame that travels with the truck.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import fmbd_fenicsx as fmbd

G, SPEED = 9.81, 15.0
REAR, FRONT = -2.06, 2.44  # wheels, from the chassis' centre of mass
CHASSIS, CAB, LOAD = np.array([0.0, 2.0]), np.array([2.74, 2.9]), np.array([-1.46, 2.9])  # centres of mass
LOAD_MASS, LOAD_INERTIA = 11515.0, 33000.0
MODULUS, POISSON = 1e8, 0.3  # elastic loading area: Young's modulus times thickness (N/m), data of this demo
PIN = np.array([-3.07, 2.15])  # loading area on the chassis, when it is constrained
SUSPENSION = {  # bodies, points in the world at the start, stiffness, damping, nominal force
    "rear tyre": ("ground", "rear wheel", (REAR, 0.0), (REAR, 0.5), 4.4e6, 600.0, -2329145.162),
    "front tyre": ("ground", "front wheel", (FRONT, 0.0), (FRONT, 0.5), 2.2e6, 300.0, -1147434.838),
    "rear spring": ("rear wheel", "chassis", (REAR, 0.5), (REAR, 0.66), 824700.0, 21593.0, -246872.662),
    "front spring": ("front wheel", "chassis", (FRONT, 0.5), (FRONT, 0.66), 271100.0, 38537.0, -84924.838),
    "cab, rear": ("chassis", "cab", (1.94, 2.0), (1.94, 2.9), 135700.0, 12218.0, -127842.88235294118),
    "cab, front": ("chassis", "cab", (3.64, 2.0), (3.64, 2.9), 135700.0, 12218.0, -127208.11764705882),
    "load, front": ("chassis", "load: front", (0.98, 2.0), (0.98, 2.9), 900000.0, 38500.0, -854905.9411111111),
    "load, rear 1": ("chassis", "load: rear", (-3.07, 2.0), (-3.37, 2.9), 770000.0, 33013.0, -766354.91099974),
    "load, rear 2": ("chassis", "load: rear", (-3.07, 2.0), (-2.77, 2.9), 770000.0, 33013.0, -766354.91099974),
}
PIN_FORCE = 68056.2088888888  # N, at the start, of the source
NINE_AT = {  # reference of the nine coordinates at a time (s): pinned, on springs
    2.0: ([0.50290005089995, 2.0047517733927, 0.0013548853582886, 0.50676408485884, 2.908354490238,
           0.0013489881476636, -1.4612023238746, 2.9027391611411, 0.0013339690333247],
          [0.50290803829768, 2.0047275813676, 0.001318841197048, 0.50674866256439, 2.9082307868551,
           0.00131269932479, -1.4613981101619, 2.9027195234796, 0.0013112318521282]),
    10.0: ([0.55399417622006, 2.0491685230494, -0.0031125674025083, 0.54719915194705, 2.9406191205869,
            -0.0031127007852364, -1.4571738542069, 2.9536700504442, -0.0031364173050055],
           [0.55419826684956, 2.0479691507847, -0.0042835917934678, 0.54679152812889, 2.9362140954371,
            -0.0042829498155047, -1.4415234292275, 2.9540275722563, -0.0045271952826608]),
}  # fmt: skip


def hump(t: float, wheel: float) -> tuple[float, float]:
    """Height of the road under a wheel at x = ``wheel`` and its rate (m, m/s): 0.001 s^6 exp(-s), about 12 cm high, in s."""
    s = t - 2.0 / 15.0 - (FRONT - wheel) / SPEED
    return (0.0, 0.0) if s < 0 else (0.001 * s**6 * np.exp(-s), 0.001 * (6 * s**5 - s**6) * np.exp(-s))


def tyre(k: float, d: float, f: float, wheel: float) -> Callable[[float, float, float], float]:
    """Tension of a tyre whose lower end follows the road."""

    def law(s: float, rate: float, t: float) -> float:
        u, ud = hump(t, wheel)
        return k * (s - u) + d * (rate - ud) + f

    return law


def rigid_load() -> fmbd.RigidBody:
    """The loading area of the source."""
    return fmbd.RigidBody("load", LOAD_MASS, LOAD_INERTIA, LOAD)


WHEEL = fmbd.contacts.Sphere(0.5)  # what pictures show of a wheel


def _plate(length: float, height: float) -> fmbd.contacts.Box:
    """What pictures show of chassis and cab."""
    return fmbd.contacts.Box((length, height))


def truck(load: object, *, pinned: bool = True, modulus: float | None = None) -> fmbd.Scene:
    """The scene with a rigid or elastic loading area, in equilibrium at the start.

    An elastic one (see :func:`elastic_load`) has surfaces "front" and "rear" that carry the suspension points. ``pinned``: a
    pin instead of the springs "load, rear 1" and "load, rear 2". ``modulus``: of the elastic loading area, for its stress.
    """
    scene = fmbd.Scene("truck", gravity=(0.0, -G), breakpoints=[2 / 15, 2 / 15 + (FRONT - REAR) / SPEED], settle=True)
    bodies = {
        # the wheels do not turn here
        "rear wheel": fmbd.RigidBody("rear wheel", 1450.0, 100.0, (REAR, 0.5), shape=WHEEL),
        "front wheel": fmbd.RigidBody("front wheel", 600.0, 40.0, (FRONT, 0.5), shape=WHEEL),
        "chassis": fmbd.RigidBody("chassis", 3335.0, 14313.0, CHASSIS, shape=_plate(8.2, 0.16)),
        "cab": fmbd.RigidBody("cab", 1100.0, 948.0, CAB, shape=_plate(1.9, 1.4)),
    }
    scene.add(*bodies.values(), load)
    sides = {"ground": fmbd.ground, **bodies, "load: front": load, "load: rear": load}
    if not isinstance(load, fmbd.RigidBody):
        sides |= {"load: front": load.surface("front"), "load: rear": load.surface("rear")}  # type: ignore[attr-defined]
    for name in ("rear wheel", "front wheel"):
        scene.add(fmbd.prismatic(f"{name} guide", fmbd.ground, bodies[name], axis=(0, 1), center=bodies[name].position))
    for name in ("chassis", "cab"):  # free to move up and to pitch
        scene.add(
            fmbd.point_on_line(f"{name} guide", fmbd.ground, bodies[name], axis=(0, 1), center=bodies[name].position)
        )
    if pinned:
        scene.add(fmbd.revolute("pin", bodies["chassis"], sides["load: rear"], center=PIN))
    for name, (a, b, at_a, at_b, k, d, f) in SUSPENSION.items():
        if pinned and name.startswith("load, rear"):
            continue
        rolls = name.endswith("tyre")
        acts = {"law": tyre(k, d, f, at_a[0])} if rolls else {"stiffness": k, "damping": d, "length": -f / k}
        scene.add(fmbd.Spring(name, sides[a], sides[b], at_a, at_b, **acts))
    for name, body in bodies.items():
        scene.sensor(name, fmbd.position(body))
        scene.sensor(f"{name} pitch", fmbd.rotation(body))
    scene.sensor("cab acceleration", fmbd.acceleration(bodies["cab"]))
    if pinned:
        scene.sensor("pin", fmbd.reaction_force("pin"))
    if not isinstance(load, fmbd.RigidBody):
        scene.sensor("stress", fmbd.largest(load, lambda u: mises(u, modulus or MODULUS), unit="N/m"))
    return scene


NINE = (("rear wheel", 1), ("chassis", 1), ("chassis", 2), ("front wheel", 1), ("cab", 1), ("cab", 2), ("load", 0), ("load", 1),
        ("load", 2))  # fmt: skip


def nine_coordinates(times: Sequence[float], *, pinned: bool = True, rtol: float = 1e-12) -> dict[str, np.ndarray]:
    """The rigid truck at the given times (s), to about ``rtol``: "times", "p", "v", and with a pin its force "pin" on the load.

    p = (y rear wheel, y chassis, phi chassis, y front wheel, y cab, phi cab, x load, y load, phi load), m and rad, and its
    rates v: (n, 9); pin: (n, 2) N. By Radau IIA of order 5, which meets the times exactly.
    """
    made = truck(rigid_load(), pinned=pinned)
    made.breakpoints = sorted({*made.breakpoints, *(t for t in times if 0 < t < max(times))})
    for name, body in made.bodies.items():
        made.sensor(f"{name} velocity", fmbd.velocity(body))
        made.sensor(f"{name} rate", fmbd.angular_velocity(body))
    made.sensor("load", fmbd.position(made.bodies["load"]))
    made.sensor("load pitch", fmbd.rotation(made.bodies["load"]))
    run = fmbd.solve(made, t_end=max(times), scheme=fmbd.Radau(rtol=rtol), output=fmbd.Output(energy=False))
    rows = [int(np.argmin(abs(run.times - t))) for t in times]

    def of(place: str, turn: str) -> np.ndarray:
        return np.stack([run[b + turn][rows, 0] if k == 2 else run[b + place][rows, k] for b, k in NINE], axis=1)

    found = {"times": run.times[rows], "p": of("", " pitch"), "v": of(" velocity", " rate")}
    return {**found, "pin": -run["pin"][rows]} if pinned else found


def mises(u: Any, modulus: float) -> Any:
    """Mises stress times thickness in plane stress, N/m, as a UFL expression."""
    from ufl import Identity, grad, inner, sqrt, sym, tr

    e = sym(grad(u))
    k = modulus / (1 - POISSON**2)
    n = k * ((1 - POISSON) * e + POISSON * tr(e) * Identity(2))
    return sqrt(1.5 * inner(n, n) - 0.5 * tr(n) ** 2)


def elastic_load(modulus: float = MODULUS, *, h: float = 0.3) -> fmbd.FloatingBody:
    """A sheet in plane stress with mass, centre and inertia of the rigid loading area, on pads under the suspension points.

    1.5 m high, 5.67 m long; ``modulus`` is Young's modulus times thickness, N/m.
    """
    height = 1.5  # the pin then lies on the lower edge
    length = np.sqrt(12 * LOAD_INERTIA / LOAD_MASS - height**2)
    low = (LOAD[0] - length / 2, LOAD[1] - height / 2)
    pads = ((PIN[0] - 0.4, PIN[0] + 0.4), (0.98 - 0.25, 0.98 + 0.25))
    mesh = fmbd.read_gmsh("meshes/loading_area.py", low=low, size=(length, height), pads=pads, h=h)
    sheet = fmbd.materials.plane_stress(modulus, POISSON)
    return fmbd.FloatingBody("load", mesh, density=LOAD_MASS / (length * height), elastic=sheet, stiffness_damping=2e-4)
