"""Joint coordinates, and what acts on them: drives, gears, screws; and joints given by a function of the user's own.

    phi = fmbd.angle(hinge)                        s = fmbd.displacement(slider)
    fmbd.drive("motor", phi, lambda t: 3 * t)    fmbd.gear("gear", phi, psi, ratio=-2)    fmbd.screw("screw", joint, lead=0.01)

A coordinate is also a sensor (``scene.sensor("phi", phi)``) and what :func:`fmbd_fenicsx.effort` acts on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import InputError, require
from .constraints import Motion
from .couplings import lead_ratio, smooth_motion
from .joints import Joint, Vector, _point, dimension
from .relative import Relative, Separation, Slide, Turn


@dataclass(frozen=True, eq=False)
class JointCoordinate:
    """A coordinate of a joint: the angle (rad, counted over revolutions) or displacement (m) of its b against its a.

    Zero at the start of a run where the two points of the joint coincide.
    """

    joint: Joint
    kind: type[Relative]

    @property
    def unit(self) -> str:
        """Unit for labels."""
        return "rad" if self.kind is Turn else "m"


def angle(joint: Joint) -> JointCoordinate:
    """The angle of a revolute, cylindrical or planar joint about its axis (rad), counted over revolutions."""
    if joint.kind not in ("revolute", "cylindrical", "planar", "drive"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no angle about an axis; revolute, cylindrical and planar do.'
        )
    return JointCoordinate(joint, Turn)


def displacement(joint: Joint) -> JointCoordinate:
    """The displacement of a prismatic, cylindrical or point-on-line joint along its axis, or the length of a rod (m)."""
    if joint.kind == "distance":
        return JointCoordinate(joint, Separation)
    if joint.kind not in ("prismatic", "cylindrical", "point on line"):
        raise InputError(
            f'Joint "{joint.name}" ({joint.kind}) has no displacement along an axis; prismatic, cylindrical and point on line do.'
        )
    return JointCoordinate(joint, Slide)


@dataclass(frozen=True)
class Coupling(Joint):
    """One row sum_k c_k s_k = motion(t) on joint coordinates."""

    terms: tuple[tuple[JointCoordinate, float], ...] = ()
    motion: Motion | None = None


def _coupling(
    name: str, kind: str, terms: list[tuple[JointCoordinate, float]], motion: Motion | None = None
) -> Coupling:
    first = terms[0][0].joint
    for s, c in terms:
        require(
            isinstance(s, JointCoordinate),
            f'Joint "{name}": expected fmbd.angle(...) or fmbd.displacement(...), found {s!r}.',
        )
        require(bool(np.isfinite(c)) and c != 0, f'Joint "{name}": ratio {c} must be finite and not zero.')
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


def drive(name: str, coordinate: JointCoordinate, motion: Callable[[float], Any]) -> Coupling:
    """Prescribe a joint coordinate: motion(t) -> s, or (s, s', s''); smooth. Its multiplier is minus the drive's effort.

    The effort (N or N m) increases the coordinate; :func:`fmbd_fenicsx.reaction_force` and ``reaction_torque`` give it on
    the first body.
    """
    return _coupling(name, "drive", [(coordinate, 1.0)], smooth_motion(name, motion))


def gear(name: str, driving: JointCoordinate, driven: JointCoordinate, *, ratio: float) -> Coupling:
    """driven = ratio * driving, of angles, displacements, or one of each (rack and pinion: ratio in m/rad).

    The two joints should have the same first body (the housing): only then is the pair free of a bearing force of its own.
    """
    require(bool(np.isfinite(ratio)) and ratio != 0, f'Joint "{name}": ratio {ratio} must be finite and not zero.')
    require(
        driving.joint is not driven.joint or driving.kind is not driven.kind,
        f'Joint "{name}" couples a coordinate with itself.',
    )
    return _coupling(name, "gear", [(driven, 1.0), (driving, -float(ratio))])


def screw(name: str, joint: Joint, *, lead: float) -> Coupling:
    """The displacement of a cylindrical joint advances ``lead`` (m) in one turn of its angle."""
    require(bool(np.isfinite(lead)) and lead != 0, f'Joint "{name}": lead {lead} m must be finite and not zero.')
    return _coupling(name, "screw", [(displacement(joint), 1.0), (angle(joint), -lead_ratio(lead))])


@dataclass(frozen=True)
class OwnJoint(Joint):
    """Rows g(x_a, R_a, x_b, R_b, t) = 0 given by the user."""

    function: Callable[..., Any] = field(default=None)  # type: ignore[assignment]


def own_joint(
    name: str,
    a: Any,
    b: Any,
    function: Callable[..., Any],
    *,
    center: Vector | None = None,
    axis: Vector | None = None,
) -> OwnJoint:
    """A joint of your own: function(x_a, R_a, x_b, R_b, t) -> (m,) numbers that are zero when the joint is closed.

    x are the world positions (m) of the two markers at ``center`` and R their rotations since the start, (d, d). Lengths in
    m, angles in rad, so that the checks can judge residuals. Write it with NumPy operations (no ``abs``, no ``float``) and
    its derivatives are exact. See docs/own_joint.md.
    """
    require(callable(function), f'Joint "{name}": function must take (x_a, R_a, x_b, R_b, t), found {function!r}.')
    c = _point(center, dimension(a, b, name), name)
    return OwnJoint(
        name,
        a,
        b,
        (),
        c,
        c,
        kind="own",
        axis=None if axis is None else np.asarray(axis, float),
        function=function,
    )
