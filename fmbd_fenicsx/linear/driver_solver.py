"""Solutions by the driver: the matrix of a state that it evaluated is factored and solved there, and not in NumPy.

Only where the rows certainly do not depend on each other, which the first factor tells. Where NumPy finds that they do, the
driver makes what explicit schemes ask for in one call, with the smallest multipliers; all else is NumPy's.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from ..rotations import Array
from ..system.compiled.choice import solves
from ..system.compiled.evaluation import DriverEvaluation, DriverStates
from ..system.compiled.explicit import ExplicitStates, Stages, Tableau
from ..system.evaluation import Evaluation
from ..system.system import State, System
from .blocks.field_blocks import Weights

if TYPE_CHECKING:
    from .core import CoreSolver


class DriverSolver:
    """Of one :class:`~.condensation.StepSolver`; ``ready``: the matrix prepared last is the driver's."""

    def __init__(self, states: DriverStates, core: CoreSolver) -> None:
        """``core``: NumPy's, which knows where rows depend on each other."""
        self.states, self.core = states, core
        self.ready = False
        self.usable: bool | None = None  # None: nothing was looked at so far
        self._counted = 0

    def prepare(self, ev: Evaluation, weights: Weights) -> bool:
        """Factor the matrix of a state; False where NumPy has to."""
        states, self.ready = self.states, False
        if self.usable is False or weights.cm != 1.0 or not states.evaluated(ev):
            return False
        self.ready = self._looked(ev) and states.prepare(ev, weights.cd, weights.ck)
        return self.ready

    def _looked(self, ev: DriverEvaluation) -> bool:
        """Whether rows do not depend on each other, which the first state tells."""
        if self.usable is None:
            self.usable = self.states.prepare(ev, 0.0, 0.0) and self.states.independent()
        return self.usable

    def _usable_at(self, t: float, q: Array, v: Array) -> bool:
        """Whether one call finds all; the state is evaluated where nothing is known so far."""
        usable = self._looked(self.states.at(t, q, v)) if self.usable is None else self.usable
        if not usable and self.core.redundant:
            self.states.let_depend()
        return usable or self.core.redundant

    def accelerations(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """a and lambda of a consistent state in one call; None where they have to be found in parts."""
        usable = self._usable_at(t, q, v)
        found = self._explicit.accelerations(t, q, v) if usable else None
        self.ready = found is not None
        return found

    def closed(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """q and v on the constraints in one call; None as above. Nothing is prepared then."""
        usable, self.ready = self._usable_at(t, q, v), False
        return self._explicit.closed(t, q, v) if usable else None

    def stages(self, state: State, h: float, tableau: Tableau) -> Stages | None:
        """All stages of an explicit Runge-Kutta method from a state in one call; None as above. Nothing is prepared then."""
        usable, self.ready = self._usable_at(state.t, state.q, state.v), False
        return self._explicit.stages((state.t, h), (state.q, state.v, state.a), tableau) if usable else None

    def half_stage(self, state: State, *given: Any) -> tuple[Array, Array, int] | None:
        """A stage of a half-explicit method in one call, see ExplicitStates; ``state``: the start of the step."""
        usable, self.ready = self._usable_at(state.t, state.q, state.v), False
        return self._explicit.half_stage(*given) if usable else None

    @cached_property
    def _explicit(self) -> ExplicitStates:
        """What the driver does in one call."""
        return ExplicitStates(self.states)

    def new_factors(self) -> int:
        """Factorisations since the last call."""
        new, self._counted = self.states.factors - self._counted, self.states.factors
        return new

    def solve(self, b: Array, c: Array) -> tuple[Array, Array]:
        """Increment like v and multipliers (n_lam,) for right-hand sides b and c."""
        return self.states.solve(b, c)


def driver_solver(system: System, core: CoreSolver) -> DriverSolver | None:
    """Solutions by the driver, where it evaluates a system and knows how to solve for it; ``core``: of the same solver."""
    return DriverSolver(system.evaluator, core) if solves(system.evaluator) else None
