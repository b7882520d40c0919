"""A recorder that also takes its sensors at other instants: what a run is compared with others by, or where its records are at
given times, the ends of its steps.
"""

from __future__ import annotations

from typing import Any

from ...system.compiled.recording import Recorded
from ...system.evaluation import Evaluation
from ...system.layout import State
from .output import Output
from .recorder import Recorder


class Accompanied(Recorder):
    """Records as it is asked to, and sensors as ``wanted`` of a recorder ``beside``. One of both records at given times, the
    other one ends of steps, on the tape of compiled ones where there is one.
    """

    def __init__(self, of: Recorder, wanted: Output) -> None:
        super().__init__(of.scene, of.system, of.markers, of.output, of.t_end)
        self.beside = Recorder(of.scene, of.system, of.markers, wanted, of.t_end)
        if self.timed:
            self.straight = self.beside.straight

    @property
    def timed(self) -> bool:
        """Whether the records of the run itself are at given times."""
        return self.output.times is not None

    @property
    def on_tape(self) -> bool:
        """Ends of steps may be."""
        return self.beside.on_tape if self.timed else super().on_tape

    def take_tape(self, seen: Recorded, first: int) -> None:
        """By the one that records ends of steps."""
        if self.timed:
            self.beside.take_tape(seen, first)
        else:
            super().take_tape(seen, first)

    def free(self, t: float, h: float) -> int:
        """Up to the next of the times, too: the step that passes one is the last of all, or one by itself."""
        if self.timed:
            return super().quiet(0, t, h)
        return min(super().free(t, h), self.beside.quiet(0, t, h, through=True))

    def quiet(self, n: int, t: float, h: float, *, through: bool = False) -> int:
        """The same."""
        return min(super().quiet(n, t, h, through=through), self.beside.quiet(n, t, h, through=through))

    def go_on(self, state: State) -> None:
        """The same for both."""
        self.beside.go_on(state)
        super().go_on(state)

    def take_within(self, n: int, state: State, stepper: Any) -> None:
        """The same for both."""
        self.beside.take_within(n, state, stepper)
        super().take_within(n, state, stepper)

    def take(self, n: int, state: State, seen: Evaluation | None = None, stepper: Any = None) -> None:
        """Record step n, and the times that it has passed."""
        self.beside.take(n, state, seen, stepper)
        super().take(n, state, seen, stepper)
