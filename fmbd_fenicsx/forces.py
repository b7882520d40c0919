"""Applied forces between markers: each force law returns wrenches in world axes, evaluated once a residual.

A user's law is checked on every call: the result must have the right shape and be finite, else the error names the force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .errors import CallbackError, InputError, require
from .frames import Kinematics
from .rotations import Array

Law = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class Force:
    """A force (and torque) on one or two attachments. ``evaluate(kin, marker_a, marker_b, t)`` adds to the wrenches.

    Subclasses hold the attachments ``a``, ``b`` (None for one-sided) and their points in world coordinates at the start.
    """

    name: str
    a: Any
    b: Any = None
    point_a: Sequence[float] | None = None
    point_b: Sequence[float] | None = None

    def wrench(self, kin: Kinematics, a: int, b: int, t: float) -> tuple[Array, Array]:
        """Wrenches (force, torque) on markers a and b in world axes, each (d + n_rot,)."""
        raise NotImplementedError

    def energy(self, kin: Kinematics, a: int, b: int, t: float) -> float:
        """Potential energy, J (0 for forces without one)."""
        return 0.0

    def checked(self, value: Any, size: int, t: float) -> Array:
        """A user's result as an array of the right size, or an error that names this force."""
        found = np.asarray(value, dtype=float)
        if found.shape != (size,):
            raise CallbackError(
                f'Force "{self.name}": the law returned shape {found.shape} at t = {t:g} s, expected ({size},).'
            )
        if not np.isfinite(found).all():
            raise CallbackError(f'Force "{self.name}": the law returned {found} at t = {t:g} s.')
        return found


@dataclass(frozen=True, eq=False)
class PointForce(Force):
    """A force law(t) in N, (d,), on a point of a body or on a surface (its mean displacement); ``follower``: body axes."""

    law: Law = None  # type: ignore[assignment]
    follower: bool = False

    def wrench(self, kin: Kinematics, a: int, b: int, t: float) -> tuple[Array, Array]:
        d = kin.x.shape[1]
        out = np.zeros(kin.jac_frame.shape[1])
        f = self.checked(self.law(t), d, t)
        out[:d] = kin.R[a] @ f if self.follower else f
        return out, np.zeros_like(out)


@dataclass(frozen=True, eq=False)
class Torque(Force):
    """A torque law(t) in N m on a body: a number (plane) or (3,) in world axes (space); ``follower``: body axes."""

    law: Law = None  # type: ignore[assignment]
    follower: bool = False

    def wrench(self, kin: Kinematics, a: int, b: int, t: float) -> tuple[Array, Array]:
        d = kin.x.shape[1]
        out = np.zeros(kin.jac_frame.shape[1])
        n = len(out) - d
        torque = self.checked(np.atleast_1d(self.law(t)), n, t)
        out[d:] = kin.R[a] @ torque if self.follower and n == 3 else torque
        return out, np.zeros_like(out)


@dataclass(frozen=True, eq=False)
class Spring(Force):
    """Spring and damper between two points: tension N(s, s') along the line, s the elongation from ``length`` (m).

    Linear: N = stiffness s + damping s'. A user's law(s, rate, t) -> N replaces it. Points must not coincide.
    """

    stiffness: float = 0.0  # N/m
    damping: float = 0.0  # N s/m
    length: float = 0.0  # m, unstressed
    law: Law | None = None

    def _line(self, kin: Kinematics, a: int, b: int) -> tuple[Array, float]:
        d = kin.x[b] - kin.x[a]
        length = float(np.linalg.norm(d))
        if length == 0.0:
            raise InputError(f'Spring "{self.name}": its two points coincide, so it has no direction.')
        return d / length, length - self.length

    def wrench(self, kin: Kinematics, a: int, b: int, t: float) -> tuple[Array, Array]:
        assert kin.twist is not None
        dim = kin.x.shape[1]
        n, s = self._line(kin, a, b)
        rate = float(n @ (kin.twist[b, :dim] - kin.twist[a, :dim]))
        if self.law is None:
            tension = self.stiffness * s + self.damping * rate
        else:
            tension = float(self.checked(np.atleast_1d(self.law(s, rate, t)), 1, t)[0])
        out = np.zeros(kin.jac_frame.shape[1])
        out[:dim] = tension * n
        return out, -out

    def energy(self, kin: Kinematics, a: int, b: int, t: float) -> float:
        if self.law is not None:
            return 0.0
        return 0.5 * self.stiffness * self._line(kin, a, b)[1] ** 2


def force(name: str, on: Any, law: Law, *, point: Sequence[float] | None = None, follower: bool = False) -> PointForce:
    """A force law(t) -> (d,) N on a rigid body's point (world, initial configuration) or on an elastic surface."""
    require(callable(law), f'Force "{name}": law must be a function of time, found {law!r}.')
    return PointForce(name, on, None, point, None, law, follower)


def torque(name: str, on: Any, law: Law, *, follower: bool = False) -> Torque:
    """A torque law(t) in N m on a body or an elastic surface; world axes, or the body's with ``follower``."""
    require(callable(law), f'Torque "{name}": law must be a function of time, found {law!r}.')
    return Torque(name, on, None, None, None, law, follower)
