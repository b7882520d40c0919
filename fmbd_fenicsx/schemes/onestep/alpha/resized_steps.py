"""Steps of generalized-alpha one after the other, each of a size of its own: what belongs to a size changes with it, see (1) of
:mod:`.variable_alpha` and :mod:`.size_change`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

from ....system.serialisation import Remembering, plain, worker
from .size_change import SizeChange


class ResizedSteps(Remembering):
    """``inner``, a stepper of constant steps, with the ``size`` (s) of its last step, None behind a start. Methods are
    collective.
    """

    keeps: ClassVar = {"inner": worker, "size": plain()}

    def __init__(self, inner: Any, change: SizeChange) -> None:
        self.inner, self.change = inner, change
        self.size: float | None = None
        self._misses = bool(change.system.n_lam) and not inner.stabilised  # whether velocities miss their constraints

    def step(self, h: float) -> None:
        """One step of size h (s)."""
        self.resize(h)
        self.inner.advance(h)
        self.size = h

    def resize(self, h: float) -> None:
        """Prepare for a step of size h (s)."""
        inner, s = self.inner, self.inner.state
        if inner.fresh or self.size is None or self.size == h:
            return
        v, jump = s.v, inner.A - s.a
        if self._misses:
            dv, jump = self.change.of(s, jump, (self.size, h))
            v = v + dv
        inner.go_on_from(replace(s, v=v), s.a + h / self.size * jump)

    def arrive(self, t: float) -> None:
        """Give the newest state its time, s."""
        if self.inner.state.t != t:
            self.inner.go_on_from(replace(self.inner.state, t=t))

    @property
    def held(self) -> Any:
        """What the next step begins with, to be kept and put back where that step is refused."""
        return self.inner.held, self.size, self.change.solver.pressures

    @held.setter
    def held(self, kept: Any) -> None:
        self.inner.held, self.size, self.change.solver.pressures = kept
