"""What controllers read: joint coordinates, their rates, the motion of markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import near
from ...mechanics.frames import Kinematics
from ...mechanics.joints.relative import RelativeCoordinates
from ...mechanics.joints.sums import Coordinate
from ...rotations import Array, hat
from ..sensors.sensor import Sensor
from ..sensors.sensors import AngularVelocity, JointReading, Position, Rotation, Velocity

KINEMATIC = (Position, Velocity, AngularVelocity, Rotation)


@dataclass(frozen=True)
class _Seen:
    """What a sensor of motion reads from."""

    kin: Kinematics


@dataclass(frozen=True)
class Reading:
    """A quantity that a controller reads: a joint coordinate (``relative``, level 0) or its rate (1), or a sensor at a marker."""

    name: str
    sensor: Sensor
    marker: int
    relative: RelativeCoordinates | None
    level: int
    dim: int

    @property
    def coordinate(self) -> Coordinate | None:
        """The joint coordinate that it is, or is the rate of; None at a marker."""
        return self.sensor.coordinate if isinstance(self.sensor, JointReading) else None

    @property
    def fast(self) -> bool:
        """Whether it is a rate."""
        return bool(self.level) or isinstance(self.sensor, Velocity | AngularVelocity)

    @property
    def size(self) -> int:
        """How many numbers a continuous law reads there."""
        if self.relative is not None:
            return 1
        if isinstance(self.sensor, Position | Velocity):
            return self.dim
        turns = 2 * self.dim - 3
        return turns if isinstance(self.sensor, AngularVelocity) else turns**2

    def span(self, length: float) -> float:
        """What its numbers may be in a model of this length (m): that, or a radian; rates, in a second."""
        if self.relative is not None:
            return self.relative.size(length)
        return length if isinstance(self.sensor, Position | Velocity) else 1.0

    def at(self, kin: Kinematics) -> Array:
        """The value in a configuration, (size,)."""
        if self.relative is not None:
            return self.relative.rates(kin) if self.level else self.relative.values(kin)
        return self.sensor.read(_Seen(kin), None, self.marker)  # type: ignore[arg-type]

    def rows(self, kin: Kinematics) -> list[tuple[int, Array, bool]]:
        """(marker, rows (size, n), of velocities) by which it answers to markers."""
        d, n = kin.x.shape[1], kin.jac_frame.shape[1]
        if self.relative is not None:
            each = zip(self.relative.markers, self.relative.rows(kin), strict=True)
            return [(int(m[0]), r, self.fast) for m, r in each]
        if isinstance(self.sensor, Position | Velocity):
            return [(self.marker, np.eye(d, n), self.fast)]
        turning = np.eye(n)[d:]
        if isinstance(self.sensor, Rotation) and d == 3:  # of the columns r of R: theta x r
            turning = (-hat(kin.R[self.marker].T)).swapaxes(0, 1).reshape(self.size, d) @ turning
        return [(self.marker, turning, self.fast)]


class Readings(dict[str, Array]):
    """What a law reads, by name."""

    def __missing__(self, name: str) -> Array:
        raise LookupError(f'"{name}" is not among what it reads. {near(str(name), self)}')
