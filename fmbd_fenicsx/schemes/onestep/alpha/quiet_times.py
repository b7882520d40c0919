"""Where loads within steps need no look: several steps are looked at together, and twice as many the next time."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ....system.layout import State
from ....system.serialisation import Remembering, plain
from .look_ahead import LookAhead
from .stretch import SAME

FARTHEST = 64  # steps whose loads are looked at together
CALM = 0.01  # errors of late over what is allowed, below which nothing happens


class QuietTimes(Remembering):
    """What was looked at by ``look``, for steps that may have any size."""

    keeps: ClassVar = dict.fromkeys(("largest", "quiet", "far"), plain())

    def __init__(self, look: LookAhead) -> None:
        self.look = look
        self.largest = 0.0  # step in which loads were looked at, s
        self.quiet = 0.0, -np.inf  # size of steps that were looked at ahead, and until when, s
        self.far = 1  # of how many steps loads are looked at next

    def until(self, h: float) -> float:
        """Up to when loads within steps of size h (s) have been looked at, s."""
        size, end = self.quiet
        return end if h == size else -np.inf

    def holds(self, t: float, h: float, peak: float) -> bool:
        """Whether loads within a step of size h from t on (s) need no look; ``peak``: errors of late over what is allowed."""
        return t + h <= self.until(h) or (h <= self.largest and peak > CALM)

    def error(self, s: State, h: float, end: float) -> float:
        """What a load within a step of size h (s) moves, in the norm of errors; 0 where nothing comes within several steps.

        ``end`` (s): that of the run.
        """
        with self.look.norm.looking():
            error = 0.0 if self._extended(s, h, max(end - s.t, 0.0)) else self.look.loads(s, h)
        if error <= 1.0:
            self.largest = max(self.largest, h)
        return error

    def _extended(self, s: State, h: float, left: float) -> bool:
        """Whether nothing comes within several steps, twice as many as the last time, up to one in which drives begin to move."""
        steps = int(min(self.far, left / h))
        if steps > 1:
            steps = self.look.still(s, h, steps)
        if steps < 2 or not self.look.loads(s, h, steps) <= 1.0:
            self.far = 1 if self.far > 1 else 2  # the step behind one that failed is looked at alone
            return False
        self.quiet, self.far = (h, s.t + steps * h * (1 + SAME)), min(2 * self.far, FARTHEST)
        return True
