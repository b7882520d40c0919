"""Small problems with known solutions that the tests of the schemes share."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.linear.condensation import StepSolver
from fmbd_fenicsx.schemes.consistent import consistent
from fmbd_fenicsx.schemes.newton import Newton

GRAVITY = 9.81


def pendulum(angle: float = 1.0, rate: float = 1.0, gravity: float = GRAVITY) -> fmbd.Scene:
    """A point mass (1 kg) on a rod (1 m), Cartesian coordinates; ``angle`` from the downward vertical."""
    x = np.array([np.sin(angle), -np.cos(angle)])
    v = rate * np.array([np.cos(angle), np.sin(angle)])
    scene = fmbd.Scene("pendulum")
    scene.add(
        fmbd.CoordinateBody(
            "mass",
            np.eye(2),
            lambda q, v, t: np.array([0.0 * q[0], 0.0 * q[1] - gravity]),
            x,
            v,
            constraint=lambda q, t: np.array([0.5 * (q[0] ** 2 + q[1] ** 2 - 1)]),
            jacobian=lambda q, t: q[None],
            gamma=lambda q, v, t: np.array([v[0] ** 2 + v[1] ** 2]),
            potential=lambda q: gravity * q[1],
            vectorized=True,
        )
    )
    scene.sensor("x", fmbd.coordinates("mass", unit="m"))
    scene.sensor("v", fmbd.coordinates("mass", level=1, unit="m/s"))
    return scene


@lru_cache
def pendulum_at(t: float, angle: float = 1.0, rate: float = 1.0, gravity: float = GRAVITY) -> tuple[Any, Any, float]:
    """Position, velocity and multiplier of the pendulum at time t, from its angle by DOP853."""
    run = solve_ivp(
        lambda t, y: [y[1], -gravity * np.sin(y[0])],
        [0, t],
        [angle, rate],
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    angle, rate = run.y[:, -1]
    x = np.array([np.sin(angle), -np.cos(angle)])
    return x, rate * np.array([np.cos(angle), np.sin(angle)]), rate**2 + gravity * np.cos(angle)


def march(scene: fmbd.Scene, scheme: Any, t_end: float, steps: int, tolerance: float = 1e-11) -> list[Any]:
    """All states of a run with constant steps, Newton tight."""
    system, given, _ = scene.build()
    solver = StepSolver(system)
    start, _ = consistent(system, given, solver)
    stepper = scheme.stepper(system, solver, Newton(tolerance, 25), start)
    return [start] + [stepper.advance(t_end / steps) for _ in range(steps)]


def pendulum_errors(scheme: Any, t_end: float, steps: int, tolerance: float = 1e-11) -> np.ndarray:
    """Errors of position, velocity and multiplier at the end, (3,)."""
    x, v, lam = pendulum_at(t_end)
    end = march(pendulum(), scheme, t_end, steps, tolerance)[-1]
    return np.array([np.abs(end.q - x).max(), np.abs(end.v - v).max(), abs(abs(end.lam[0]) - abs(lam))])


def observed(scheme: Any, steps: tuple[int, ...], t_end: float = 1.0, tolerance: float = 1e-11) -> np.ndarray:
    """Orders of q, v, lambda: slopes of the least-squares lines through the errors, (3,)."""
    errors = np.array([pendulum_errors(scheme, t_end, n, tolerance) for n in steps])
    h = -np.log(np.array(steps, dtype=float))
    return np.array([np.polyfit(h, np.log(e), 1)[0] for e in errors.T])


def spinning_top() -> fmbd.Scene:
    """A spatial rigid body on a ball joint: rotations of SO(3) and their multipliers."""
    scene = fmbd.Scene("top", gravity=(0, 0, -9.81))
    body = fmbd.RigidBody("top", 2.0, (0.1, 0.2, 0.25), position=(0.3, 0, 0.1), angular_velocity=(0.5, 1.0, 6.0),
                          velocity=tuple(np.cross((0.5, 1.0, 6.0), (0.3, 0, 0.1))))  # fmt: skip
    scene.add(body)
    scene.add(fmbd.spherical("tip", body, fmbd.ground, center=(0, 0, 0)))
    return scene


def state_errors(scene: fmbd.Scene, a: Any, b: Any) -> np.ndarray:
    """Differences of two states in q, v, lambda, (3,)."""
    system = scene.build()[0]
    return np.array([np.abs(system.difference(a.q, b.q)).max(), np.abs(a.v - b.v).max(), np.abs(a.lam - b.lam).max()])


def parallelograms(n: int, rate: float, angle: float = np.pi / 2, gravity: float = GRAVITY) -> fmbd.Scene:
    """n four-bar linkages side by side, legs and bars of 1 m and 1 kg; legs at an ``angle`` from the ground, turning (rad/s)."""
    up = np.array([np.cos(angle), np.sin(angle)])
    along = rate * np.array([-up[1], up[0]])
    scene = fmbd.Scene("parallelograms", gravity=(0.0, -gravity))
    legs = [
        fmbd.RigidBody(f"leg {i}", 1.0, 1 / 12, (i, 0.0) + 0.5 * up, angle, 0.5 * along, rate) for i in range(n + 1)
    ]
    bars = [fmbd.RigidBody(f"bar {i}", 1.0, 1 / 12, (i + 0.5, 0.0) + up, 0.0, along) for i in range(n)]
    scene.add(*legs, *bars)
    scene.add(*(fmbd.revolute(f"A{i}", fmbd.ground, leg, center=(i, 0.0)) for i, leg in enumerate(legs)))
    for i, bar in enumerate(bars):
        scene.add(fmbd.revolute(f"B{i}", legs[i], bar, center=(i, 0.0) + up))
        scene.add(fmbd.revolute(f"C{i}", bar, legs[i + 1], center=(i + 1, 0.0) + up))
    scene.sensor("top", fmbd.position(legs[0], point=up))
    return scene


def double_four_bar() -> fmbd.Scene:
    """Two of them, whose tops start with 1 m/s; flat at 0.714 s, three freedoms there in place of one (IFToMM A02)."""
    return parallelograms(2, -1.0)


def torqued_links(torque: Callable[[float], Any], *breakpoints: float) -> fmbd.Scene:
    """Two links in space that fall, with a torque (3,) (N m) of time on the last one; sensor "end"."""
    scene, last = fmbd.Scene("torqued links", gravity=(0, 0, -9.81), breakpoints=breakpoints), fmbd.ground
    for k in range(2):
        link = fmbd.RigidBody(f"link {k}", 1.0 + k, (0.01, 0.06, 0.05), (0.4 * k + 0.2, 0, 0))
        scene.add(link, fmbd.revolute(f"pin {k}", last, link, center=(0.4 * k, 0, 0), axis=(0, 1, 0.2 * k)))
        last = link
    scene.add(fmbd.torque("motor", last, torque))
    scene.sensor("end", fmbd.position(last))
    return scene
