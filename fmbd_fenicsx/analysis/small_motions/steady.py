"""Steady motion of a scene: rest, or rotation of everything about one axis with a constant angular velocity.

    x' = W x (x - c),   x'' = W x (W x (x - c)),   W = rate axis                                             (1)

for the origins of all frames and the nodes of absolute bodies; attitudes turn with R^T W in body axes, coordinates in body axes
stay as they are. The residual of an equilibrium is the balance of forces with these velocities and accelerations.

Or some bodies turn, each about an axis of its own, while all others rest: a rotor in its bearings.

    x' = 0,   omega = rate axis   (the axis fixed in the body),   x'' = 0,   omega' = 0                       (2)

A shaft that sags spins in its bent shape: each section about its own tangent. The motion is steady where nothing changes as these
bodies turn: they are round about their axes, their mass centres lie on them, loads on them do not turn
(:mod:`..statics.equilibrium`). Other than about a rotation of the whole scene, bearings and foundations may have different
stiffness in different directions, and weights may act across the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...checks import check_fields, vector
from ...errors import InputError, near, require
from ...rotations import Array, spin_matrix
from ...system.evaluation import Evaluation
from ...system.system import System

# of messages about rotors that are not round
MOUNTS = "A bushing that resists tilts feels the turn: let it hold a light ring, in which the rotor turns on a hinge."


@dataclass(frozen=True)
class Spin:
    """Rotation of a whole scene, ``rate`` in rad/s, about an ``axis`` (world axes, z in the plane) through ``center`` (m).

    ``bodies``: names of bodies that spin instead, each about this axis through its own frame, while all others rest: round rotors
    in their bearings, (2) of the module. They have no ``center``.
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
        require(
            not (any(self.center) and self.bodies),
            f"Spin: bodies turn about their own frames, so center = {self.center} has no effect. Leave it out.",
        )

    def matrix(self, dim: int) -> Array:
        """W x as a matrix (d, d); refuses axes other than z in the plane."""
        require(dim == 3 or self.axis[2] > 1 - 1e-9, f"Spin: axis {self.axis} must be (0, 0, 1) in the plane.")
        return spin_matrix(self.rate * np.asarray((1.0,) if dim == 2 else self.axis, dtype=float))

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


@dataclass(frozen=True, eq=False)
class BodySpin:
    """(2) in a system: ``names`` of the bodies, their ``frames`` (k,), and ``axes`` (k, n_rot), unit vectors in body axes."""

    rate: float
    names: tuple[str, ...]
    frames: np.ndarray
    axes: Array

    @property
    def listed(self) -> str:
        """The names of the bodies, for messages."""
        return ", ".join(f'"{name}"' for name in self.names)

    def rates(self, system: System, q: Array) -> tuple[Array, Array]:
        """v and a of (2), like v."""
        return self._turns(system, self.rate), np.zeros(system.n_v)

    def turned(self, system: System, q: Array, angle: float) -> Array:
        """The configuration with these bodies turned by an angle, rad."""
        return np.asarray(system.compose(q, self._turns(system, angle)))

    def _turns(self, system: System, amount: float) -> Array:
        """An array like v with rotations by ``amount`` about the axes."""
        m = system.motions
        out = np.zeros(system.n_v)
        twists = out[: system.n_frames * m.n_twist].reshape(-1, m.n_twist)
        twists[self.frames, m.dim :] = amount * self.axes
        return out


def body_spin(system: System, q: Array, spin: Spin) -> BodySpin:
    """The rotation of ``spin.bodies`` from the placement q on.

    Raises InputError for bodies that have no axes of their own, and for contact.
    """
    require(
        system.contacts is None, "equilibrium: spin=fmbd.Spin(..., bodies=...) does not take contact or joint limits."
    )
    names = system.frame_names
    frames = [i for name in spin.bodies for i in _frames_of(name, names)]
    m = system.motions
    spin.matrix(m.dim)  # refuses
    if m.dim == 2:
        return BodySpin(spin.rate, tuple(spin.bodies), np.array(frames), np.ones((len(frames), 1)))
    R = m.matrix(system.poses(q))[frames]
    axes = np.swapaxes(R, 1, 2) @ np.asarray(spin.axis, dtype=float)
    return BodySpin(spin.rate, tuple(spin.bodies), np.array(frames), axes)


def _frames_of(name: str, names: Sequence[str]) -> list[int]:
    """The frames of a body: its own, or those of the nodes of a rod."""
    from ...mechanics.rods.rods import node_name

    if name in names:
        return [names.index(name)]
    first = node_name(name, 0)
    if first not in names:
        known = dict.fromkeys(x.split(", node ")[0] for x in names)
        raise InputError(
            f'Spin: bodies has "{name}", which is no rigid body, rod or body in a moving frame. {near(name, list(known))}'
        )
    start = names.index(first)
    count = next(k for k in range(len(names) + 1) if node_name(name, k) not in names)
    return list(range(start, start + count))


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
