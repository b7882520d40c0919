"""Joint coordinates, and what acts on them: drives, gears, screws; and joints given by a function of the user's own.

    phi = fmbd.angle(hinge)                        s = fmbd.displacement(slider)
    fmbd.drive("motor", phi, lambda t: 3 * t)    fmbd.gear("gear", phi, psi, ratio=-2)    fmbd.screw("screw", joint, lead=0.01)

A coordinate is also a sensor (``scene.sensor("phi", phi)``) and what :func:`fmbd_fenicsx.effort` acts on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...checks import instance, number, typed
from ...errors import InputError, require
from ...rotations import Motions
from .constraints import Motion
from .couplings import Standing, lead_ratio, smooth_motion
from .joints import Joint
from .relative import RelativeAngle, RelativeCoordinates, Separation, Slide


@dataclass(frozen=True, eq=False)
class JointCoordinate:
    """A coordinate of a joint: the angle (rad, counted over revolutions) or displacement (m) of its b against its a.

    Zero at the start of a run where the two points of the joint coincide.
    """

    joint: Joint
    kind: type[RelativeCoordinates]

    made_by: ClassVar[str] = "fmbd.angle(...) or fmbd.displacement(...) of a joint itself, not of its name"

    @property
    def unit(self) -> str:
        """Unit for labels."""
        return "rad" if self.kind.angular else "m"


@typed
def angle(joint: Joint) -> JointCoordinate:
    """The angle of a revolute, cylindrical or planar joint about its axis (rad), counted over revolutions."""
    if joint.kind not in ("revolute", "cylindrical", "planar", "drive"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no angle about an axis; revolute, cylindrical and planar do.'
        )
    return JointCoordinate(joint, RelativeAngle)


@typed
def displacement(joint: Joint) -> JointCoordinate:
    """The displacement of a prismatic, cylindrical or point-on-line joint along its axis, or the length of a rod (m)."""
    if joint.kind == "distance":
        return JointCoordinate(joint, Separation)
    if joint.kind not in ("prismatic", "cylindrical", "point on line"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no displacement along an axis; prismatic, cylindrical and point on line do.'
        )
    return JointCoordinate(joint, Slide)


def relative_of(
    m: Motions, kind: type[RelativeCoordinates], entries: Iterable[tuple[JointCoordinate, int, int]]
) -> RelativeCoordinates:
    """The batch of joint coordinates of one kind from (coordinate, marker a, marker b)."""
    found = list(entries)
    e = [
        np.zeros(m.dim) if s.joint.axis is None or (kind is RelativeAngle and m.dim == 2) else s.joint.axis
        for s, _, _ in found
    ]
    if kind is Separation:
        e = [np.zeros(m.dim)] * len(found)
    a, b = (np.array([entry[i] for entry in found], dtype=int) for i in (1, 2))
    return kind(m, a, b, np.reshape(e, (len(found), m.dim)))


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


def _coupling(
    name: str, kind: str, terms: list[tuple[JointCoordinate, float]], motion: Motion | None = None
) -> Coupling:
    first = terms[0][0].joint
    for s, _ in terms:
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
        terms=tuple(terms),
        motion=motion,
    )


@typed
def drive(name: str, coordinate: JointCoordinate, motion: Callable[[float], Any]) -> Coupling:
    """Prescribe a joint coordinate: motion(t) -> s, or (s, s', s''); smooth. Its multiplier is minus the drive's effort.

    The effort (N or N m) increases the coordinate; :func:`fmbd_fenicsx.reaction_force` and ``reaction_torque`` give it on
    the first body.
    """
    return _coupling(name, "drive", [(coordinate, 1.0)], smooth_motion(name, motion))


@typed
def gear(name: str, driving: JointCoordinate, driven: JointCoordinate, *, ratio: float) -> Coupling:
    """driven = ratio * driving, of angles, displacements, or one of each (rack and pinion: ratio in m/rad).

    The two joints should have the same first body (the housing): only then is the pair free of a bearing force of its own.
    """
    _not_zero(f'Joint "{name}": ratio', ratio)
    require(
        driving.joint is not driven.joint or driving.kind is not driven.kind,
        f'Joint "{name}" couples a coordinate with itself.',
    )
    return _coupling(name, "gear", [(driven, 1.0), (driving, -float(ratio))])


@typed
def couple(
    name: str, terms: Mapping[JointCoordinate, float], *, motion: Callable[[float], Any] | None = None
) -> Coupling:
    """One constraint on a combination of joint coordinates: sum_k c_k s_k = motion(t).

    Args:
        terms: coordinate -> factor c_k: of a differential ``{left: 1, right: 1, shaft: -2}``, of a rope over pulleys the
            lengths of its segments (:func:`segment`) and how often each is passed.
        motion: t -> value, or (value, rate, second rate), smooth. None: the combination stays what it is at the start.

    With angles and lengths in one sum factors carry the radius (m/rad). The multiplier times c_k is the effort on s_k, with the
    sign of :func:`drive`. A spring or a law on a combination is a
    controller that reads and acts on its coordinates: efforts -c_k f(sum_k c_k s_k).
    """
    require(len(terms) > 0, f'Joint "{name}" couples nothing: give coordinate -> factor.')
    for s in terms:
        instance(f'Joint "{name}": coordinate', s, JointCoordinate)
    factors = [(s, number(f'Joint "{name}": factor of joint "{s.joint.name}"', c)) for s, c in terms.items()]
    require(all(c != 0.0 for _, c in factors), f'Joint "{name}": a factor is 0; leave that coordinate out.')
    start = sum(c * s.joint.length for s, c in factors if s.kind is Separation)
    stands = None if start == 0.0 else Standing(start)
    return _coupling(name, "coupling", factors, stands if motion is None else smooth_motion(name, motion))


@typed
def screw(name: str, joint: Joint, *, lead: float) -> Coupling:
    """The displacement of a cylindrical joint advances ``lead`` (m) in one turn of its angle."""
    _not_zero(f'Joint "{name}": lead', lead)
    return _coupling(name, "screw", [(displacement(joint), 1.0), (angle(joint), -lead_ratio(lead))])


def _not_zero(what: str, value: float) -> None:
    require(number(what, value) != 0.0, f"{what} {value} must be finite and not zero.")
