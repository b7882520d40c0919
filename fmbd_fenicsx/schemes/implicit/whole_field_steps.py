"""Whole implicit steps in compiled code of systems with elastic fields: matrices of each frequency have tables of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import LinearSolveError
from ...linear.frequency_solvers import FrequencySolver
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.field_stages import FieldStageRoom
from ...system.layout import State
from .stage_krylov import shares
from .whole_steps import WholeSteps

if TYPE_CHECKING:
    from .field_stages import FieldEquations


class WholeFieldSteps(WholeSteps):
    """Of :class:`.field_stages.FieldEquations`: where solutions need no iteration."""

    def __init__(self, equations: FieldEquations) -> None:
        self.eq = equations
        self._lent: list[FrequencySolver] = []  # who solves, and for which frequencies

    @property
    def ready(self) -> bool:
        """As :attr:`WholeSteps.ready`."""
        eq = self.eq
        return isinstance(eq.system.evaluator, DriverStates) and eq.trusted and eq.covered

    def tables(self, state: State) -> DriverStates | None:
        """As :meth:`WholeSteps.tables`."""
        states = self.eq.system.evaluator
        if not isinstance(states, DriverStates) or self.eq.solver.driver is None:
            return None
        if self.eq.solver.core.redundant:
            states.let_depend(self.eq.solver.core.redundant)
        return states

    def solves_for(self, s: Array) -> bool:
        """As :meth:`WholeSteps.solves_for`: N is of a real frequency."""
        self._lent = self.eq.solvers_of(s)
        real = sum(by.weights.real for by in self._lent)
        apart = real <= 1 and (self.eq.levels < 2 or real == 1)
        return apart and all(by.exact for by in self._lent)

    def room(self, frequencies: int, points: int) -> FieldStageRoom:
        """As :meth:`WholeSteps.room`."""
        room = self.eq.stage_room(frequencies, points, shares(self.eq.system) ** 2)
        assert room is not None
        return room

    def lend(self, room: FieldStageRoom, state: State, tangent: Any, matrices: Callable[[float], None]) -> None:
        """As :meth:`WholeSteps.lend`: steps take derivatives of their own, and ask for the matrices of their frequencies."""
        eq = self.eq
        eq.begin(state, closed=False)
        eq.renewals.lend(room)
        room.begin(matrices, eq.consistent_start(state) if eq.estimates else None)

    def lend_matrices(self, room: FieldStageRoom, state: State, s: Array) -> None:
        """As :meth:`WholeSteps.lend_matrices`. Solutions are not iterated on there: an increment more is cheaper."""
        eq, system = self.eq, self.eq.system
        if not (all(eq.solvers.settled(complex(x)) for x in s) and self.solves_for(s)):
            raise LinearSolveError("frequencies that come once have no factors.")

        if isinstance(system.evaluator, DriverStates):  # elements remember the steps of the march, not where it began
            system.evaluator.tables.remember()
        if (at := room.take_outworn()) is not None:
            eq.renewals.take_predicted(eq.evaluation(at), room.origin)

        ev = system.at(state.t, state.q, state.v)
        ev.balance(state.a, state.lam)
        for by in reversed(self._lent):  # complex ones look at rows with the tables of real ones
            by.prepare(ev)
            if by.weights.real:
                eq.closing.metric = by.weights

        ready = [tables for by in self._lent if (tables := by.tables) is not None]
        if len(ready) < len(s):
            raise LinearSolveError("the matrix of a frequency is NumPy's.")
        room.solve_by(ready, np.zeros(len(s)), np.inf)
        for states in ready:
            states.factor.hold(None)

    def kept(self, room: FieldStageRoom, judge: Judge, *, known: bool) -> tuple[Any, Any]:
        """As :meth:`WholeSteps.kept`: nothing, but whether new tangents are due."""
        self.eq.renewals.follow(room)
        return None, None

    def refused(self, room: FieldStageRoom) -> None:
        """As :meth:`WholeSteps.refused`."""
        self.eq.renewals.tried(room)
