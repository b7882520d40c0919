"""Starts by the driver: the matrix of a state that it evaluated is factored and solved there, and not in NumPy.

Only where the rows certainly do not depend on each other, which the first factor tells; else all is NumPy's.
"""

from __future__ import annotations

from typing import Any

from ..rotations import Array
from ..system.compiled.evaluation import DriverEvaluation, DriverStates
from ..system.evaluation import Evaluation
from .blocks.field_blocks import Weights


class DriverSolver:
    """Of one :class:`~.condensation.StepSolver`; ``ready``: the matrix prepared last is the driver's."""

    def __init__(self, states: DriverStates) -> None:
        self.states = states
        self.ready = False
        self.usable: bool | None = None  # None: nothing was looked at so far
        self._counted = 0
        self._last: DriverEvaluation | None = None  # made by :meth:`at`

    def at(self, t: float, q: Array, v: Array | None) -> Evaluation:
        """The system in one state; what was found of the one before is taken where it is the same."""
        last = self._last
        if last is not None and last.t == t and last.q is q and last.v is v:
            return last.again()
        made = self.states.at(t, q, v)
        self._last = None if self.states.remembers else made
        return made

    def prepare(self, ev: Evaluation, weights: Weights, stiffness: Any) -> bool:
        """Factor the matrix of a state; False where NumPy has to."""
        states, self.ready = self.states, False
        if self.usable is False or stiffness is not None or weights.cm != 1.0 or not states.evaluated(ev):
            return False
        if self.usable is None:
            self.usable = states.prepare(ev, 0.0, 0.0) and states.independent()
        self.ready = self.usable and states.prepare(ev, weights.cd, weights.ck)
        return self.ready

    def new_factors(self) -> int:
        """Factorisations since the last call."""
        new, self._counted = self.states.factors - self._counted, self.states.factors
        return new

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers (n_lam,) for right-hand sides b and c."""
        return self.states.solve(b, c)
