"""The forces of a scene in batches of one kind: part of building a :class:`~fmbd_fenicsx.system.system.System`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError, near
from ...mechanics.forces.expressed import ExpressedForce
from ...mechanics.forces.force_elements import Loads, ScalarLoads
from ...mechanics.forces.forces import Force
from ...mechanics.joints.drives import coordinates_of
from ...mechanics.joints.relative import ExpressedCoordinate, RelativeCoordinates, Separation
from ...mechanics.joints.sums import Coordinate
from ..sensors.sensor import Sensor

if TYPE_CHECKING:
    from .build import Builder


class Place:
    """What a force that is evaluated alone finds in the system under construction."""

    def __init__(self, builder: Builder) -> None:
        self.motions, self._builder = builder.m, builder

    def relative(self, coordinate: Coordinate) -> RelativeCoordinates:
        """A joint coordinate."""
        return coordinates_of(self.motions, [coordinate], self._builder.joint_markers)

    def marker(self, sensor: Sensor) -> int:
        """The marker of a sensor, -1 for one that has none."""
        return self._builder.markers.of_sensor(sensor)


def build_loads(builder: Builder) -> tuple[Loads, ...]:
    """The forces of the scene in batches of one kind."""
    groups: dict[Any, list[tuple[Force, tuple[int, int]]]] = {}
    out: list[Loads] = []
    for f in builder.scene.forces.values():
        # coordinates belong to joints that stand before
        for used in f.coordinates:
            if used.joint.name not in builder.joint_markers:
                raise InputError(
                    f'{f.kind.capitalize()} "{f.name}" uses joint "{used.joint.name}", which is not in the scene. '
                    f"{near(used.joint.name, builder.joint_markers)}"
                )

        if (alone := f.own_loads(Place(builder))) is not None:
            out.append(alone)
            continue

        s = f.coordinate
        # springs between points are loads on their distance
        kind: Any = Separation if s is None else s.sort
        if isinstance(f, ExpressedForce):
            kind = f.term.kind

        markers = builder.markers.of_force(f) if s is None else builder.joint_markers[s.joint.name]
        groups.setdefault((f.batch, kind), []).append((f, markers))

    for (batch, _), found in groups.items():
        fs, ms = [f for f, _ in found], [m for _, m in found]
        if issubclass(batch, ScalarLoads):
            out.append(batch(builder.m, fs, ms, _relative(builder, fs, ms)))
        else:
            out.append(batch(builder.m, fs, ms))

    for loads in out:
        loads.length = builder.bodies.length()
    return tuple(out)


def _relative(builder: Builder, fs: list[Force], ms: list[tuple[int, int]]) -> RelativeCoordinates:
    on = [f.coordinate for f in fs if f.coordinate is not None]
    if on:
        return coordinates_of(builder.m, on, builder.joint_markers)

    a, b = np.array(ms).T
    terms = [f.term for f in fs if isinstance(f, ExpressedForce)]
    if terms:
        return ExpressedCoordinate(builder.m, a, b, terms)
    return Separation(builder.m, a, b, np.zeros((len(fs), builder.m.dim)))
