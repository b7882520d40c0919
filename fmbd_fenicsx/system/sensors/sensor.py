"""What a sensor is, and the parts of a scene that sensors know by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import OfBody, name_of, shown
from ...errors import InputError
from ...mechanics.joints.drives import JointCoordinate
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State


@dataclass(frozen=True, eq=False)
class Sensor:
    """A quantity of one instant. ``on`` is the attachment whose marker it reads (None: none), ``unit`` labels axes.

    ``derivative``: the highest one of the motion that it reads: 0 positions, 1 velocities, 2 accelerations or multipliers.
    """

    on: Any
    unit: str
    point: Sequence[float] | None = None
    derivative = 0

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The value, a flat array; collective."""
        raise NotImplementedError

    def looks_at(self, system: Layout, marker: int) -> Look | None:
        """What :meth:`series` needs of records of the compiled loop; None where states are read one by one."""
        return None

    def series(self, seen: Recorded, marker: int) -> Array:
        """The values in all records at once, (k, size): those of :meth:`read`."""
        raise NotImplementedError

    def numbers(self, seen: Recorded, marker: int) -> tuple[Array, float]:
        """What the values in all records are multiples of, (k, size), and by which factor: numbers of the records where they can
        be, then C finds the steps in which an event is met.
        """
        return self.series(seen, marker), 1.0

    @property
    def strain_degree(self) -> int | None:
        """Degree of the elements whose strains it reads at a place; None where it reads none."""
        return None

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """Joint coordinates that it reads."""
        return ()

    @property
    def reads(self) -> dict[str, str]:
        """What it reads that a scene must hold: "joint", "body", "force" or "contact" -> its name, see :func:`named_part`."""
        return {}

    def reads_part(self, what: str, part: Any) -> bool:
        """Whether it reads a part of a scene, or is on it; ``what`` it is: "joint", "body", ...; of ties as of joints."""
        wanted = [name for kind, name in self.wanted if kind == ("joint" if what == "tie" else what)]
        if not wanted:
            return isinstance(self.on, OfBody) and self.on.body is part
        return any(name == part.name and getattr(name, "part", part) is part for name in wanted)

    @property
    def wanted(self) -> list[tuple[str, str]]:
        """All that it reads, as of :attr:`reads`: joints of several coordinates, too."""
        return [*self.reads.items(), *[("joint", named_part("joint", s.joint)) for s in self.coordinates[1:]]]

    def in_scene(self, name: str, scene: Any) -> Sensor:
        """The quantity as the sensor ``name`` of a scene."""
        return self

    def unit_of(self, component: int) -> str:
        """Unit of one component."""
        return self.unit

    def remember(self, m: Any, name: str, x: Array) -> Array:
        """A series of it, (n, size), in a checkpoint; see :mod:`..serialisation`."""
        return np.asarray(m(name, x))

    @property
    def labels(self) -> Sequence[str]:
        """Names of the components; numbers where there are none."""
        return ()


class OfStates(Sensor):
    """A quantity of states alone, told of one or of many at a time."""

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """The quantity, (.., size), in states q (.., n_q), v and a (.., n_v); collective."""
        raise NotImplementedError

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The quantity, (size,); collective."""
        return self.told(ev.system, state.q, state.v, state.a)

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The states."""
        return Look(states=True)

    def series(self, seen: Recorded, marker: int) -> Array:
        """The quantity in all records, (k, size); collective."""
        return self.told(*seen.motion)


@dataclass(frozen=True, eq=False)
class BodySensor(Sensor):
    """A quantity of a whole body."""

    body: Any = None

    @property
    def reads(self) -> dict[str, str]:
        """A body."""
        return {"body": named_part("body", self.body)}


class OfStrains(BodySensor):
    """A quantity that follows from strains at a place of a body."""

    @property
    def strain_degree(self) -> int | None:
        """That of the displacements."""
        return self.body.displacement_degree  # type: ignore[no-any-return]


class PartName(str):
    """The name of a part of a scene, which knows the ``part``: one of another scene may have the same name."""

    part: Any


def named_part(what: str, part: Any) -> str:
    """The name of a part of a scene, given by its name or itself."""
    name = part if isinstance(part, str) else name_of(part)
    if name is None:
        raise InputError(f"{what} {shown(part)} must be a name, or what bears it.")
    if part is name:
        return name
    made = PartName(name)
    made.part = part
    return made
