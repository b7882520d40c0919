"""Rolling without slip, and skates: constraints on velocities that are no rates of a coordinate (nonholonomic).

    fmbd.rolling("road", fmbd.ground, wheel, shape=fmbd.Wheel(0.35, axis=(0, 1, 0)), normal=(0, 0, 1))
    fmbd.rolling("table", turntable, ball, shape=fmbd.Ball(0.1), normal=(0, 0, 1))
    fmbd.skate("ice", fmbd.ground, blade, along=(1, 0, 0), normal=(0, 0, 1))

A wheel touches the plane of the first attachment with its lowest point: one row keeps its height, two keep the velocity of the
material point there equal to that of the plane. The lowest point wanders around the wheel; the plane may move. Reactions do no
work on a plane at rest, so energy is kept.

Rows are derived from the definitions of :mod:`~fmbd_fenicsx.mechanics.kinds.definitions`. Wheels as in Meijaard,
Papadopoulos, Ruina and Schwab, doi:10.1098/rspa.2007.1857.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import check_fields, number, typed, vector
from ...errors import InputError, require
from ...rotations import Array
from ..bodies.bodies import RigidBody
from .constraints import Along, NamedConstants, Row
from .joints import Joint, Vector, basis, dimension, direction


class WheelHeight(NamedConstants):
    """The lowest point of a wheel stays on a plane."""

    kind = "wheel_height"


class WheelSlip(NamedConstants):
    """The lowest point of a wheel does not slip along one direction of a plane."""

    kind = "wheel_slip"
    on_speeds = True


class BallSlip(NamedConstants):
    """The lowest point of a ball, or of a disc in the plane, does not slip along one direction."""

    kind = "ball_slip"
    on_speeds = True


class Skate(NamedConstants):
    """A point does not move across a blade."""

    kind = "skate"
    on_speeds = True


@dataclass(frozen=True)
class Wheel:
    """A wheel of ``radius`` (m) to its lowest point when upright, about ``axis`` (world axes of the initial configuration).

    ``tread``: radius of the tyre's round section (m), part of the radius; 0 is a knife edge.
    """

    radius: float
    axis: Vector
    tread: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        number("Wheel: radius", self.radius, above=0.0, unit="m")
        vector("Wheel: axis", self.axis, size=3, zero=False)
        require(
            0.0 <= self.tread < self.radius, f"Wheel: tread = {self.tread} m must be at least 0 and below the radius."
        )


@dataclass(frozen=True)
class Ball:
    """A ball, or a disc in the plane, of ``radius`` (m)."""

    radius: float

    def __post_init__(self) -> None:
        check_fields(self)
        number("Ball: radius", self.radius, above=0.0, unit="m")


@typed
def rolling(name: str, a: Any, b: Any, *, shape: Wheel | Ball, normal: Vector, center: Vector | None = None) -> Joint:
    """b rolls without slip on a plane of a that it touches at the start.

    Args:
        a: what it rolls on: the ground or a body, which may move.
        shape: :class:`Wheel` (in space) or :class:`Ball` (in the plane a disc).
        normal: of the plane, towards b; world axes of the initial configuration, fixed in a.
        center: of the wheel (m), world; None: the position of a rigid body.

    Reactions: along the normal, then along two directions of the plane (in the plane: one), N.
    """
    dim = dimension(a, b, name)
    place = _center(name, b, center, dim)
    n = direction(normal, dim, name)
    if isinstance(shape, Wheel):
        require(dim == 3, f'Joint "{name}": a Wheel rolls in space; plane bodies take shape=fmbd.Ball(radius).')
        return _wheel(name, (a, b), shape, n, place)

    touched = place - shape.radius * n
    rows = [Row(Along, n)]
    rows += [Row(BallSlip, t, constants={"e": n, "t": t, "radius": shape.radius}) for t in _across(n)]
    # one marker stands a radius above the plane: its distance along the normal is zero
    return Joint(name, a, b, tuple(rows), touched + shape.radius * n, place, kind="rolling")


def _wheel(name: str, sides: tuple[Any, Any], shape: Wheel, n: Array, place: Array) -> Joint:
    """The joint of a wheel with its centre at ``place`` on a plane with normal n."""
    axis = basis(shape.axis, name)[2]
    lean = float(n @ axis)
    require(
        abs(lean) < 1.0 - 1e-6,
        f'Joint "{name}": the wheel lies flat, its axis {tuple(shape.axis)} is normal to the plane.',
    )
    # up in the plane of the wheel; the tread touches below the lowest point of the ring
    upward = (n - lean * axis) / np.sqrt(1.0 - lean * lean)
    ring = shape.radius - shape.tread
    touched = place - ring * upward - shape.tread * n

    shared = {"e": n, "f": axis, "radius": ring, "tread": shape.tread}
    rows = [Row(WheelHeight, n, constants=shared)]
    rows += [Row(WheelSlip, t, constants=shared | {"t": t}) for t in _across(n)]
    return Joint(name, *sides, tuple(rows), touched, place, kind="rolling")


@typed
def skate(
    name: str, a: Any, b: Any, *, along: Vector, normal: Vector = (0.0, 0.0, 1.0), center: Vector | None = None
) -> Joint:
    """A blade of b at ``center`` glides along itself and not across, against a; ``along`` and ``normal`` are fixed in b.

    Directions in world axes of the initial configuration; in the plane ``normal`` is z. One row: what keeps the blade on
    the ice, say :func:`planar`, is a joint of its own. Its reaction (N) acts across the blade.
    """
    dim = dimension(a, b, name)
    u = direction(along, dim, name)
    if dim == 2:
        require(
            direction(normal, 3, name)[2] > 1 - 1e-9,
            f'Joint "{name}": normal {tuple(normal)} is not (0, 0, 1), the only one in the plane.',
        )
        across = np.array([-u[1], u[0]])
    else:
        across = np.cross(direction(normal, dim, name), u)
        size = float(np.linalg.norm(across))
        require(size > 1e-6, f'Joint "{name}": along {tuple(along)} and normal {tuple(normal)} are parallel.')
        across = across / size

    place = _center(name, b, center, dim)
    return Joint(name, a, b, (Row(Skate, across, constants={"e": across}),), place, place, kind="skate")


def _center(name: str, b: Any, center: Vector | None, dim: int) -> Array:
    """The given point, or the position of a rigid body."""
    if center is not None:
        return vector(f'Joint "{name}": center', center, size=dim)
    if not isinstance(b, RigidBody):
        raise InputError(f'Joint "{name}": say where the centre is, center=(...): {b!r} is no rigid body.')
    return np.asarray(b.position, dtype=float)


def _across(n: Array) -> list[Array]:
    """Directions of the plane with normal n: two in space, one in the plane."""
    if len(n) == 2:
        return [np.array([n[1], -n[0]])]
    # any axis that is not along the normal
    helper = np.array([1.0, 0.0, 0.0]) if abs(n[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    first = helper - (helper @ n) * n
    first /= np.linalg.norm(first)
    return [first, np.cross(n, first)]
