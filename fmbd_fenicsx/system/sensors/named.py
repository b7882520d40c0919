"""Quantities of parts of a scene that are given by their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import wraps
from typing import Any, ClassVar

from ...errors import InputError, near
from ...rotations import Array
from ..evaluation import Evaluation
from ..layout import State
from .sensor import Sensor


@dataclass(frozen=True, eq=False)
class OfNamed(Sensor):
    """A quantity of parts that are given by their names, this the first: ``make`` of a look-up among the scene's ``parts``."""

    shown_as: ClassVar[str] = "sensor of"
    _: KW_ONLY
    make: Callable[[Callable[[str], Any]], Sensor]
    parts: str
    name: str

    def in_scene(self, name: str, scene: Any) -> Sensor:
        """The quantity of the parts.

        Raises:
            InputError: the scene has no such part so far.
        """
        known = getattr(scene, self.parts)

        def part(wanted: str) -> Any:
            if wanted not in known:
                raise InputError(
                    f'Sensor "{name}": "{wanted}" is not among the {self.parts} of the scene. {near(wanted, known)}'
                )
            return known[wanted]

        return self.make(part)

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """No scene has told which part it is."""
        raise InputError(f'"{self.name}" is a name that only scene.sensor(...) looks up: give the part itself here.')


def or_name(parts: str) -> Callable[[Callable[[Any], Sensor]], Callable[[Any], Sensor]]:
    """Lets the maker of a sensor take a part of a scene also by its name; ``parts``: among which of the scene's."""

    def taking(make: Callable[[Any], Sensor]) -> Callable[[Any], Sensor]:
        @wraps(make)
        def made(part: Any) -> Sensor:
            if isinstance(part, str):
                return OfNamed(None, "", make=lambda known: make(known(part)), parts=parts, name=part)
            return make(part)

        return made

    return taking
