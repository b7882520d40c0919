"""Andrews' mechanism and the car axis of the IVP test set as rigid bodies and joints, and what their published coordinates are.

Each ``coordinates`` takes the configuration q of a state, x, y and angle of each body in turn.
"""

from __future__ import annotations

import andrews_model as a
import car_axis as car
import numpy as np

import fmbd_fenicsx as fmbd


def ray(angle: float) -> np.ndarray:
    """A unit vector."""
    return np.array([np.cos(angle), np.sin(angle)])


def andrews_places() -> tuple[list[tuple[np.ndarray, float]], dict[str, np.ndarray]]:
    """Centres of mass and angles of the seven bodies at the start, and the points of hinges and of the spring's end."""
    be, th, ga, ph, de, om, ep = a.START
    base, hook = np.array([a.XA, a.YA]), np.array([a.XB, a.YB])
    crank, right, left = a.RR * ray(be), np.pi / 2, -np.pi / 2
    places = [
        (a.RA * ray(be), be),
        (crank - a.DA * ray(be + th), be + th),
        (hook + a.SA * ray(ga) + a.SB * ray(ga + right), ga),
        (base + a.ZT * ray(de) + (a.E - a.EA) * ray(ph + de + left), ph + de),
        (base + a.TA * ray(de) + a.TB * ray(de + right), de),
        (base + a.U * ray(ep + left) + (a.ZF - a.FA) * ray(om + ep), om + ep),
        (base + a.UA * ray(ep + left) - a.UB * ray(ep), ep),
    ]
    points = {
        "crank": crank,
        "meet": crank - a.D * ray(be + th),
        "base": base,
        "hook": hook,
        "upper": base + a.ZT * ray(de),
        "lower": base + a.U * ray(ep + left),
        "end": hook + a.SC * ray(ga + left) + a.SD * ray(ga),
        "fixed": np.array([a.XC, a.YC]),
    }
    return places, points


def andrews_hinges(point: dict[str, np.ndarray]) -> list[tuple[int, int, np.ndarray]]:
    """Which bodies are joined, -1 for the ground, and where."""
    pairs = [(-1, 0, np.zeros(2)), (0, 1, point["crank"]), (-1, 2, point["hook"]), (-1, 4, point["base"])]
    pairs += [(-1, 6, point["base"]), (4, 3, point["upper"]), (6, 5, point["lower"])]
    return pairs + [(1, other, point["meet"]) for other in (2, 3, 5)]


def andrews() -> fmbd.Scene:
    """Seven bodies, ten hinges, one spring, one torque."""
    places, point = andrews_places()
    masses = zip((a.M1, a.M2, a.M3, a.M4, a.M5, a.M6, a.M7), (a.I1, a.I2, a.I3, a.I4, a.I5, a.I6, a.I7), strict=True)
    k = [
        fmbd.RigidBody(f"K{i + 1}", m, inertia, tuple(place), angle)
        for i, ((m, inertia), (place, angle)) in enumerate(zip(masses, places, strict=True))
    ]
    ground, parts = fmbd.ground, [*k, fmbd.ground]
    scene = fmbd.Scene("Andrews' mechanism")
    scene.add(*k)
    for i, (x, y, at) in enumerate(andrews_hinges(point)):
        scene.add(fmbd.revolute(f"hinge {i}", parts[x], parts[y], center=tuple(at)))
    ends = {"point_a": tuple(point["fixed"]), "point_b": tuple(point["end"])}
    scene.add(fmbd.Spring("spring", ground, k[2], stiffness=a.C0, length=a.L0, **ends))
    scene.add(fmbd.torque("motor", k[0], a.TORQUE))
    return scene


def andrews_coordinates(q: np.ndarray) -> np.ndarray:
    """beta, Theta, gamma, Phi, delta, Omega, epsilon."""
    one, two, ga, four, de, six, ep = q[2::3]
    return np.array([one, two - one, ga, four - de, de, six - ep, ep])


def chord(t: float) -> tuple[float, float, float]:
    """Angle of the line between the wheels, and its rates."""
    s, c = np.sin(car.OMEGA * t), np.cos(car.OMEGA * t)
    y, dy, ddy = car.R * s / car.L, car.R * car.OMEGA * c / car.L, -car.R * car.OMEGA**2 * s / car.L
    x = np.sqrt(1.0 - y * y)
    return float(np.arcsin(y)), dy / x, ddy / x + y * dy * dy / x**3


def car_axis() -> fmbd.Scene:
    """The axle as one body, on springs to the ends of a chord that turns as the road asks for."""
    mass = 2 * car.K
    axle = fmbd.RigidBody("axle", mass, mass * (car.L / 2) ** 2, (car.L / 2, car.L0), 0.0, (-0.5, 0.0))
    road = fmbd.RigidBody("chord", mass, mass, (0.0, 0.0), 0.0, (0.0, 0.0), chord(0.0)[1])
    scene = fmbd.Scene("car axis", gravity=(0.0, -car.G))
    scene.add(axle, road, fmbd.revolute("pivot", fmbd.ground, road, center=(0, 0)))
    scene.add(fmbd.drive_rotation("road", fmbd.ground, road, chord))
    scene.add(fmbd.point_on_line("guide", road, axle, axis=(0, 1), center=(0.0, car.L0)))
    for name, x in (("left", 0.0), ("right", car.L)):
        ends = {"point_a": (x, 0.0), "point_b": (x, car.L0)}
        scene.add(fmbd.Spring(name, road, axle, stiffness=1.0, length=car.L0, **ends))
    return scene


def car_coordinates(q: np.ndarray) -> np.ndarray:
    """x_l, y_l, x_r, y_r."""
    centre, half = q[:2], 0.5 * car.L * ray(q[2])
    return np.concatenate((centre - half, centre + half))
