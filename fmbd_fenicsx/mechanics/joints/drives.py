"""Joint coordinates, and what acts on them: drives, gears, screws; and joints given by a function of the user's own.

    phi = fmbd.angle(hinge)                        s = fmbd.displacement(slider)
    fmbd.drive("motor", phi, lambda t: 3 * t)    fmbd.gear("gear", phi, psi, ratio=-2)    fmbd.screw("screw", joint, lead=0.01)

A coordinate is also a sensor (``scene.sensor("phi", phi)``) and what :func:`fmbd_fenicsx.effort` acts on. Wherever one can
stand, a sum can (:mod:`.sums`): ``phi - 2 * psi``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, overload

import numpy as np

from ...checks import function, instance, number, typed, unchanging
from ...errors import InputError, require
from ...rotations import Motions
from .constraints import Motion
from .couplings import Standing, lead_ratio, smooth_motion
from .joints import Joint
from .relative import CoordinateSums, RelativeAngle, RelativeCoordinates, Separation, Slide
from .sums import ANGLE, LENGTH, Coordinate, CoordinateSum, NamedCoordinate


@dataclass(frozen=True, eq=False)
class JointCoordinate(Coordinate):
    """A coordinate of a joint: the angle (rad, counted over revolutions) or displacement (m) of its b against its a.

    Zero at the start of a run where the two points of the joint coincide.
    """

    joint: Joint
    kind: type[RelativeCoordinates]

    @property
    def terms(self) -> tuple[tuple[JointCoordinate, float], ...]:
        """Itself."""
        return ((self, 1.0),)

    @property
    def offset(self) -> float:
        """None."""
        return 0.0

    @property
    def factored(self) -> bool:
        """No."""
        return False

    @property
    def unit(self) -> str:
        """Unit for labels."""
        return ANGLE if self.kind.angular else LENGTH


@overload
def angle(joint: str) -> NamedCoordinate: ...
@overload
def angle(joint: Joint) -> JointCoordinate: ...
@typed
def angle(joint: Joint | str) -> JointCoordinate | NamedCoordinate:
    """The angle of a revolute, cylindrical or planar joint about its axis (rad), counted over revolutions.

    Of a joint's name it is for sensors only, in sums too; drives, gears and forces take the coordinate of the joint itself.
    """
    if isinstance(joint, str):
        return NamedCoordinate(joint, lambda known: angle(known(joint)))
    if joint.kind not in ("revolute", "cylindrical", "planar", "drive"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no angle about an axis; revolute, cylindrical and planar do.'
        )
    return JointCoordinate(joint, RelativeAngle)


@overload
def displacement(joint: str) -> NamedCoordinate: ...
@overload
def displacement(joint: Joint) -> JointCoordinate: ...
@typed
def displacement(joint: Joint | str) -> JointCoordinate | NamedCoordinate:
    """The displacement of a prismatic, cylindrical or point-on-line joint along its axis, or the length of a rod (m).

    Of a joint's name it is for sensors only, as :func:`angle`.
    """
    if isinstance(joint, str):
        return NamedCoordinate(joint, lambda known: displacement(known(joint)))
    if joint.kind == "distance":
        return JointCoordinate(joint, Separation)
    if joint.kind not in ("prismatic", "cylindrical", "point on line"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no displacement; prismatic, cylindrical, point on line, distance and '
            "segment do."
        )
    return JointCoordinate(joint, Slide)


def relative_of(
    m: Motions, kind: type[RelativeCoordinates], entries: Iterable[tuple[JointCoordinate, int, int]]
) -> RelativeCoordinates:
    """The batch of joint coordinates of one kind from (coordinate, marker a, marker b)."""
    found = list(entries)
    axes = np.zeros((len(found), m.dim))
    if not (kind is Separation or (kind is RelativeAngle and m.dim == 2)):
        for axis, (coordinate, _, _) in zip(axes, found, strict=True):
            axis[:] = 0.0 if coordinate.joint.axis is None else coordinate.joint.axis
    a, b = (np.array([entry[i] for entry in found], dtype=int) for i in (1, 2))
    return kind(m, a, b, axes)


def coordinates_of(
    m: Motions, coordinates: Sequence[Coordinate], markers: Mapping[str, tuple[int, int]]
) -> RelativeCoordinates:
    """The batch of coordinates of one sort (:attr:`Coordinate.sort`); ``markers``: those of all joints, by their names."""
    each = [s.terms for s in coordinates]
    terms = [
        relative_of(m, one[0][0].kind, [(s, *markers[s.joint.name]) for s, _ in one]) for one in zip(*each, strict=True)
    ]
    if isinstance(coordinates[0], JointCoordinate):
        return terms[0]
    factors = np.array([[c for _, c in one] for one in each])
    offsets = np.array([s.offset for s in coordinates])
    return CoordinateSums(terms, factors, offsets, angular=coordinates[0].unit == ANGLE)


@unchanging
@dataclass(frozen=True, eq=False)
class Coupling(Joint):
    """One row sum_k c_k s_k = motion(t) on joint coordinates."""

    terms: tuple[tuple[JointCoordinate, float], ...] = ()
    motion: Motion | None = None

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """Those of the terms."""
        return tuple(s for s, _ in self.terms)

    @property
    def reaction_units(self) -> tuple[str, ...]:
        """The multiplier acts on the first coordinate: a moment where that is an angle."""
        return ("N m" if self.coordinates[0].kind.angular else "N",)


def _coupling(name: str, kind: str, combination: Coordinate, motion: Callable[[float], Any] | None = None) -> Coupling:
    """One row that holds a combination at a motion of time; None: at zero."""
    first = combination.joint
    for s in combination.coordinates:
        held = s.kind is Separation and s.joint.rows
        require(
            not held,
            f'Joint "{name}": the length of joint "{s.joint.name}" (distance) is held by that joint itself. Give it as '
            "fmbd.distance(..., length=function of time), or take fmbd.segment, whose length is free.",
        )

    return Coupling(
        name,
        first.a,
        first.b,
        (),
        first.center_a,
        first.center_b,
        kind=kind,
        axis=first.axis,
        terms=combination.terms,
        motion=_motion(name, motion, combination.offset),
    )


def _motion(name: str, motion: Callable[[float], Any] | None, offset: float) -> Motion | None:
    """Where the terms of a combination with an offset go, for it to follow a motion; None where they stay at zero."""
    if motion is None:
        return None if offset == 0.0 else Standing(-offset)
    if offset == 0.0:
        return smooth_motion(name, motion)
    function(f'Drive "{name}": motion', motion, "t", named="t")
    return smooth_motion(name, partial(_without, motion, offset))


def _without(motion: Callable[[float], Any], offset: float, t: Any) -> Any:
    """A motion less an offset: s alone, or s with its rates."""
    s = motion(t)
    if np.ndim(s) == 0:
        return s - offset
    return (s[0] - offset, *s[1:])


@typed
def drive(name: str, coordinate: Coordinate, motion: Callable[[float], Any]) -> Coupling:
    """Prescribe a joint coordinate: motion(t) -> s, or (s, s', s''); smooth. Its multiplier is minus the drive's effort.

    The effort (N or N m) increases the coordinate; :func:`fmbd_fenicsx.reaction_force` and ``reaction_torque`` give it on
    the first body.
    """
    return _coupling(name, "drive", coordinate, motion)


@typed
def gear(name: str, driving: Coordinate, driven: Coordinate, *, ratio: float) -> Coupling:
    """driven = ratio * driving, of angles, displacements, or one of each (rack and pinion: ratio in m/rad).

    The two joints should have the same first body (the housing): only then is the pair free of a bearing force of its own.
    """
    _not_zero(f'Joint "{name}": ratio', ratio)
    both = isinstance(driving, JointCoordinate) and isinstance(driven, JointCoordinate)
    require(
        not both or driving.joint is not driven.joint or driving.kind is not driven.kind,  # type: ignore[attr-defined]
        f'Joint "{name}" couples a coordinate with itself.',
    )
    return _coupling(name, "gear", driven - float(ratio) * driving)


@typed
def couple(
    name: str, terms: Coordinate | Mapping[JointCoordinate, float], *, motion: Callable[[float], Any] | None = None
) -> Coupling:
    """One constraint on a combination of joint coordinates: sum_k c_k s_k = motion(t).

    Args:
        terms: a sum, ``left + right - 2 * shaft``, or coordinate -> factor c_k, ``{left: 1, right: 1, shaft: -2}``: of a rope
            over pulleys the lengths of its segments (:func:`segment`) and how often each is passed.
        motion: t -> value, or (value, rate, second rate), smooth. None: the combination stays what it is at the start.

    With angles and lengths in one sum factors carry the radius (m/rad). The multiplier times c_k is the effort on s_k, with the
    sign of :func:`drive`. What gives way is a :func:`fmbd_fenicsx.joint_spring` on the same sum.
    """
    if not isinstance(terms, Coordinate):
        require(len(terms) > 0, f'Joint "{name}" couples nothing: give coordinate -> factor.')
        for s in terms:
            instance(f'Joint "{name}": coordinate', s, JointCoordinate)
        factors = [(s, number(f'Joint "{name}": factor of joint "{s.joint.name}"', c)) for s, c in terms.items()]
        require(all(c != 0.0 for _, c in factors), f'Joint "{name}": a factor is 0; leave that coordinate out.')
        terms = CoordinateSum(tuple(factors), 0.0, factors[0][0].unit, True)

    start = sum(c * s.joint.length for s, c in terms.terms if s.kind is Separation)
    return _coupling(name, "coupling", terms - (start + terms.offset) if motion is None else terms, motion)


@typed
def screw(name: str, joint: Joint, *, lead: float) -> Coupling:
    """The displacement of a cylindrical joint advances ``lead`` (m) in one turn of its angle."""
    _not_zero(f'Joint "{name}": lead', lead)
    return _coupling(name, "screw", displacement(joint) - lead_ratio(lead) * angle(joint))


def _not_zero(what: str, value: float) -> None:
    require(number(what, value) != 0.0, f"{what} {value} must be finite and not zero.")
