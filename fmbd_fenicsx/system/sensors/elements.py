"""Sensors of force elements: effort, tension, force, torque, elongation, power.

An element that acts on a joint coordinate or along a line has one restoring effort N(s, s', t); every element has wrenches on its
two markers, whose power is what it gives to the bodies.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError, near, require
from ...mechanics.forces.force_elements import Loads
from ...mechanics.forces.forces import Force
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State
from ..powers import power_of
from .named import or_name
from .sensor import Sensor


def find(system: Layout, name: str) -> tuple[Loads, list[int]]:
    """The batch of the named element, and where it stands in it.

    Raises:
        InputError: no such element in the scene.
    """
    for loads in system.forces:
        at = [i for i, f in enumerate(loads.forces) if f.name == name]
        if at:
            return loads, at
    known = [f.name for loads in system.forces for f in loads.forces]
    raise InputError(f'No force element "{name}" in the scene. {near(name, known)}')


@dataclass(frozen=True, eq=False)
class _ElementSensor(Sensor):
    element: str = ""

    @property
    def reads(self) -> dict[str, str]:
        """A force element."""
        return {"force": self.element}

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The element."""
        return Look(element=self.element)


@dataclass(frozen=True, eq=False)
class ElementScalar(_ElementSensor):
    """Elongation (0), its rate (1) or restoring effort (2) of an element on one coordinate, times ``sign``."""

    which: int = 0
    sign: float = 1.0
    derivative = 1

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The value, (1,)."""
        loads, at = find(ev.system, self.element)
        found = ev.asked(loads, "scalar")
        assert found is not None  # refused when the sensor was made
        return np.asarray(self.sign * found[self.which][at])

    def series(self, seen: Recorded, marker: int) -> Array:
        """The value, (k, 1)."""
        numbers, sign = self.numbers(seen, marker)
        return np.asarray(sign * numbers)

    def numbers(self, seen: Recorded, marker: int) -> tuple[Array, float]:
        """As :meth:`Sensor.numbers`."""
        return seen.reading(self.element)[:, :, self.which], self.sign


@dataclass(frozen=True, eq=False)
class ElementWrench(_ElementSensor):
    """Force (``torque`` False) or torque of an element on its body b, or on a where it has no b; world axes."""

    torque: bool = False
    on_b: bool = True
    derivative = 1

    @property
    def labels(self) -> str:
        """Components of a vector; in the plane a torque is one number."""
        return "xyz"

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Components in world axes."""
        loads, at = find(ev.system, self.element)
        wrench = ev.asked(loads, "wrenches")[1 if self.on_b else 0][at].sum(0)
        d = ev.system.motions.dim
        return np.asarray(wrench[d:] if self.torque else wrench[:d])

    def looks_at(self, system: Layout, marker: int) -> Look:
        """What the element exerts on the body."""
        return Look(element=self.element, side=int(self.on_b))

    def series(self, seen: Recorded, marker: int) -> Array:
        """Components in world axes, (k, d or n_rot)."""
        d = seen.dim
        wrench = seen.wrench(self.element, int(self.on_b))
        return wrench[:, d:] if self.torque else wrench[:, :d]


@dataclass(frozen=True, eq=False)
class ElementPower(_ElementSensor):
    """Power that an element gives to the bodies, W."""

    derivative = 1

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Sum of wrench times twist over both markers, (1,)."""
        loads, at = find(ev.system, self.element)
        return np.array([power_of(loads, ev)[at].sum()])

    def series(self, seen: Recorded, marker: int) -> Array:
        """- N s', (k, 1)."""
        found = seen.reading(self.element)
        return np.asarray((-found[:, :, 2] * found[:, :, 1]).sum(axis=1, keepdims=True))


def _pushing(what: str, element: Any) -> Force:
    """An element with one force and torque on each of its two sides.

    Raises:
        InputError: one on a sum of coordinates, which pushes on every joint of it.
    """
    f = _element(what, element)
    several = f.coordinate is not None and len(f.coordinates) > 1 and f.kind != "controller"
    require(
        not several,
        f'{what}: "{f.name}" acts on the sum of {len(f.coordinates)} coordinates, and on the bodies of all their joints. '
        "Take element_effort: that on a coordinate is it times the factor of the coordinate in the sum.",
    )
    return f


def _element(what: str, element: Any, *, scalar: bool = False) -> Force:
    require(
        isinstance(element, Force),
        f"{what} takes a force element such as fmbd.Spring(...) or fmbd.motor(...), or its name, found {element!r}.",
    )
    one = element.coordinate is not None or element.kind in ("spring", "force element")
    require(
        one or not scalar,
        f'{what}: "{element.name}" ({element.kind}) acts on no single coordinate. Use element_force or element_torque.',
    )
    return element  # type: ignore[no-any-return]


def _effort_unit(element: Force) -> str:
    turning = element.coordinate is not None and element.coordinate.unit == "rad"
    return "N m" if turning else "N"


@or_name("forces")
def element_effort(element: Force) -> Sensor:
    """Effort of an element on its joint coordinate (N m or N), (1,): positive where it drives the coordinate up.

    Of a motor, a joint spring, friction, a stop. Of a spring between two points: positive where it pushes them apart.
    """
    f = _element("element_effort", element, scalar=True)
    return ElementScalar(None, _effort_unit(f), None, f.name, 2, -1.0)


@or_name("forces")
def tension(element: Force) -> Sensor:
    """Tension (N) of a spring between two points, (1,): positive where it pulls them together."""
    f = _element("tension", element, scalar=True)
    return ElementScalar(None, _effort_unit(f), None, f.name, 2, 1.0)


@or_name("forces")
def elongation(element: Force) -> Sensor:
    """Elongation (m or rad) of an element from its unstressed state, (1,)."""
    f = _element("elongation", element, scalar=True)
    unit = "m" if f.coordinate is None else f.coordinate.unit
    return ElementScalar(None, unit, None, f.name, 0, 1.0)


@or_name("forces")
def element_force(element: Force) -> Sensor:
    """Force (N) of any element on its body b (on a where it has no b), world axes, (d,)."""
    f = _pushing("element_force", element)
    return ElementWrench(None, "N", None, f.name, False, f.b is not None)


@or_name("forces")
def element_torque(element: Force) -> Sensor:
    """Torque (N m) of any element on its body b (on a where it has no b) about its point there, world axes, (n_rot,)."""
    f = _pushing("element_torque", element)
    return ElementWrench(None, "N m", None, f.name, True, f.b is not None)


@or_name("forces")
def element_power(element: Force) -> Sensor:
    """Power (W) that an element gives to the bodies, (1,): negative where it takes energy, as dampers and friction do."""
    return ElementPower(None, "W", None, _element("element_power", element).name)
