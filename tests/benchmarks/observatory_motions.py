"""Problems of the observatory: rigid bodies in the plane and in space, and three systems of the IVP test set."""

from __future__ import annotations

from typing import Any

import andrews_model
import car_axis
import crank_model
import numpy as np
from dae_problems import pendulum, pendulum_at
from observatory_problem import Problem, ordinary

import fmbd_fenicsx as fmbd

G = 9.81
CRANK = [np.nan] * 3 + [1.893192899613509e-4, 2.375751249879174e-5, -5.323896770569702e-6, -8.363313279112129e-6]


# -- in the plane ---------------------------------------------------------------------------------------------------
def on_spring() -> fmbd.Scene:
    """A weight of 2 kg on a guide and a spring of 50 N/m, released where the spring is free of force."""
    scene = fmbd.Scene("mass on spring", gravity=(0.0, -G))
    body = fmbd.RigidBody("weight", 2.0, 0.1, (0.0, -1.0))
    scene.add(body, fmbd.prismatic("guide", fmbd.ground, body, axis=(0, 1), center=(0, 0)))
    scene.add(fmbd.Spring("spring", fmbd.ground, body, stiffness=50.0, length=1.0))
    scene.sensor("place", fmbd.position(body))
    return scene


def compound(damping: float = 0.0) -> fmbd.Scene:
    """A bar of 1 m and 1 kg falls from the horizontal about its end."""
    scene = fmbd.Scene("compound pendulum", gravity=(0.0, -G))
    bar = fmbd.RigidBody("bar", 1.0, 1 / 12, (0.5, 0.0))
    pin = fmbd.revolute("pin", fmbd.ground, bar, center=(0, 0))
    scene.add(bar, pin)
    if damping:
        scene.add(fmbd.joint_spring("damper", fmbd.angle(pin), stiffness=0.0, damping=damping))
    scene.sensor("place", fmbd.position(bar))
    return scene


def compound_end(damping: float, t_end: float) -> Any:
    """Its centre: phi'' = 3 / 2 g cos(phi) and damping, phi from the horizontal downward."""
    phi = ordinary(lambda t, y: [y[1], 1.5 * G * np.cos(y[0]) - 3 * damping * y[1]], [0.0, 0.0], t_end)[0]
    return 0.5 * np.array([np.cos(phi), -np.sin(phi)])


def double() -> fmbd.Scene:
    """Two bars of 1 m and 1 kg fall from the horizontal."""
    scene, last = fmbd.Scene("double pendulum", gravity=(0.0, -G)), fmbd.ground
    for k in range(2):
        bar = fmbd.RigidBody(f"bar {k}", 1.0, 1 / 12, (k + 0.5, 0.0))
        scene.add(bar, fmbd.revolute(f"pin {k}", last, bar, center=(float(k), 0.0)))
        last = bar
    scene.sensor("place", fmbd.position(last))
    return scene


def double_end(t_end: float) -> Any:
    """Centre of the second bar by Lagrange's equations in the two angles from the horizontal."""

    def rate(t: float, y: Any) -> Any:
        (a, b), (u, w) = y[:2], y[2:]
        c, s = 0.5 * np.cos(a - b), 0.5 * np.sin(a - b)
        M = np.array([[4 / 3, c], [c, 1 / 3]])
        f = np.array([-s * w * w - 1.5 * G * np.cos(a), s * u * u - 0.5 * G * np.cos(b)])
        return [u, w, *np.linalg.solve(M, f)]

    a, b = ordinary(rate, np.zeros(4), t_end)[:2]
    return np.array([np.cos(a) + 0.5 * np.cos(b), np.sin(a) + 0.5 * np.sin(b)])


def spring_pendulum(stiffness: float = 200.0) -> fmbd.Scene:
    """A mass of 1 kg on a spring of 1 m, released from the horizontal; its own turn is free."""
    scene = fmbd.Scene("spring pendulum", gravity=(0.0, -G))
    body = fmbd.RigidBody("mass", 1.0, 1.0, (1.0, 0.0))
    scene.add(body, fmbd.Spring("spring", fmbd.ground, body, stiffness=stiffness, length=1.0))
    scene.sensor("place", fmbd.position(body))
    return scene


def spring_pendulum_end(t_end: float, stiffness: float = 200.0) -> Any:
    """By its Cartesian coordinates."""

    def rate(t: float, y: Any) -> Any:
        r = np.hypot(y[0], y[1])
        pull = -stiffness * (r - 1.0) / r
        return [y[2], y[3], pull * y[0], pull * y[1] - G]

    return ordinary(rate, [1.0, 0.0, 0.0, 0.0], t_end)[:2]


def on_arm() -> fmbd.Scene:
    """A bead slides on an arm that turns at 2 rad/s, from rest at 0.5 m: x = 0.5 cosh(2 t)."""
    scene = fmbd.Scene("bead on an arm")
    arm, bead = fmbd.RigidBody("arm", 1.0, 1.0, (0.0, 0.0), angular_velocity=2.0), None
    bead = fmbd.RigidBody("bead", 1.0, 0.1, (0.5, 0.0), velocity=(0.0, 1.0), angular_velocity=2.0)
    scene.add(arm, bead, fmbd.revolute("axle", fmbd.ground, arm, center=(0, 0)))
    scene.add(fmbd.prismatic("wire", arm, bead, axis=(1, 0), center=(0, 0)))
    scene.add(fmbd.drive_rotation("motor", fmbd.ground, arm, lambda t: (2.0 * t, 2.0, 0.0)))
    scene.sensor("place", fmbd.position(bead))
    return scene


def gears() -> fmbd.Scene:
    """Two wheels in a gear of 1 : 2, a torque of 3 N m on the first."""
    scene, pins = fmbd.Scene("gears"), []
    for k in range(2):
        wheel = fmbd.RigidBody(f"wheel {k}", 1.0, 1.0 + k, (float(3 * k), 0.0))
        pins.append(fmbd.revolute(f"pin {k}", fmbd.ground, wheel, center=(3.0 * k, 0.0)))
        scene.add(wheel, pins[-1])
    scene.add(fmbd.gear("gear", fmbd.angle(pins[0]), fmbd.angle(pins[1]), ratio=2.0))
    scene.add(fmbd.torque("torque", scene.bodies["wheel 0"], lambda t: 3.0 * np.cos(t)))
    scene.sensor("turns", fmbd.angle(pins[0]))
    return scene


# -- in space -------------------------------------------------------------------------------------------------------
def top(spin: tuple[float, ...], J: tuple[float, ...], mass: float, *, held: bool) -> fmbd.Scene:
    """A body with its centre at (0, 1, 0), on a ball at the origin or free."""
    scene = fmbd.Scene("top", gravity=(0, 0, -G) if held else None)
    v = tuple(np.cross(spin, (0.0, 1.0, 0.0))) if held else None
    body = fmbd.RigidBody("top", mass, J, (0.0, 1.0, 0.0), velocity=v, angular_velocity=spin)
    scene.add(body)
    if held:
        scene.add(fmbd.spherical("tip", fmbd.ground, body, center=(0, 0, 0)))
        scene.sensor("place", fmbd.position(body))
    else:
        scene.sensor("place", fmbd.position(body, point=(0.0, 2.0, 0.0)))
    return scene


def top_end(spin: Any, J: Any, mass: float, t_end: float, *, held: bool) -> Any:
    """By Euler's equations about the fixed point (or the centre), the axis carried along."""
    m = mass if held else 0.0
    inertia = np.array(J) + m * np.array([1.0, 0.0, 1.0])

    def rate(t: float, y: Any) -> Any:
        R, w = y[:9].reshape(3, 3), y[9:]
        torque = np.cross([0.0, 1.0, 0.0], R.T @ [0.0, 0.0, -m * G])
        W = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.concatenate(((R @ W).ravel(), (torque - np.cross(w, inertia * w)) / inertia))

    R = ordinary(rate, np.concatenate((np.eye(3).ravel(), spin)), t_end)[:9].reshape(3, 3)
    return R[:, 1] + (0.0 if held else np.array([0.0, 1.0, 0.0]))


HEAVY, FAST = ((0.0, 150.0, -4.61538), (0.234375, 0.46875, 0.234375), 15.0), ((0.5, 1.0, 6.0), (0.1, 0.2, 0.25), 2.0)


MOTIONS: dict[str, Problem] = {
    "pendulum, Cartesian": Problem(pendulum, 2.0, "x", lambda: pendulum_at(2.0)[0], "ordinary equations"),
    "car axis": Problem(car_axis.scene, 3.0, "ends", lambda: car_axis.REFERENCE, "IVP test set, own run to 1e-13", 1500),
    "Andrews' mechanism": Problem(
        andrews_model.scene, 0.03, "angles", lambda: andrews_model.REFERENCE, "IVP test set, own run to 1e-10", 300
    ),
    "flexible slider crank": Problem(
        lambda: crank_model.scene(crank_model.Rod(), crank_model.SMOOTH), 0.1, "coordinates", lambda: np.array(CRANK),
        "IVP test set, state space by DOP853", 1000,
    ),
    "mass on spring": Problem(
        on_spring, 3.0, "place", lambda: [0.0, -1 - 0.3924 * (1 - np.cos(15.0))], "exact", 100, "mass on spring"
    ),
    "compound pendulum": Problem(
        compound, 3.0, "place", lambda: compound_end(0.0, 3.0), "ordinary equations", 200, "compound pendulum"
    ),
    "damped pendulum": Problem(
        lambda: compound(0.2), 3.0, "place", lambda: compound_end(0.2, 3.0), "ordinary equations", 200
    ),
    "double pendulum": Problem(
        double, 1.0, "place", lambda: double_end(1.0), "ordinary equations", 100, "double pendulum"
    ),
    "spring pendulum": Problem(
        spring_pendulum, 2.0, "place", lambda: spring_pendulum_end(2.0), "ordinary equations", 200, "spring pendulum"
    ),
    "stiff spring pendulum": Problem(
        lambda: spring_pendulum(1e5), 1.0, "place", lambda: spring_pendulum_end(1.0, 1e5), "ordinary equations", 400,
        "stiff spring pendulum",
    ),
    "bead on an arm": Problem(
        on_arm, 1.0, "place", lambda: 0.5 * np.cosh(2.0) * np.array([np.cos(2.0), np.sin(2.0)]), "exact"
    ),
    "gears": Problem(gears, 3.0, "turns", lambda: [3.0 * (1 - np.cos(3.0)) / (1.0 + 4.0 * 2.0)], "exact"),
    "heavy top": Problem(
        lambda: top(*HEAVY, held=True), 0.1, "place", lambda: top_end(*HEAVY, 0.1, held=True), "Euler's equations", 250,
        "heavy top",
    ),
    "fast top": Problem(
        lambda: top(*FAST, held=True), 1.0, "place", lambda: top_end(*FAST, 1.0, held=True), "Euler's equations", 100, "fast top"
    ),
    "free body": Problem(
        lambda: top(*FAST, held=False), 2.0, "place", lambda: top_end(*FAST, 2.0, held=False), "Euler's equations", 200,
        "free body",
    ),
}  # fmt: skip
