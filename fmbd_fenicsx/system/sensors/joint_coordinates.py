"""Joint coordinates as sensors: of a joint, or of the name under which a scene knows it (``fmbd.angle("pin")``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import overload

from ...mechanics.joints import drives
from ...mechanics.joints.drives import JointCoordinate
from ...mechanics.joints.joints import Joint
from .named import OfNamed
from .sensor import Sensor
from .sensors import JointReading


def _of_named(make: Callable[[Joint], JointCoordinate], name: str) -> Sensor:
    """The coordinate of a joint that a scene knows by its name: a sensor, no coordinate that forces and drives could take."""

    def reading(joint: Joint) -> Sensor:
        coordinate = make(joint)
        return JointReading(None, coordinate.unit, coordinate=coordinate)

    return OfNamed(None, "", make=reading, parts="joints", name=name)


@overload
def angle(joint: str) -> Sensor: ...
@overload
def angle(joint: Joint) -> JointCoordinate: ...
def angle(joint: Joint | str) -> JointCoordinate | Sensor:
    """The angle of a revolute, cylindrical or planar joint about its axis (rad), counted over revolutions.

    Of a joint's name it is a sensor only; drives, gears and forces take the coordinate of the joint itself.
    """
    return _of_named(drives.angle, joint) if isinstance(joint, str) else drives.angle(joint)


@overload
def displacement(joint: str) -> Sensor: ...
@overload
def displacement(joint: Joint) -> JointCoordinate: ...
def displacement(joint: Joint | str) -> JointCoordinate | Sensor:
    """The displacement of a prismatic, cylindrical or point-on-line joint along its axis, or the length of a rod (m).

    Of a joint's name it is a sensor only; drives, gears and forces take the coordinate of the joint itself.
    """
    return _of_named(drives.displacement, joint) if isinstance(joint, str) else drives.displacement(joint)
