"""Quantities of parts of a scene that are given by their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import wraps
from typing import Any, ClassVar, overload

from ...errors import InputError, near
from ...mechanics.joints import drives
from ...mechanics.joints.drives import JointCoordinate
from ...mechanics.joints.joints import Joint
from ...rotations import Array
from ..evaluation import Evaluation
from ..layout import State
from .sensor import Sensor
from .sensors import JointReading


@dataclass(frozen=True, eq=False)
class OfNamed(Sensor):
    """A quantity of a part that is given by its name: ``make`` of what the scene has under this name among its ``parts``."""

    shown_as: ClassVar[str] = "sensor of"
    _: KW_ONLY
    make: Callable[[Any], Sensor]
    parts: str
    name: str

    def in_scene(self, name: str, scene: Any) -> Sensor:
        """The quantity of the part.

        Raises:
            InputError: the scene has no such part so far.
        """
        known = getattr(scene, self.parts)
        if self.name not in known:
            raise InputError(
                f'Sensor "{name}": "{self.name}" is not among the {self.parts} of the scene. {near(self.name, known)}'
            )
        return self.make(known[self.name])

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """No scene has told which part it is."""
        raise InputError(f'"{self.name}" is a name that only scene.sensor(...) looks up: give the part itself here.')


def or_name(parts: str) -> Callable[[Callable[[Any], Sensor]], Callable[[Any], Sensor]]:
    """Lets the maker of a sensor take a part of a scene also by its name; ``parts``: among which of the scene's."""

    def taking(make: Callable[[Any], Sensor]) -> Callable[[Any], Sensor]:
        @wraps(make)
        def made(part: Any) -> Sensor:
            return OfNamed(None, "", make=make, parts=parts, name=part) if isinstance(part, str) else make(part)

        return made

    return taking


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
