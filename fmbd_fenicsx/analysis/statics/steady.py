"""Steady motion of a scene: rest, or rotation of everything about one axis with a constant angular velocity.

    x' = W x (x - c),   x'' = W x (W x (x - c)),   W = rate axis                                             (1)

for the origins of all frames and the nodes of absolute bodies; attitudes turn with R^T W in body axes, coordinates in body axes
stay as they are. The residual of an equilibrium is the balance of forces with these velocities and accelerations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...checks import check_fields, vector
from ...errors import require
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.system import System

if TYPE_CHECKING:
    from ..vibration.rotors import BodySpin


@dataclass(frozen=True)
class Spin:
    """Rotation of a whole scene, ``rate`` in rad/s, about an ``axis`` (world axes, z in the plane) through ``center`` (m).

    ``bodies``: names of bodies that spin instead, each about this axis through its own frame, while all others rest: round rotors
    in their bearings, see :mod:`..vibration.rotors`.
    """

    rate: float
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    center: Sequence[float] = (0.0, 0.0, 0.0)
    bodies: Sequence[str] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        size = float(np.linalg.norm(vector("Spin: axis", self.axis, size=3)))
        require(abs(size - 1.0) < 1e-9, f"Spin: axis {self.axis} must be a unit vector (x, y, z).")
        require(len(self.center) in (2, 3), f"Spin: center {self.center} must be a point (x, y) or (x, y, z), m.")

    def matrix(self, dim: int) -> Array:
        """W x as a matrix (d, d)."""
        x, y, z = self.rate * np.asarray(self.axis, dtype=float)
        if dim == 2:
            return np.array([[0.0, -self.rate], [self.rate, 0.0]])
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])

    def rates(self, system: System, q: Array) -> tuple[Array, Array]:
        """v and a of (1) in the configuration q, like v."""
        v, a = np.zeros(system.n_v), np.zeros(system.n_v)
        m, d = system.motions, system.motions.dim
        W = self.matrix(d)

        center = np.array([*self.center, 0.0])[:d]  # of a plane scene, or one of space with z = 0
        pose = system.poses(q)
        # v = W x (r - c), a = W x v; angular velocity in body axes
        arm = (pose[:-1, :d] - center) @ W.T

        twist = np.zeros((system.n_frames, m.n_twist))
        twist[:, :d] = arm
        if d == 2:
            twist[:, 2] = self.rate
        else:
            axis = self.rate * np.asarray(self.axis, dtype=float)
            twist[:, d:] = np.swapaxes(m.matrix(pose)[:-1], 1, 2) @ axis
        accel = np.zeros_like(twist)
        accel[:, :d] = arm @ W.T
        v[: twist.size], a[: twist.size] = twist.ravel(), accel.ravel()

        # bodies without a frame turn node by node
        for k, p in system.fields:
            if p.frame == system.n_frames:
                at = system.slices[1][k]
                x = p.field.X_world + system.local_q(q, k).reshape(-1, d)
                v[at] = ((x - center) @ W.T).ravel()
                a[at] = ((x - center) @ W.T @ W.T).ravel()
        return v, a


def steady_rates(system: System, q: Array, spin: Spin | BodySpin | None) -> tuple[Array, Array]:
    """v and a of a steady motion in the configuration q, like v; zero at rest."""
    if spin is None or spin.rate == 0.0:
        return np.zeros(system.n_v), np.zeros(system.n_v)
    return spin.rates(system, q)


@dataclass(frozen=True, eq=False)
class Residual:
    """The equations of an equilibrium, balance(q, lambda, t) = 0 and g(q, t) = 0, at rest or under a steady spin."""

    system: System
    spin: Spin | BodySpin | None = None

    def at(self, q: Array, t: float) -> Evaluation:
        """The system in a configuration, with its steady velocities; collective."""
        return self.system.at(t, q, steady_rates(self.system, q, self.spin)[0])

    def values(self, ev: Evaluation, lam: Array, more: Array | float = 0.0) -> tuple[Array, Array]:
        """Balance, like v, and constraints (n_lam,); ``more``: accelerations beside the steady ones. Collective."""
        a = steady_rates(self.system, ev.q, self.spin)[1] + more
        return ev.balance(a, lam), ev.constraint()

    def by_time(self, q: Array, lam: Array, t: float, step: float) -> tuple[Array, Array]:
        """Derivative of both by t, central differences over ``step``; collective."""
        after, before = (self.values(self.at(q, x), lam) for x in (t + step, t - step))

        return (after[0] - before[0]) / (2 * step), (after[1] - before[1]) / (2 * step)
