"""Applied forces as a user describes them; ``mechanics.forces.force_elements`` evaluates all of one kind at a time.

====================  ====================================================================================
:func:`force`         a force law(t) at a point, in space axes or turning with the body (``follower``)
:func:`torque`        a torque law(t), in space axes or turning with the body (``follower``)
:class:`Spring`       spring and damper between two points, linear or law(s, s', t)
:func:`joint_spring`  spring and damper on a joint coordinate (angle or displacement), linear or law(s, s', t)
:func:`effort`        prescribed drive torque or force law(t) on a joint coordinate
:class:`Tyre`         radial spring and damper between a wheel and a road profile
:func:`own_force`     any law of the motions of one or two points
====================  ====================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from ...checks import array, check_fields, function, number, shown, typed, vector
from ...errors import InputError, require
from ...rotations import Array
from ..joints.drives import JointCoordinate
from ..joints.joints import ground, refuse_no_attachment
from ..joints.sums import Coordinate
from .effort_laws import EffortLaw
from .force_elements import Loads, ScalarLoads, TimeLoads, TyreLoads
from .own_loads import OwnLoads

Law = Annotated[Callable[[Any, Any, Any], Any], "s, rate, t"]
TimeLaw = Annotated[Callable[[Any], Any], "t"]
Road = Annotated[Callable[[Any, Any], Any], "x, t"]
Point = Sequence[float] | Array | None


@dataclass(frozen=True, eq=False)
class Force:
    """A force (and torque) on one or two attachments: ``a``, ``b`` (None: one-sided), points in world axes at the start.

    ``batch`` is the class of ``mechanics.forces.force_elements`` that evaluates all forces of this kind.
    """

    name: str
    a: Any
    b: Any = None
    point_a: Point = None
    point_b: Point = None

    batch: ClassVar[type[Loads]] = Loads
    kind: ClassVar[str] = "force"  # its name in messages
    joined: ClassVar[bool] = False  # without points both sides meet where a joint would sit

    def __post_init__(self) -> None:
        """Check what all forces have: types, where they act, and points of the right dimension."""
        what = f'{self.kind.capitalize()} "{self.name}"'
        check_fields(self, what)
        refuse_no_attachment(self.a, what)
        if self.b is not None:
            refuse_no_attachment(self.b, what)
        dim = next((side.dim for side in (self.a, self.b) if side is not None and side is not ground), None)
        for end, point in (("point_a", self.point_a), ("point_b", self.point_b)):
            if point is not None:
                vector(f"{what}: {end}", point, size=dim)
        require(self.b is None or self.a != self.b, f"{what} connects {shown(self.a)} with itself.")

    @property
    def coordinate(self) -> Coordinate | None:
        """The joint coordinate that it acts on, if any."""
        return None

    @property
    def sides(self) -> tuple[Any, ...]:
        """All attachments that it uses."""
        return self.a, self.b, *(side for s in self.coordinates for side in (s.joint.a, s.joint.b))

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """All joint coordinates that it uses."""
        return () if self.coordinate is None else self.coordinate.coordinates

    @property
    def period(self) -> float | None:
        """Time (s) from one jump of its law to the next; None for laws without jumps at known times."""
        return None

    def own_loads(self, place: Any) -> Any:
        """Its evaluation, where a force of this kind is evaluated alone; None for kinds that go in batches."""
        return None


@dataclass(frozen=True, eq=False)
class Constant:
    """What is prescribed over time, where it stays the same."""

    value: Array
    stays: ClassVar[bool] = True

    def __call__(self, t: float) -> Array:
        """The value at any time."""
        return self.value


@dataclass(frozen=True, eq=False)
class OfTime(EffortLaw):
    """A drive's effort that is ``given`` over time, as a law of a coordinate, which it pushes up."""

    given: TimeLaw | Constant

    def __call__(self, s: float, rate: float, t: float) -> float:
        """The restoring effort."""
        found = self.given(t)
        return -found if isinstance(found, float) else -np.asarray(found)  # type: ignore[return-value]

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """None: it depends on time only."""
        return 0.0, 0.0


@dataclass(frozen=True, eq=False)
class InTime(Force):
    """A law of time alone, one number for each component of its place; ``follower``: turning with the body."""

    law: TimeLaw | Constant = None  # type: ignore[assignment]
    follower: bool = False

    batch: ClassVar[type[Loads]] = TimeLoads
    turns: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        what = f'{self.kind.capitalize()} "{self.name}"'
        require(self.a is not None and self.a is not ground, f"{what} must act on a body or on a surface of one.")
        if isinstance(self.law, Constant):
            rotations = 1 if self.a.dim == 2 else 3
            size = rotations if self.turns else self.a.dim
            object.__setattr__(self, "law", Constant(vector(f"{what}: law", np.atleast_1d(self.law.value), size=size)))


@dataclass(frozen=True, eq=False)
class PointForce(InTime):
    """A force law(t) in N, (d,), on a point of a body or on a surface (its mean displacement); ``follower``: turning with it."""


@dataclass(frozen=True, eq=False)
class Torque(InTime):
    """A torque law(t) in N m on a body: a number (plane) or (3,) in world axes (space); ``follower``: turning with it."""

    turns: ClassVar[bool] = True
    kind: ClassVar[str] = "torque"


@dataclass(frozen=True, eq=False)
class Spring(Force):
    """Spring and damper between two points: tension N(s, s') along the line, s the elongation from ``length`` (m).

    Linear: N = stiffness s + damping s'; or by a law(s, rate, t) -> N of the user's own alone. Points must not coincide.
    """

    stiffness: float = None  # type: ignore[assignment]  # N/m; 0 where only others are given
    damping: float = None  # type: ignore[assignment]  # N s/m, the same
    length: float = 0.0  # m, unstressed
    law: Law | None = None

    batch: ClassVar[type[Loads]] = ScalarLoads
    kind: ClassVar[str] = "spring"
    of_time: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.b is not None, f'Spring "{self.name}" needs two ends: Spring(name, a, b, ...); one may be fmbd.ground.'
        )
        k, c = _constants(f'Spring "{self.name}"', self.stiffness, self.damping, self.law)
        number(f'Spring "{self.name}": length', self.length)
        object.__setattr__(self, "stiffness", k)
        object.__setattr__(self, "damping", c)


@dataclass(frozen=True, eq=False)
class CoordinateForce(Force):
    """A restoring effort N(s - length, s', t) on a joint coordinate s, N or N m; ``length`` is its unstressed value."""

    on: Coordinate = None  # type: ignore[assignment]
    stiffness: float = 0.0
    damping: float = 0.0
    length: float = 0.0
    law: Law | None = None
    of_time: bool = False  # the law depends on time only

    batch: ClassVar[type[Loads]] = ScalarLoads
    kind: ClassVar[str] = "joint spring or effort"

    @property
    def coordinate(self) -> Coordinate:
        """The joint coordinate on which the force acts."""
        return self.on


@dataclass(frozen=True, eq=False)
class Tyre(Force):
    """A wheel on a road: N = stiffness c + damping c' along ``up`` while the compression c > 0, never pulling.

    c = radius + road(x, t) - up . x with x the world position (d,) of the wheel centre ``point_a``; road(x, t) is the height of
    the road along ``up`` under that point, smooth; let it depend on t to drive the road past a vehicle that stays in place.
    The force acts at the centre, along ``up`` on slopes too: no part of it pushes the wheel along the road, uphill or down, and
    there is no friction. ``up`` is a unit vector, the y axis of the plane where it is not given; in space it is to be.
    """

    road: Road = None  # type: ignore[assignment]
    radius: float = 0.3  # m
    stiffness: float = None  # type: ignore[assignment]  # N/m; 0 where only the other is given
    damping: float = None  # type: ignore[assignment]  # N s/m, the same
    up: Sequence[float] | None = None

    batch: ClassVar[type[Loads]] = TyreLoads

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.a is not ground, f'Tyre "{self.name}" must act on a wheel: a rigid body or a surface, not the ground.'
        )
        require(
            self.b is None and self.point_b is None,
            f'Tyre "{self.name}": it has one end, the wheel centre point_a of the body a; b and point_b have no effect. The road '
            "is the function road(x, t).",
        )

        function(f'Tyre "{self.name}": road', self.road, "xt", named="x, t")
        number(f'Tyre "{self.name}": radius', self.radius, above=0.0, unit="m")
        k, c = _constants(f'Tyre "{self.name}"', self.stiffness, self.damping)
        if self.up is None:
            require(self.a.dim == 2, f'Tyre "{self.name}": up = None must be given in space, say (0, 0, 1).')
            object.__setattr__(self, "up", (0.0, 1.0))
        size = float(np.linalg.norm(vector(f'Tyre "{self.name}": up', self.up, size=self.a.dim)))
        require(abs(size - 1.0) < 1e-9, f'Tyre "{self.name}": up {self.up} must be a unit vector.')
        object.__setattr__(self, "stiffness", k)
        object.__setattr__(self, "damping", c)


@dataclass(frozen=True, eq=False)
class OwnForce(Force):
    """A law of the user's own, see :func:`own_force`."""

    law: Callable[..., Any] = None  # type: ignore[assignment]
    jacobian: Callable[..., Any] | None = None

    batch: ClassVar[type[Loads]] = OwnLoads

    def __post_init__(self) -> None:
        super().__post_init__()
        arguments = "t, a" if self.b is None else "t, a, b"
        for what, given in (("law", self.law), ("jacobian", self.jacobian)):
            if given is not None or what == "law":
                function(f'Force "{self.name}": {what}', given, arguments.split(", "), named=arguments)


def _constants(what: str, stiffness: float | None, damping: float | None, law: Any = ...) -> tuple[float, float]:
    """Stiffness and damping of an element: one that is left out is zero; refused where nothing is given at all."""
    words = "stiffness or damping" if law is ... else "stiffness, damping or a law"
    nothing = stiffness is None and damping is None and law in (None, ...)
    require(not nothing, f"{what} does nothing: no {words} is given.")
    require(
        law in (None, ...) or not (stiffness or damping),
        f"{what}: its law stands for stiffness and damping, which would have no effect beside it. Leave them out, or add them "
        "in the law: law=lambda s, rate, t: stiffness * s + damping * rate + ...",
    )
    return (
        number(f"{what}: stiffness", 0.0 if stiffness is None else stiffness),
        number(f"{what}: damping", 0.0 if damping is None else damping, least=0.0),
    )


def in_time(what: str, law: Any) -> Callable[[Any], Any]:
    """What is prescribed over time as a function: ``law`` itself, or one that returns the constant."""
    if callable(law):
        return function(f"{what}: law", law, "t", named="t")
    try:
        value = array(what, law)
    except InputError:
        value = np.zeros(0)
    good = value.ndim <= 1 and value.size > 0
    require(good, f"{what}: law must be a function of time t (s) or a constant, found {shown(law)}.")
    return Constant(value)


@typed
def force(name: str, on: Any, law: Any, *, point: Point = None, follower: bool = False) -> PointForce:
    """A force law(t) -> (d,) N, or a constant (d,), on a rigid body's point (world, initial configuration) or elastic surface.

    World axes; with ``follower`` the world axes of the start, turned with the body since, whatever its attitude there. A
    ``point`` of an elastic body is held by the mean motion of the surface as if by a rigid arm, wherever it lies; else the
    force acts at the centroid.
    """
    return PointForce(name, on, None, point, None, in_time(f'Force "{name}"', law), follower)


@typed
def torque(name: str, on: Any, law: Any, *, follower: bool = False) -> Torque:
    """A torque law(t), or a constant, in N m on a body or an elastic surface.

    World axes; with ``follower`` the world axes of the start, turned with the body since, whatever its attitude there.
    """
    return Torque(name, on, None, None, None, in_time(f'Torque "{name}"', law), follower)


@typed
def joint_spring(
    name: str,
    on: Coordinate,
    *,
    stiffness: float | None = None,
    damping: float | None = None,
    free: float = 0.0,
    law: Law | None = None,
) -> CoordinateForce:
    """Spring and damper on a joint coordinate s: restoring effort stiffness (s - free) + damping s', or law(s - free, s', t)
    alone.

    s may be a sum, ``fmbd.angle(a) - 2 * fmbd.angle(b)``: an effort N on it is c_k N on each of its terms c_k s_k.
    """
    k, c = _constants(f'Joint spring "{name}"', stiffness, damping, law)
    number(f'Joint spring "{name}": free', free)
    return CoordinateForce(name, on.joint.a, on.joint.b, None, None, on, k, c, free, law)


@typed
def effort(name: str, on: Coordinate, law: Any) -> CoordinateForce:
    """Prescribed effort law(t), or a constant, on a joint coordinate s: torque (N m) or force (N), positive where s increases."""
    given = in_time(f'Effort "{name}"', law)
    if isinstance(given, Constant):
        vector(f'Effort "{name}": law', np.atleast_1d(given.value), size=1)
    return CoordinateForce(name, on.joint.a, on.joint.b, None, None, on, law=OfTime(given), of_time=True)


@typed
def own_force(
    name: str,
    a: Any,
    b: Any,
    law: Callable[..., Any],
    *,
    points: tuple[Point, Point] = (None, None),
    jacobian: Callable[..., Any] | None = None,
) -> OwnForce:
    """Any force: law(t, a) -> (force, torque) on a (b None), or law(t, a, b) -> (force, torque) on b, the reaction on a.

    a and b are :class:`~fmbd_fenicsx.mechanics.forces.force_elements.MarkerMotion` (x, R, v, w) of the two points;
    force (d,) N and torque
    N m in world axes. ``jacobian``(t, a, b) -> (K, D), each (2 n, 2 n): minus the derivatives of the wrenches on (a, b)
    with respect to displacements and velocities of the markers, n = d + n_rot. Where it is missing, and the last slopes do not
    foretell the force, those of a law that writes formulas, as for :func:`fmbd_fenicsx.constraint`, are exact: it is called once
    with symbols. Another law (``if``, tables, ``math``) is called once more for each component of x, R, v, w that it reads.
    """
    if len(points) != 2:
        raise InputError(f'Force "{name}": points must be two, of a and of b, found {points!r}.')
    return OwnForce(name, a, b, points[0], points[1], law, jacobian)
