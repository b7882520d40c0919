"""Whole implicit steps in compiled code (driver/implicit/implicit.c): what the equations lend them, and what they leave."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...errors import LinearSolveError
from ...linear.frequency_solvers import FrequencySolver
from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.field_stages import FieldStageRoom
from ...system.compiled.states.stages import PointRoom, StageRoom
from ...system.layout import State
from .stage_krylov import shares
from .step_tangents import RestingTangents, SparseTangents

if TYPE_CHECKING:
    from .field_stages import FieldEquations
    from .step_equations import StepEquations


class WholeSteps:
    """What a stepper asks of them; what is not said otherwise is that of tangents that are matrices of their own. Collective."""

    @property
    def ready(self) -> bool:
        """Whether whole steps of constant size are compiled."""
        raise NotImplementedError

    def tables(self, state: State) -> DriverStates | None:
        """With whose tables they are made from a state on; None where they are made in parts."""
        raise NotImplementedError

    def solves_for(self, s: Array) -> bool:
        """Whether compiled code has matrices of the frequencies s (p,)."""
        return True

    def room(self, frequencies: int, points: int) -> PointRoom:
        """Room for so many points of them."""
        raise NotImplementedError

    def lend(self, room: Any, state: State, tangent: Any, matrices: Callable[[float], None]) -> None:
        """What they begin with in a state: the tangent that serves on, None without any; ``matrices``: who lends those that
        compiled code asks for.
        """
        raise NotImplementedError

    def lend_matrices(self, room: Any, state: State, s: Array) -> None:
        """Give compiled code the matrices of the frequencies s (p,) at a state; LinearSolveError where it goes without."""

    def kept(self, room: Any, judge: Judge, *, known: bool) -> tuple[Any, Any]:
        """Tangent and factors that they have left, where they are ``known`` to serve on."""
        return None, None

    def serves(self, tangent: Any) -> bool:
        """Whether compiled steps go on with a tangent that steps in parts have taken."""
        return tangent is not None

    def refused(self, room: Any) -> None:
        """Take notice of what they have tried in a step that they have not made."""


class WholeMatrixSteps(WholeSteps):
    """Of :class:`.step_equations.StepEquations`, whose tangents are matrices."""

    def __init__(self, equations: StepEquations) -> None:
        self.eq = equations

    @property
    def ready(self) -> bool:
        """As :attr:`WholeSteps.ready`."""
        self.eq.make_ready()
        return isinstance(self.eq.tangents, SparseTangents) or self.eq.resting is not None

    def tables(self, state: State) -> DriverStates | None:
        """As :meth:`WholeSteps.tables`."""
        driver = self.eq.solver.driver
        return None if driver is None else driver.whole_steps(state)

    @property
    def _tangents(self) -> SparseTangents | RestingTangents:
        """Theirs."""
        if self.eq.resting is not None:
            return self.eq.resting
        assert isinstance(self.eq.tangents, SparseTangents)
        return self.eq.tangents

    def room(self, frequencies: int, points: int) -> StageRoom:
        """As :meth:`WholeSteps.room`."""
        return self._tangents.room(frequencies, points)

    def serves(self, tangent: Any) -> bool:
        """As :meth:`WholeSteps.serves`."""
        return tangent is not None and self.eq.resting is None

    def lend(self, room: StageRoom, state: State, tangent: Any, matrices: Callable[[float], None]) -> None:
        """As :meth:`WholeSteps.lend`."""
        if self.serves(tangent) and tangent is not room.tangent:
            room.structure.data(tangent, room.data)
        self._tangents.weigh_once(self.eq.solver, state)
        room.let_depend(redundant=self.eq.solver.core.redundant)

    def kept(self, room: StageRoom, judge: Judge, *, known: bool) -> tuple[Any, Any]:
        """As :meth:`WholeSteps.kept`."""
        if not isinstance(self.eq.tangents, SparseTangents):
            return None, None
        self.eq.tangents.take_directions(room.tangent)
        return (room.tangent, SparsePencil(room.tangent, room.frequencies, judge, room)) if known else (None, None)


class WholeFieldSteps(WholeSteps):
    """Of :class:`.field_stages.FieldEquations`, where solutions need no iteration: matrices of each frequency have tables of
    their own.
    """

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
        room.solve_by(ready)
        for states in ready:
            states.factor.hold(None)

    def kept(self, room: FieldStageRoom, judge: Judge, *, known: bool) -> tuple[Any, Any]:
        """As :meth:`WholeSteps.kept`: nothing, but whether new tangents are due."""
        self.eq.renewals.follow(room)
        return None, None

    def refused(self, room: FieldStageRoom) -> None:
        """As :meth:`WholeSteps.refused`."""
        self.eq.renewals.tried(room)
