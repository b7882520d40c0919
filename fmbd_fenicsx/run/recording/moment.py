"""The present moment of a run, as functions called after each step and users of the stepper see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ...errors import InputError, near
from ...rotations import Array
from ...system.compiled.recording import Recorded
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.scene.scene import Scene
from ...system.system import System


@dataclass(frozen=True)
class Moment:
    """An instant of a run: its ``state`` at time ``t`` (s) after ``step`` steps; ``moment["tip"]`` reads a sensor, collective."""

    scene: Scene
    system: System
    markers: dict[str, int]
    state: State
    step: int
    told: Recorded | None = None  # what compiled code told of this instant

    def __repr__(self) -> str:
        return f'<Moment of scene "{self.scene.name}": t = {self.t:g} s, step {self.step}>'

    @property
    def t(self) -> float:
        """Time, s."""
        return self.state.t

    @cached_property
    def evaluation(self) -> Evaluation:
        """The system in this state."""
        return self.system.at(self.state.t, self.state.q, self.state.v)

    def __getitem__(self, sensor: str) -> Array:
        """Value of a sensor of the scene, (size,)."""
        if sensor not in self.markers:
            raise InputError(f'No sensor "{sensor}". {near(sensor, self.markers)}')
        one, marker = self.scene.sensors[sensor], self.markers[sensor]
        known = None if self.told is None else self.told.newest(one, marker)
        return one.read(self.evaluation, self.state, marker) if known is None else known.copy()

    def energies(self) -> dict[str, float]:
        """Energies by kind, J."""
        return self.evaluation.energies()
