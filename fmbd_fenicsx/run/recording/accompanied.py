"""A recorder of a run with steps of its own choice that also takes its sensors at given times, those of another run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...system.evaluation import Evaluation
from ...system.system import State
from .output import Output
from .recorder import Recorder


class Accompanied(Recorder):
    """Records as it is asked to, and sensors at ``times`` (s) ``beside``: what the run is compared with others by."""

    def __init__(self, of: Recorder, times: Sequence[float]) -> None:
        super().__init__(of.scene, of.system, of.markers, of.output, of.t_end)
        wanted = Output(energy=False, progress=False, times=times)
        self.beside = Recorder(of.scene, of.system, of.markers, wanted, of.t_end)

    def free(self, t: float, h: float) -> int:
        """Up to the next of the times, too: the step that passes one is the last of all."""
        return min(super().free(t, h), self.beside.quiet(0, t, h, through=True))

    def quiet(self, n: int, t: float, h: float, *, through: bool = False) -> int:
        """The same."""
        return min(super().quiet(n, t, h, through=through), self.beside.quiet(n, t, h, through=through))

    def go_on(self, state: State) -> None:
        """The same for both."""
        self.beside.go_on(state)
        super().go_on(state)

    def take(self, n: int, state: State, seen: Evaluation | None = None, stepper: Any = None) -> None:
        """Record step n, and the times that it has passed."""
        self.beside.take(n, state, seen, stepper)
        super().take(n, state, seen, stepper)
