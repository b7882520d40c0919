"""The system of a scene, built once for all runs that are made with it."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass

from ..notices import Gathered
from ..system.scene.scene import Scene
from ..system.system import State, System


@dataclass(frozen=True)
class Built:
    """The system of a scene, its state as given, the numbers of its markers; ``warned`` on the way, in ``seconds``."""

    system: System
    given: State
    markers: dict[str, int]
    warned: Gathered
    seconds: float


def build(scene: Scene) -> Built:
    """The system of a scene; collective."""
    called = clock.perf_counter()
    with Gathered() as warned:
        system, given, markers = scene.build()
    return Built(system, given, markers, warned, clock.perf_counter() - called)
