"""How far the joints of a run were open, and how fast its bodies turned, in the states that it has recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...system.compiled.recording import Recorded
from ...system.compiled.tape import Openness
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.serialisation import Memory
from ...system.system import System
from ..judges.acceptance import Closed


@dataclass
class Drift:
    """The largest of what joints were open so far; ``closed`` refuses states in which that is too much.

    ``gap`` (m), ``slip`` (m/s) of all rows as lengths; ``worst_slip`` (m/s), that of angles times the model's length, beside the
    largest velocity, ``fastest`` (m/s), both where ``closed`` looks at them; ``turning`` (rad/s): the fastest of a frame.
    """

    system: System
    closed: Closed | None = None
    gap: float = 0.0
    slip: float = 0.0
    worst_slip: float = 0.0
    fastest: float = 0.0
    turning: float = 0.0

    @property
    def openness(self) -> Openness:
        """By what records of compiled steps are judged."""
        return Openness(np.ones(self.system.n_lam), np.inf, 0.0) if self.closed is None else self.closed.openness

    def judge(self, n: int, state: State, ev: Evaluation) -> None:
        """Joints at the end of step n; raises ConvergenceError where they are too far open; collective."""
        if self.closed is not None and n:
            self.closed.check(ev)
        elif self.closed is not None:
            self.closed.last = state.t
        self.turning = max(self.turning, float(np.maximum.reduce(self.system.turning(state.v))))
        if not self.system.n_lam:
            return

        units = self.system.row_units
        rate = np.abs(ev.opening())
        self.gap = max(self.gap, float((units * np.abs(ev.constraint())).max()))
        self.slip = max(self.slip, float((units * rate).max()))
        if self.closed is not None:
            self.worst_slip = max(self.worst_slip, float((self.closed.units * rate).max()))
            self.fastest = max(self.fastest, self.system.max_abs(state.v))

    def judge_tape(self, seen: Recorded, t: float) -> None:
        """Joints in all records of compiled steps up to a time t (s), as :meth:`judge`."""
        if self.closed is not None:
            self.closed.check_tape(seen, t)
        gap, slip, worst, fastest, turning = seen.worst
        self.gap, self.slip, self.turning = max(self.gap, gap), max(self.slip, slip), max(self.turning, turning)
        if self.closed is not None:
            self.worst_slip, self.fastest = max(self.worst_slip, worst), max(self.fastest, fastest)

    def remember(self, m: Memory) -> None:
        """The largest so far."""
        known = self.gap, self.slip, self.worst_slip, self.fastest, self.turning
        self.gap, self.slip, self.worst_slip, self.fastest, self.turning = m("largest", known)
