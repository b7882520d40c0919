"""Limits of a joint coordinate that a body hits: rigid stops with a coefficient of restitution.

    lower <= s <= upper;    at a stop   s'_after = -e s'_before,    and a resting joint is held by a one-sided effort       (1)

As unilateral rows they belong to the same complementarity problem as contact, see :mod:`fmbd_fenicsx.mechanics.contact.limits`.
Stops with a stiffness are :func:`fmbd_fenicsx.elastic_stop`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...checks import typed
from ...errors import require
from .drives import JointCoordinate
from .sums import Coordinate


@dataclass(frozen=True, eq=False)
class JointLimit:
    """Stops of a joint coordinate; made by :func:`joint_limit`, which documents the fields."""

    name: str
    coordinate: JointCoordinate
    lower: float = -np.inf
    upper: float = np.inf
    restitution: float = 0.0

    def __repr__(self) -> str:
        return f'joint limit "{self.name}" of "{self.coordinate.joint.name}"'


@typed
def joint_limit(
    name: str, on: Coordinate, *, lower: float = -np.inf, upper: float = np.inf, restitution: float = 0.0
) -> JointLimit:
    """Rigid stops of a joint coordinate, at ``lower`` and ``upper`` (rad or m), with impacts (1).

        stop = fmbd.joint_limit("stop", fmbd.angle(hinge), lower=-0.5, upper=1.2, restitution=0.4)
        scene.add(stop)
        scene.sensor("stop torque", fmbd.sensors.limit_effort(stop))

    Args:
        name: what messages and sensors call it.
        on: ``fmbd.angle(joint)`` or ``fmbd.displacement(joint)``, zero at the start, or one of these plus a number.
        lower: least value; infinite: no stop on this side.
        upper: largest value.
        restitution: e in [0, 1], ratio of the rates after and before an impact; 0: the joint stays at the stop.

    Scenes with limits are run by :class:`~fmbd_fenicsx.schemes.impacts.moreau.Moreau`, the scheme with impacts.

    Raises:
        InputError: no stop at all, stops in the wrong order, a sum of several coordinates, or e outside [0, 1].
    """
    what = f'Joint limit "{name}"'
    (s, factor), *more = on.terms
    require(
        not more and factor == 1.0,
        f"{what} stops one joint coordinate, with a number added or without, and no other sum.",
    )
    require(lower < upper, f"{what}: lower = {lower} must be less than upper = {upper}.")
    require(np.isfinite(lower) or np.isfinite(upper), f"{what}: give lower, upper, or both.")
    require(0 <= restitution <= 1, f"{what}: restitution {restitution} must lie in [0, 1].")

    return JointLimit(name, s, float(lower) - on.offset, float(upper) - on.offset, float(restitution))
