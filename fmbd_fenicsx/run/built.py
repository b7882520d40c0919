"""The system of a scene, built once for all runs that are made with it, and its consistent start, found once."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from typing import Any

from ..linear.condensation import StepSolver
from ..notices import Gathered
from ..schemes.consistent import Correction
from ..schemes.declared import Declared
from ..system.element_memory import memories
from ..system.layout import State
from ..system.scene.scene import Scene
from ..system.system import System
from .problem import begin


@dataclass(frozen=True)
class ConsistentStart:
    """A consistent start, what it corrected, and what elements remember there."""

    state: State
    correction: Correction
    memories: list[Any]


@dataclass(frozen=True)
class Built:
    """The system of a scene, its state as given, the numbers of its markers; ``warned`` on the way, in ``seconds``.

    ``starts``: the start that a run has found, for later ones with the same scheme; empty before.
    """

    system: System
    given: State
    markers: dict[str, int]
    warned: Gathered
    seconds: float
    starts: list[ConsistentStart] = field(default_factory=list)

    def start(self, scene: Scene, scheme: Any, *, solver: StepSolver, h: float) -> ConsistentStart:
        """The consistent start, with first steps of h (s): the one that is known, or a new one; collective.

        A start that a scheme makes itself depends on the steps, and one with pressures on tangents: these are made each time.
        """
        if self.starts:
            # found by an earlier run with the same scheme
            self.system.evaluator.begin_anew()
            return self.starts[0]

        start = begin(scene, scheme, self.system, self.given, solver=solver, h=h)
        made = ConsistentStart(*start, memories(self.system))
        if Declared.by(scheme).start is None and not solver.pressures:
            self.starts.append(made)
        return made


def build(scene: Scene) -> Built:
    """The system of a scene; collective."""
    called = clock.perf_counter()
    with Gathered() as warned:
        system, given, markers = scene.build()
    return Built(system, given, markers, warned, clock.perf_counter() - called)
