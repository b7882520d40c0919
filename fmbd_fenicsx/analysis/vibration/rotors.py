"""Steady rotation of some bodies, each about an axis of its own, while all others rest: a rotor in its bearings.

    x' = 0,   omega = rate axis   (the axis fixed in the body),   x'' = 0,   omega' = 0                       (1)

A shaft that sags spins in its bent shape: each section about its own tangent. The motion is steady where nothing changes as these
bodies turn: they are round about their axes, their mass centres lie on them, loads on them do not turn. That is looked at: turned
by some angles they must be in equilibrium as well. Other than about a rotation of the whole scene (:mod:`..statics.steady`),
bearings and foundations may have different stiffness in different directions, and weights may act across the axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, near, require
from ...rotations import Array
from ...system.system import State, System

if TYPE_CHECKING:
    from ..statics.static_newton import StaticNewton, StaticPoint
    from ..statics.steady import Spin
    from .perturbation import Perturbation

ANGLES = (1.0, 2.5)  # by which bodies are turned, rad
CHANGED = 1e-6  # increment, over the model's length, and speed, over that of the rotation, which are none
ROUND = 1e-5  # relative difference of forces that is none


@dataclass(frozen=True, eq=False)
class BodySpin:
    """(1) in a system: ``names`` of the bodies, their ``frames`` (k,), and ``axes`` (k, n_rot), unit vectors in body axes."""

    rate: float
    names: tuple[str, ...]
    frames: np.ndarray
    axes: Array

    def rates(self, system: System, q: Array) -> tuple[Array, Array]:
        """v and a of (1), like v."""
        return self._turns(system, self.rate), np.zeros(system.n_v)

    def turned(self, system: System, q: Array, angle: float) -> Array:
        """The configuration with these bodies turned by an angle, rad."""
        return np.asarray(system.compose(q, self._turns(system, angle)))

    def carried(self, system: System, y: Array, angle: float) -> Array:
        """A motion or force like v, the rotations of these bodies told in axes that have been turned by an angle."""
        m = system.motions
        if m.dim == 2:
            return y
        out = y.copy()
        turns = out[: system.n_frames * m.n_twist].reshape(-1, m.n_twist)[:, m.dim :]
        for i, n in zip(self.frames, self.axes, strict=True):
            x = turns[i]
            along = (n @ x) * n
            turns[i] = along + np.cos(angle) * (x - along) - np.sin(angle) * np.cross(n, x)
        return out

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
        system.contacts is None,
        "equilibrium: spin=fmbd.Spin(..., bodies=...) does not take contact or joint limits.",
    )
    names = system.frame_names
    frames = [i for name in spin.bodies for i in _frames_of(name, names)]
    m = system.motions
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


def check_steady(newton: StaticNewton, point: StaticPoint, t: float) -> None:
    """Refuse what holds the bodies that spin, and equilibria that change as they turn; collective."""
    system, spin = newton.residual.system, newton.residual.spin
    if not isinstance(spin, BodySpin) or spin.rate == 0.0:
        return

    _check_held(system, newton.residual.at(point.q, t), spin)

    # what turns must leave forces and gaps as they are
    lam = point.lam
    for angle in ANGLES:
        q = spin.turned(system, point.q, angle)
        newton.take(replace(point, q=q), t)

        there, later = (newton.residual.at(q, x) for x in (t, t + angle / spin.rate))
        balance = newton.residual.values(there, lam)[0]
        gaps = later.constraint()

        moved = system.max_abs(newton.solver.solve(-balance, -gaps)[0])
        if moved > CHANGED * system.length:
            raise InputError(
                f"The rotation of {_listed(spin)} is not steady: turned by {angle:g} rad, the scene moves by {moved:.3g} m. "
                "Bodies that spin among others at rest must be round about their axes, with the mass centre on it and loads that "
                "do not turn with them."
            )


def _check_held(system: System, ev: Any, spin: BodySpin) -> None:
    """Refuse joints and drives that the rotation violates."""
    if not system.n_lam:
        return
    missed = np.abs(ev.opening())
    row = int(missed.argmax())
    if missed[row] > CHANGED * abs(spin.rate) * max(system.length, 1.0):
        name = next(b.name for b in system.blocks if b.rows.start <= row < b.rows.stop)
        raise InputError(
            f'"{name}" does not let {_listed(spin)} spin with {spin.rate:g} rad/s: it would open with {missed[row]:.3g} (rad/s, '
            "m/s). Name all bodies that turn, and give drives the same rate."
        )


def check_round(about: Perturbation, spin: BodySpin) -> None:
    """Refuse bodies whose inertia or stiffness changes as they turn: small motions would have periodic coefficients.

    Elastic bodies in moving frames are taken as round.
    """
    from .basis import random_motion
    from .perturbation import Perturbation

    system, s = about.system, about.state
    if any(p.frame in spin.frames for _, p in system.fields):
        return
    none = np.zeros(system.n_lam)
    before = Perturbation(system, State(s.t, s.q, s.v, s.a, none))
    after = Perturbation(system, State(s.t, spin.turned(system, s.q, ANGLES[0]), s.v, s.a, none))
    y = random_motion(about, 0)
    turned = spin.carried(system, y, ANGLES[0])
    for name in ("mass", "damping", "stiffness"):
        force = spin.carried(system, _product(before, name, y), ANGLES[0])
        change = system.max_abs(_product(after, name, turned) - force)
        if change > ROUND * system.max_abs(force):
            raise InputError(
                f"The {name} of {_listed(spin)} changes as they turn: bodies that spin among others at rest must be round about "
                "their axes. Take the rotation of the whole scene (Spin without bodies) for rotors that are not."
            )


def _product(about: Perturbation, name: str, y: Array) -> Array:
    """M y, C y or K y."""
    return {"mass": about.mass, "damping": about.damping, "stiffness": about.stiffness}[name](y)


def _listed(spin: BodySpin) -> str:
    return ", ".join(f'"{name}"' for name in spin.names)
