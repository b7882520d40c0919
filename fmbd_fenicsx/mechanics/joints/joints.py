"""Joints: named lists of elementary constraints between two bodies.

A joint connects two *attachments*: a rigid body, an elastic surface, or the ``ground``. Its ``center`` and ``axis`` are given in
world coordinates of the configuration in which the bodies were defined. The reaction is the force that the joint exerts on
the *first* attachment.

=====================  ===========  ===============================================================
joint                  rows         relative motion left free
                       plane/space
=====================  ===========  ===============================================================
:func:`fixed`          3 / 6        none
:func:`revolute`       2 / 5        rotation about the axis
:func:`spherical`      - / 3        rotation
:func:`universal`      - / 4        rotation about two perpendicular axes
:func:`prismatic`      2 / 5        translation along the axis
:func:`cylindrical`    - / 4        translation along and rotation about the axis
:func:`planar`         0 / 3        two translations, rotation about the normal
:func:`distance`       1 / 1        all but the distance of two points
:func:`segment`        0 / 0        everything; the distance of two points is its coordinate
:func:`point_on_line`  1 / 2        translation along a line of the first body, rotation
=====================  ===========  ===============================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...checks import number, shown, typed, unchanging, vector, word
from ...errors import InputError, require
from ...rotations import Array, tangents_of
from ..bodies.bodies import RigidBody, Surface
from ..body import Body
from . import constraints as ct
from .constraints import Row
from .couplings import smooth_motion

UPRIGHT = (0.0, 0.0, 1.0)  # the axis where none is given
_BASIS = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # and its basis

Vector = Sequence[float]


class Ground:
    """The fixed world frame; carries joints and forces, has no unknowns."""

    name = "ground"

    @property
    def body(self) -> Ground:
        """Itself, as of bodies."""
        return self

    def __repr__(self) -> str:
        return "ground"

    def __reduce__(self) -> str:
        """There is one: copies and what is read back are itself."""
        return "ground"


ground = Ground()


@unchanging
@dataclass(frozen=True, eq=False)
class Joint:
    """Two attachments, their marker points (world, initial configuration; None: a surface's centroid), and rows."""

    name: str
    a: Any
    b: Any
    rows: tuple[Row, ...]
    center_a: Array | None = None
    center_b: Array | None = None
    length: float = 1.0
    kind: str = field(default="joint")
    axis: Array | None = None  # of the joint's angle and displacement, unit vector, world, initial configuration

    @property
    def coordinates(self) -> tuple[Any, ...]:
        """Coordinates of other joints that it couples or prescribes."""
        return ()

    @property
    def reaction_units(self) -> tuple[str, ...]:
        """Units of the multipliers, one a row: rows on a rotation carry moments."""
        return tuple("N m" if issubclass(row.kind, ct.Perpendicular) else "N" for row in self.rows)

    @property
    def joined(self) -> bool:
        """Whether both sides meet at one point where none is given; else each has its own."""
        return self.kind != "distance"

    def __post_init__(self) -> None:
        word("A joint's name", self.name)
        # surfaces are made anew at each call
        same = self.a.name == self.b.name and self.a.body is self.b.body
        require(not same, f'Joint "{self.name}" connects {self.a.name!r} with itself.')


def refuse_no_attachment(side: Any, what: str) -> None:
    """Refuse what no joint or force can hold: all but rigid bodies, surfaces of elastic bodies, and the ground."""
    if isinstance(side, Ground | RigidBody | Surface):
        return
    if isinstance(side, Body) and side.by_surface:
        raise InputError(
            f'{what}: attach to a surface of the elastic body "{side.name}", say {side.name}.surface("...").'
        )
    by_name = f", say scene.bodies[{side!r}]" if isinstance(side, str) else ""
    raise InputError(
        f"{what} connects {shown(side)}; expected a rigid body, a surface of an elastic body, or fmbd.ground{by_name}."
    )


def dimension(a: Any, b: Any, name: str) -> int:
    """Space dimension of two attachments (the ground has none of its own)."""
    for side in (a, b):
        refuse_no_attachment(side, f'Joint "{name}"')
    sides = [x for x in (a, b) if x is not ground]
    require(bool(sides), f'Joint "{name}" connects the ground with the ground.')
    dims = {x.dim for x in sides}
    if len(dims) != 1:
        raise InputError(
            f'Joint "{name}" needs bodies of one dimension, found {sorted(dims)} for {shown(a)} and {shown(b)}.'
        )
    return int(dims.pop())


def basis(axis: Vector | Array, name: str = "", dim: int = 3) -> Array:
    """Rows e_1, e_2, e_3: an orthonormal right-handed basis whose third vector points along the axis.

    Plane bodies (``dim`` 2) turn about z, and nothing else.
    """
    if axis is UPRIGHT:
        return _BASIS.copy()
    n = vector(f'Joint "{name}": axis', axis, size=3, zero=False)
    n = n / np.abs(n).max()
    n = n / float(np.linalg.norm(n))
    require(
        dim == 3 or n[2] == 1.0,
        f'Joint "{name}": axis {axis} is not (0, 0, 1), the only one about which plane bodies turn.',
    )
    return np.concatenate([*tangents_of(n[None]), n[None]])


def center_point(center: Vector | None, dim: int, name: str) -> Array | None:
    """The point (dim,) where a joint is to sit, world axes; None where the user leaves it to the joint."""
    if center is None:
        return None
    return vector(f'Joint "{name}": center', center, size=dim)


def _in_space(a: Any, b: Any, name: str) -> None:
    """Refuse plane bodies."""
    require(
        dimension(a, b, name) == 3,
        f'Joint "{name}" is a joint of space; {shown(a)} and {shown(b)} are plane. Use revolute, prismatic or point_on_line.',
    )


def _joint(
    joint: tuple[str, str, Any, Any], center: Vector | None, rows: list[Row], axis: Array | None = None
) -> Joint:
    """A joint from (name, kind, a, b), its point, rows and axis."""
    name, kind, a, b = joint
    c = center_point(center, dimension(a, b, name), name)
    return Joint(name, a, b, tuple(rows), c, c, kind=kind, axis=axis)


def direction(axis: Vector, dim: int, name: str) -> Array:
    """Unit vector (dim,) along an axis given by dim or three finite numbers, not all zero."""
    n = vector(f'Joint "{name}": axis', axis, size=dim, zero=False)
    n = n / np.abs(n).max()
    return np.asarray(n / np.linalg.norm(n))


def _meet(dim: int) -> list[Row]:
    return [Row(ct.Coincident, n) for n in np.eye(dim)]


def _upright(E: Array) -> list[Row]:
    """The axis of a stays perpendicular to the two cross axes of b."""
    return [Row(ct.Perpendicular, E[2], E[0]), Row(ct.Perpendicular, E[2], E[1])]


@typed
def fixed(name: str, a: Any, b: Any, *, center: Vector | None = None) -> Joint:
    """Weld two attachments: no relative motion, x_b = x_a and R_b = R_a (of elastic surfaces on average); 3 rows in the plane,
    6 in space.

    Args:
        name: what messages and ``reaction(name)`` call it.
        a, b: a rigid body, a surface of an elastic body (``body.surface("pin")``), or :data:`~fmbd_fenicsx.ground`. Reactions are
            those on a, N and N m, world axes.
        center: where the joint sits (m, world, in the places where the bodies were defined); by default the centroid of a
            surface, else the place of a mass at a point, else the position of the second body, of the first where the second is
            the ground.

    Raises:
        InputError: a side that is none of these, a body joined with itself, numbers that are none.
    """
    dim = dimension(a, b, name)
    e = np.eye(dim)
    turn = [(0, 1)] if dim == 2 else [(0, 1), (1, 2), (2, 0)]
    rows = _meet(dim) + [Row(ct.Perpendicular, e[i], e[j]) for i, j in turn]
    return _joint((name, "fixed", a, b), center, rows)


@typed
def revolute(name: str, a: Any, b: Any, *, center: Vector | None = None, axis: Vector = UPRIGHT) -> Joint:
    """Hinge: both sides coincide at ``center``, x_a = x_b; in space e_a . c_b = 0 for the two directions c across, so that only
    the rotation about ``axis`` is free. 2 rows in the plane, 5 in space.

    ``axis``: along the hinge, world, at the start; of no use in the plane. Other arguments as of :func:`fixed`; its angle is
    :func:`angle`.
    """
    dim = dimension(a, b, name)
    E = basis(axis, name, dim)
    return _joint((name, "revolute", a, b), center, _meet(dim) + (_upright(E) if dim == 3 else []), E[2])


@typed
def spherical(name: str, a: Any, b: Any, *, center: Vector | None = None) -> Joint:
    """Ball and socket: both sides coincide at ``center``, x_a = x_b, all rotations are free: 2 rows in the plane, 3 in space.

    Arguments as of :func:`fixed`.
    """
    return _joint((name, "spherical", a, b), center, _meet(dimension(a, b, name)))


@typed
def universal(
    name: str, a: Any, b: Any, *, center: Vector | None = None, axis_a: Vector = (1, 0, 0), axis_b: Vector = (0, 1, 0)
) -> Joint:
    """Cardan joint: the markers coincide and ``axis_a`` (fixed in a) stays perpendicular to ``axis_b`` (fixed in b)."""
    _in_space(a, b, name)
    ea, eb = basis(axis_a, name)[2], basis(axis_b, name)[2]
    require(abs(float(ea @ eb)) < 1e-9, f'Joint "{name}": axis_a {axis_a} and axis_b {axis_b} must be perpendicular.')
    rows = [*_meet(dimension(a, b, name)), Row(ct.Perpendicular, ea, eb)]
    return _joint((name, "universal", a, b), center, rows)


@typed
def prismatic(name: str, a: Any, b: Any, *, axis: Vector, center: Vector | None = None) -> Joint:
    """Slider: b translates along ``axis`` (fixed in a), without rotation: 2 rows in the plane, 5 in space.

    ``axis``: of the motion, world, at the start. Other arguments as of :func:`fixed`; its way is :func:`displacement`.
    """
    dim = dimension(a, b, name)
    if dim == 2:
        n = direction(axis, 2, name)
        cross = np.array([-n[1], n[0]])
        rows = [Row(ct.Along, cross), Row(ct.Perpendicular, cross, n)]
    else:
        E = basis(axis, name)
        rows = [Row(ct.Along, E[0]), Row(ct.Along, E[1]), *_upright(E), Row(ct.Perpendicular, E[0], E[1])]
    return _joint((name, "prismatic", a, b), center, rows, n if dim == 2 else E[2])


@typed
def cylindrical(name: str, a: Any, b: Any, *, axis: Vector, center: Vector | None = None) -> Joint:
    """A pin in a bore: b translates along and turns about ``axis`` (fixed in a); 4 rows, in space only.

    ``axis``: world, at the start. Other arguments as of :func:`fixed`; coordinates are :func:`angle` and :func:`displacement`.
    """
    _in_space(a, b, name)
    E = basis(axis, name)
    rows = [Row(ct.Along, E[0]), Row(ct.Along, E[1]), *_upright(E)]
    return _joint((name, "cylindrical", a, b), center, rows, E[2])


@typed
def planar(name: str, a: Any, b: Any, *, normal: Vector | None = None, center: Vector | None = None) -> Joint:
    """b slides and turns in the plane through ``center`` with the given normal (fixed in a): 3 rows in space; in the plane none,
    where it is for its :func:`angle`, say that of a rotor in elastic bearings.

    ``normal``: in space, world, at the start; by default the third axis. Other arguments as of :func:`fixed`.
    """
    dim = dimension(a, b, name)
    require(
        dim == 3 or normal is None,
        f'Joint "{name}": planar takes no normal in the plane, where all bodies slide and turn.',
    )
    E = basis(UPRIGHT if normal is None else normal, name, dim)
    return _joint((name, "planar", a, b), center, [Row(ct.Along, E[2]), *_upright(E)] if dim == 3 else [], E[2])


@typed
def point_on_line(name: str, a: Any, b: Any, *, axis: Vector, center: Vector | None = None) -> Joint:
    """A point of b stays on a line of a along ``axis``; b turns freely: 1 row in the plane, 2 in space.

    ``axis``: of the line, fixed in a, world, at the start; ``center``: the point. Other arguments as of :func:`fixed`.
    """
    dim = dimension(a, b, name)
    if dim == 2:
        n = direction(axis, 2, name)
        rows = [Row(ct.Along, np.array([-n[1], n[0]]))]
    else:
        E = basis(axis, name)
        rows = [Row(ct.Along, E[0]), Row(ct.Along, E[1])]
    return _joint((name, "point on line", a, b), center, rows, n if dim == 2 else E[2])


def _start(side: Any, point: Array | None, name: str, dim: int) -> Array:
    """Where the end of a rod lies at the start, world axes."""
    if point is not None or side is ground:
        return np.zeros(dim) if point is None else point
    require(
        isinstance(side, RigidBody),
        f'Joint "{name}": give its length, or the point of "{side.name}" that it starts from.',
    )
    return np.asarray(side.start_pose()[:dim])


@typed
def distance(
    name: str,
    a: Any,
    b: Any,
    *,
    point_a: Vector | None = None,
    point_b: Vector | None = None,
    length: float | Callable[[float], Any] | None = None,
) -> Joint:
    """Massless rod of a ``length`` (m) between a point of a and a point of b; multiplier: its tension (N).

    Points are world coordinates of the start; None: the position of a rigid body, the centroid of a surface, the origin of the
    ground. Without a length the rod is as long as the points are apart then (of a surface: that given). A function of time,
    length(t) = L or (L, L', L''), hoists: |x_b - x_a| = L(t); it must be smooth and above zero.
    """
    if not callable(length):
        return _straight(ct.Distance, (name, a, b), (point_a, point_b), length)
    motion = smooth_motion(name, length, of="length", positive=True)
    return _straight(ct.Apart, (name, a, b), (point_a, point_b), motion.place(0.0), motion)


@typed
def segment(name: str, a: Any, b: Any, *, point_a: Vector | None = None, point_b: Vector | None = None) -> Joint:
    """The straight line from a point of a to a point of b, which holds nothing; its length (m) is :func:`displacement`.

    What acts on it is added: :func:`couple` makes several segments one rope over pulleys, ``joint_spring`` and ``effort`` pull.
    Points as of :func:`distance`.
    """
    free = _straight(ct.Distance, (name, a, b), (point_a, point_b), None)
    return replace(free, rows=())


def _straight(
    kind: type[ct.Batch],
    joint: tuple[str, Any, Any],
    points: tuple[Vector | None, Vector | None],
    length: float | None,
    motion: ct.Motion = ct.standstill,
) -> Joint:
    """A row of a kind along the line between two points of (name, a, b); ``length`` None: that of the start."""
    name, a, b = joint
    dim = dimension(a, b, name)
    pa, pb = (center_point(point, dim, name) for point in points)
    if length is None:
        length = float(np.linalg.norm(_start(b, pb, name, dim) - _start(a, pa, name, dim)))
    number(f'Joint "{name}": length', length, above=0.0, unit="m")
    return Joint(name, a, b, (Row(kind, np.zeros(dim), motion=motion),), pa, pb, length, "distance")


@typed
def drive_rotation(name: str, a: Any, b: Any, motion: ct.Motion, *, axis: Vector = (0.0, 0.0, 1.0)) -> Joint:
    """Prescribe the rotation of b against a about ``axis`` (fixed in a): motion(t) = angle or (angle, rate, acceleration)."""
    dim = dimension(a, b, name)
    if dim == 2:
        basis(axis, name, 2)
        row = Row(ct.Turned, np.array([0.0, 1.0]), np.array([1.0, 0.0]), smooth_motion(name, motion))
    else:
        E = basis(axis, name)
        row = Row(ct.Turned, E[1], E[0], smooth_motion(name, motion), E[2])
    return _joint((name, "drive", a, b), None, [row], None if dim == 2 else E[2])


@typed
def drive_translation(
    name: str, a: Any, b: Any, motion: ct.Motion, *, axis: Vector, center: Vector | None = None
) -> Joint:
    """Prescribe the displacement of b against a along ``axis`` (fixed in a): motion(t) = s or (s, s', s'')."""
    dim = dimension(a, b, name)
    n = direction(axis, dim, name)
    return _joint((name, "drive", a, b), center, [Row(ct.Along, n, motion=smooth_motion(name, motion))], n)
