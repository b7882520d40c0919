"""Sums of joint coordinates, s = offset + sum_k c_k s_k, written with + - * /: what a law, a drive, a gear or a sensor may read.

    twist = fmbd.angle(left) - 2 * fmbd.angle(right) + 0.1
    scene.add(fmbd.joint_spring("belt", twist, stiffness=40.0, damping=0.2))

An effort N on s is the effort c_k N on each s_k: power N s' = sum_k (c_k N) s_k'.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ...checks import number
from ...errors import InputError

if TYPE_CHECKING:
    from .drives import JointCoordinate
    from .joints import Joint

ANGLE, LENGTH = "rad", "m"


class Coordinate:
    """A joint coordinate, or a sum of such: ``terms`` (s_k, c_k) and ``offset`` of s = offset + sum_k c_k s_k.

    Sums of angles are angles (rad), of displacements lengths (m). Both meet in one sum where a factor turns one of them into the
    other: ``x - 0.05 * phi`` is a length, ``phi - x / 0.05`` an angle; where both have factors it is a length.
    """

    made_by = "fmbd.angle(...) or fmbd.displacement(...) of a joint itself, not of its name, or a sum of these"
    __array_ufunc__ = None  # numbers of NumPy leave operators to this class

    if TYPE_CHECKING:

        @property
        def terms(self) -> tuple[tuple[JointCoordinate, float], ...]:
            """(s_k, c_k)."""

        @property
        def offset(self) -> float:
            """What is added to the sum, rad or m."""

        @property
        def unit(self) -> str:
            """Unit for labels: rad or m."""

        @property
        def joint(self) -> Joint:
            """The joint of the first s_k."""

        @property
        def factored(self) -> bool:
            """Whether factors may have turned it into another unit."""

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """The s_k."""
        return tuple(s for s, _ in self.terms)

    @property
    def sort(self) -> Hashable:
        """Equal for coordinates that can be evaluated together."""
        return type(self), tuple(s.kind for s in self.coordinates), self.unit

    def __add__(self, other: Coordinate | float) -> CoordinateSum:
        given: object = other
        if isinstance(given, NamedCoordinate):
            return NotImplemented  # it adds itself
        if not isinstance(other, Coordinate):
            return CoordinateSum(self.terms, self.offset + _number(other), self.unit, self.factored)
        return _sum((*self.terms, *other.terms), self.offset + other.offset, *_unit_of(self, other))

    def __mul__(self, factor: float) -> CoordinateSum:
        c = _number(factor)
        return _sum([(s, c * x) for s, x in self.terms], c * self.offset, self.unit, True)

    def __neg__(self) -> CoordinateSum:
        return _sum([(s, -x) for s, x in self.terms], -self.offset, self.unit, self.factored)

    def __sub__(self, other: Coordinate | float) -> CoordinateSum:
        return self + (-other if isinstance(other, Coordinate | NamedCoordinate) else -_number(other))

    def __rsub__(self, other: float) -> CoordinateSum:
        return -self + other

    def __truediv__(self, divisor: float) -> CoordinateSum:
        if _number(divisor) == 0.0:
            raise InputError("A joint coordinate is divided by zero.")
        return self * (1.0 / _number(divisor))

    __radd__ = __add__
    __rmul__ = __mul__


@dataclass(frozen=True, eq=False)
class CoordinateSum(Coordinate):
    """See :class:`Coordinate`."""

    terms: tuple[tuple[JointCoordinate, float], ...]
    offset: float
    unit: str
    factored: bool

    @property
    def joint(self) -> Joint:
        """That of the first term."""
        return self.terms[0][0].joint


@dataclass(frozen=True, eq=False)
class NamedCoordinate:
    """A coordinate of a joint that is given by its name, or a sum with such: what it is ``of`` the joints by their names."""

    name: str
    of: Callable[[Callable[[str], Joint]], Coordinate]
    shown_as: ClassVar[str] = "angle or displacement of joint"
    made_by: ClassVar[str] = "one of a joint's name"
    __array_ufunc__ = None

    def _with(self, made: Callable[..., Coordinate], *others: Any) -> NamedCoordinate:
        def of(joint: Callable[[str], Joint]) -> Coordinate:
            return made(self.of(joint), *(x.of(joint) if isinstance(x, NamedCoordinate) else x for x in others))

        return NamedCoordinate(self.name, of)

    def __add__(self, other: Any) -> NamedCoordinate:
        return self._with(operator.add, other)

    def __mul__(self, factor: float) -> NamedCoordinate:
        return self._with(operator.mul, factor)

    def __neg__(self) -> NamedCoordinate:
        return self._with(operator.neg)

    def __sub__(self, other: Any) -> NamedCoordinate:
        return self._with(operator.sub, other)

    def __rsub__(self, other: float) -> NamedCoordinate:
        return -self + other

    def __truediv__(self, divisor: float) -> NamedCoordinate:
        return self._with(operator.truediv, divisor)

    __radd__ = __add__
    __rmul__ = __mul__


def _sum(terms: Any, offset: float, unit: str, factored: bool) -> CoordinateSum:
    """A sum in which each coordinate stands once.

    Raises:
        InputError: nothing is left of it.
    """
    found: dict[Any, tuple[JointCoordinate, float]] = {}
    for s, c in terms:
        key = s.joint, s.kind
        found[key] = s, c + (found[key][1] if key in found else 0.0)
    left = tuple((s, c) for s, c in found.values() if c != 0.0)
    if not left:
        raise InputError("A sum of joint coordinates is constant: all factors are zero, or cancel each other.")
    return CoordinateSum(left, offset, unit, factored)


def _unit_of(a: Coordinate, b: Coordinate) -> tuple[str, bool]:
    """Unit of a + b, and whether factors may yet turn it into another one.

    Raises:
        InputError: an angle and a length without a factor.
    """
    if a.unit == b.unit:
        return a.unit, a.factored and b.factored
    if not (a.factored or b.factored):
        raise InputError(
            f"A sum has {_told(a)} and {_told(b)}. Give one of them a factor: radius * angle is a length, length / radius an "
            "angle."
        )
    if a.factored and b.factored:
        return LENGTH, False
    return (b if a.factored else a).unit, False


def _told(s: Coordinate) -> str:
    """A coordinate in words of a message."""
    return f'{"an angle" if s.unit == ANGLE else "a length"} in {s.unit} (joint "{s.joint.name}")'


def _number(value: Any) -> float:
    return number("What is added to or multiplied with a joint coordinate", value)
