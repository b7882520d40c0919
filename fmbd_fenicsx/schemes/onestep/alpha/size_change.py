"""Steps of generalized-alpha one after the other, each of a size of its own: what belongs to a size changes with it, see (1) of
:mod:`.variable_alpha`, and velocities miss their constraints by a multiple of h^2, by another one with another size,

    v  <-  v + dv,   (M + S K) dv + G^T mu = 0,   G dv = (r^2 - 1) (G v + g_t),     r = h_new / h_old                  (1)

S is that of a step over the whole stretch, so that (1) moves elastic bodies as if they were rigid: with M alone it bends them,
and they vibrate from then on, by ten times the error of equal steps.

Openings of roundoff, that of places over the size, are closed and not widened, and so is G (A - a): far from the origin, behind
the short steps of a start, forces of roundoff grew by r with each change, up to the whole tension of a tether.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ....errors import LinearSolveError
from ....linear.blocks.field_blocks import Weights
from ....linear.condensation import StepSolver
from ....rotations import Array
from ....system.compiled.declarations import constants
from ....system.evaluation import Evaluation
from ....system.layout import State
from ....system.serialisation import Remembering, plain, worker
from ....system.system import System
from ...newton import known_gaps
from .stretch import DEEPEST, Stretch

# times the least motion that closes constraints: one that bends bodies less may be as large
(FARTHEST,) = constants("marches/control.c", "FARTHEST_MOTION")


@dataclass(frozen=True)
class SizeChange:
    """Of one system. ``weights``: those of a step of a size (s); ``bends``: whether anything in it does."""

    system: System
    solver: StepSolver
    stretch: Stretch
    weights: Callable[[float], Weights]
    bends: bool

    def of(self, s: State, jump: Array, sizes: tuple[float, float]) -> tuple[Array, Array]:
        """dv of (1), (n_v,), and the ``jump`` A - a without roundoff across the constraints, from steps of the first to those of
        the second of two sizes (s), with the matrix of the latter.
        """
        ev = self.system.at(s.t, s.q, s.v)
        ev.forces = s.a, s.lam
        before, h = sizes
        opening, across = ev.opening(), ev.jacobian.times(jump)
        known = known_gaps(ev, before * opening) / before
        noise = across - known_gaps(ev, before * before * across) / (before * before)
        dv = self._opened(ev, (h / before) ** 2 * known - opening, h)
        return dv, jump - self.solver.solve(np.zeros_like(jump), noise)[0] if noise.any() else jump

    def _opened(self, ev: Evaluation, opening: Array, h: float) -> Array:
        """dv of (1), (n_v,), for the right-hand side ``opening``, and the matrix for steps of size h (s)."""
        still = np.zeros(self.system.n_v)
        stiff = self._stiffly(ev, opening, h) if self.bends else None
        self.solver.prepare(ev, self.weights(h))
        soft, _ = self.solver.solve(still, opening)

        # forces may have a negative stiffness, and S K then no least motion
        if stiff is not None and self.system.max_abs(stiff) <= FARTHEST * self.system.max_abs(soft):
            return stiff
        return soft

    def _stiffly(self, ev: Evaluation, opening: Array, h: float) -> Array | None:
        """dv of (1) with S of the whole stretch, or of the largest part of it in which M is not lost; None where that is h."""
        for level in range(DEEPEST):
            span = self.stretch.size(level)
            if self.stretch.loses(span, ev.t) or self.solver.elastic.hides_masses(self.weights(span)):
                continue
            if span <= h:
                break
            try:
                self.solver.prepare(ev, self.weights(span))
                return self.solver.solve(np.zeros_like(ev.v), opening)[0]
            except LinearSolveError:
                self.stretch.lose(span, ev.t)
        return None


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
