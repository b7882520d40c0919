"""Problems of the observatory: vibrations, orbits and linkages whose motion is known exactly or has one or two coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
from dae_problems import double_four_bar
from observatory_problem import Problem, ordinary
from scipy.integrate import quad
from scipy.optimize import brentq

import fmbd_fenicsx as fmbd

G = 9.81
ORDINARY = "ordinary equations"


# -- vibrations -----------------------------------------------------------------------------------------------------
def guided(scene: fmbd.Scene, name: str, place: float, mass: float = 1.0) -> fmbd.RigidBody:
    """A body that slides along x, added to the scene."""
    body = fmbd.RigidBody(name, mass, 1.0, (place, 0.0))
    scene.add(body, fmbd.prismatic(f"guide of {name}", fmbd.ground, body, axis=(1, 0), center=(0, 0)))
    return body


def forced() -> fmbd.Scene:
    """1 kg on 100 N/m and 1 N s/m, a force of 10 cos(7 t) N, from rest at x = 1 m."""
    scene = fmbd.Scene("forced oscillator")
    body = guided(scene, "mass", 1.0)
    scene.add(fmbd.Spring("spring", fmbd.ground, body, stiffness=100.0, damping=1.0, length=1.0))
    scene.add(fmbd.force("shaker", body, lambda t: (10.0 * np.cos(7.0 * t), 0.0)))
    scene.sensor("place", fmbd.position(body))
    return scene


def forced_end(t: float) -> Any:
    """Steady vibration and decaying one."""
    steady = 10.0 / (100.0 - 49.0 + 7.0j)
    root = -0.5 + 1j * np.sqrt(100.0 - 0.25)
    rest, rate = -steady.real, -(7j * steady).real
    decaying = rest - 1j * (rate - root.real * rest) / root.imag  # Re z = rest, Re(root z) = rate
    return [1.0 + (steady * np.exp(7j * t)).real + (decaying * np.exp(root * t)).real, 0.0]


def two_masses() -> fmbd.Scene:
    """Two masses of 1 kg on three springs of 100 N/m between walls, the left one struck with 1 m/s."""
    scene = fmbd.Scene("two masses")
    left = fmbd.RigidBody("left", 1.0, 1.0, (1.0, 0.0), velocity=(1.0, 0.0))
    scene.add(left, fmbd.prismatic("guide of left", fmbd.ground, left, axis=(1, 0), center=(0, 0)))
    right = guided(scene, "right", 2.0)
    scene.add(fmbd.Spring("first", fmbd.ground, left, stiffness=100.0, length=1.0))
    scene.add(fmbd.Spring("second", left, right, stiffness=100.0, length=1.0))
    scene.add(fmbd.Spring("third", right, fmbd.ground, (2.0, 0.0), (3.0, 0.0), stiffness=100.0, length=1.0))
    scene.sensor("place", fmbd.position(right))
    return scene


def two_masses_end(t: float) -> Any:
    """Two modes, 10 and 10 sqrt(3) rad/s."""
    slow, fast = 10.0, 10.0 * np.sqrt(3.0)
    return [2.0 + 0.5 * (np.sin(slow * t) / slow - np.sin(fast * t) / fast), 0.0]


def cart() -> fmbd.Scene:
    """A bar of 1 m and 1 kg falls from the horizontal on a cart of 2 kg that rolls freely."""
    scene = fmbd.Scene("cart and pendulum", gravity=(0.0, -G))
    waggon = guided(scene, "cart", 0.0, 2.0)
    bar = fmbd.RigidBody("bar", 1.0, 1 / 12, (0.5, 0.0))
    scene.add(bar, fmbd.revolute("pin", waggon, bar, center=(0, 0)))
    scene.sensor("place", fmbd.position(waggon))
    return scene


def cart_end(t_end: float) -> Any:
    """By the angle alone: the common centre of mass keeps its x."""

    def rate(t: float, y: Any) -> Any:
        s, c = np.sin(y[0]), np.cos(y[0])
        # 1/2 (1/3 - s^2 / 12) w^2 - 1/2 g s = const, with the cart at -(c - 1) / 6
        inertia, slope = 1 / 3 - s * s / 12, -s * c / 6
        return [y[1], (0.5 * G * c - 0.5 * slope * y[1] ** 2) / inertia]

    return [(1.0 - np.cos(ordinary(rate, [0.0, 0.0], t_end)[0])) / 6, 0.0]


# -- orbits ---------------------------------------------------------------------------------------------------------
def orbit() -> fmbd.Scene:
    """A mass of 1 kg attracted by 1 N m^2 / r^2, eccentricity 0.5, half axis 1 m, from the nearest point."""
    scene = fmbd.Scene("Kepler's orbit")
    body = fmbd.RigidBody("planet", 1.0, 1.0, (0.5, 0.0), velocity=(0.0, np.sqrt(3.0)))
    scene.add(body, fmbd.Spring("sun", fmbd.ground, body, law=lambda r, rate, t: 1.0 / r**2))
    scene.sensor("place", fmbd.position(body))
    return scene


def orbit_end(t: float) -> Any:
    """By Kepler's equation."""
    E = brentq(lambda E: E - 0.5 * np.sin(E) - t, t - 1.0, t + 1.0, xtol=1e-15)
    return [np.cos(E) - 0.5, np.sqrt(0.75) * np.sin(E)]


# -- linkages -------------------------------------------------------------------------------------------------------
R, ARM, SPEED = 0.15, 0.30, 150.0
M = (0.36, 0.151104, 0.075552)
J = (0.002727 - 0.36 * R**2 / 4, 0.0045339259 - 0.151104 * 0.15**2)  # about the centres of mass


def crank() -> fmbd.Scene:
    """The rigid slider crank of the IVP test set coasts."""
    w = -R / ARM * SPEED
    one = fmbd.RigidBody("crank", M[0], J[0], (R / 2, 0), velocity=(0, SPEED * R / 2), angular_velocity=SPEED)
    two = fmbd.RigidBody("rod", M[1], J[1], (R + ARM / 2, 0), velocity=(0, SPEED * R / 2), angular_velocity=w)
    block = fmbd.RigidBody("block", M[2], 1e-4, (R + ARM, 0))
    scene, pin = fmbd.Scene("slider crank"), fmbd.revolute("pin", fmbd.ground, one, center=(0, 0))
    scene.add(one, two, block, pin, fmbd.revolute("knee", one, two, center=(R, 0)))
    scene.add(fmbd.revolute("wrist", two, block, center=(R + ARM, 0)))
    scene.add(fmbd.prismatic("slider", fmbd.ground, block, axis=(1, 0), center=(R + ARM, 0)))
    scene.sensor("phi", fmbd.angle(pin))
    return scene


def crank_pace(phi: float) -> float:
    """Root of the inertia that the angle of the crank sees, kg^1/2 m: its rate falls as this grows."""
    inner = np.arcsin(R * np.sin(phi) / ARM)
    w = R * np.cos(phi) / (ARM * np.cos(inner))
    x, y = -R * np.sin(phi) - 0.5 * ARM * w * np.sin(inner), R * np.cos(phi) - 0.5 * ARM * w * np.cos(inner)
    s = x - 0.5 * ARM * w * np.sin(inner)
    return float(np.sqrt(J[0] + M[0] * R**2 / 4 + J[1] * w**2 + M[1] * (x**2 + y**2) + M[2] * s**2))


CRANK_TURN = quad(crank_pace, 0, 2 * np.pi, epsabs=1e-14, limit=400)[0] / (crank_pace(0.0) * SPEED)  # s


def four_bar_end(t_end: float) -> Any:
    """By the angle a of the legs from the vertical: three legs of 1/3 kg m^2 and two carried bars, 3 a'' = 3.5 g sin a."""
    a = ordinary(lambda t, y: [y[1], 3.5 * G * np.sin(y[0]) / 3.0], [0.0, 1.0], t_end)[0]
    return [np.sin(a), np.cos(a)]


OSCILLATORS: dict[str, Problem] = {
    "forced oscillator": Problem(forced, 2.0, "place", lambda: forced_end(2.0), "exact", 200),
    "two masses": Problem(two_masses, 2.0, "place", lambda: two_masses_end(2.0), "exact", 200, "two masses"),
    "cart and pendulum": Problem(cart, 1.0, "place", lambda: cart_end(1.0), ORDINARY),
    "Kepler's orbit": Problem(orbit, 5.0, "place", lambda: orbit_end(5.0), "exact (Kepler's equation)", 250),
    "slider crank": Problem(crank, CRANK_TURN, "phi", lambda: [2 * np.pi], "exact up to a quadrature (energy)", 200),
    "double four-bar": Problem(
        double_four_bar, 1.0, "top", lambda: four_bar_end(1.0), "ordinary equations (IFToMM A02)"
    ),
}
