"""A recorder that also takes its sensors at other instants: what a run is compared with others by, or where its records are at
given times, the ends of its steps.
"""

from __future__ import annotations

from typing import Any

from ...rotations import Array
from ...schemes.stepping import TimeStepper
from ...system.compiled.recording import Recorded
from ...system.compiled.tape import Tape
from ...system.evaluation import Evaluation
from ...system.layout import State
from .output import Output
from .recorder import Recorder


class Accompanied(Recorder):
    """Records as it is asked to, and sensors as ``wanted`` of a recorder ``beside``. One of both records at given times, the
    other one ends of steps.
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
        """Both have to be."""
        return self.beside.on_tape and super().on_tape

    @property
    def every(self) -> int:
        """Of the one that records ends of steps."""
        return min(self.beside.every, super().every)

    @property
    def wanted(self) -> Array | None:
        """Of the other one."""
        return super().wanted if self.timed else self.beside.wanted

    @property
    def energy_too(self) -> bool:
        """As :attr:`wanted`, by the other one."""
        return super().energy_too if self.timed else self.beside.energy_too

    @property
    def earlier(self) -> State | None:
        """As :attr:`wanted`, of the other one."""
        return super().earlier if self.timed else self.beside.earlier

    def take_tape(self, seen: Recorded, first: int) -> None:
        """Ends of steps by the one that records them."""
        self.beside.take_tape(seen, first)
        super().take_tape(seen, first)

    def take_kept(self, tape: Tape, stepper: TimeStepper, first: int) -> None:
        """Instants by the other one."""
        self.beside.take_kept(tape, stepper, first)
        super().take_kept(tape, stepper, first)

    def quiet(self, n: int, t: float, h: float, *, through: bool = False) -> int:
        """Of both the least."""
        return min(super().quiet(n, t, h, through=through), self.beside.quiet(n, t, h, through=through))

    def arrive(self, summed: State, state: State) -> None:
        """The same for both."""
        self.beside.arrive(summed, state)
        super().arrive(summed, state)

    def go_on(self, state: State) -> None:
        """The same for both."""
        self.beside.go_on(state)
        super().go_on(state)

    def begin_step(self, n: int, before: State, earlier: State | None) -> None:
        """The same for both."""
        self.beside.begin_step(n, before, earlier)
        super().begin_step(n, before, earlier)

    def take_within(self, n: int, state: State, stepper: Any) -> None:
        """The same for both."""
        self.beside.take_within(n, state, stepper)
        super().take_within(n, state, stepper)

    def take(self, n: int, state: State, seen: Evaluation | None = None, stepper: Any = None) -> None:
        """Record step n, and the times that it has passed."""
        self.beside.take(n, state, seen, stepper)
        super().take(n, state, seen, stepper)
