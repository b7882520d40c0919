"""Whole implicit steps in compiled code (driver/implicit/implicit.c): what the equations lend them, and what they leave.

Those of systems with elastic fields: :mod:`.whole_field_steps`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...linear.implicit.sparse_pencil import SparsePencil
from ...linear.residual import Judge
from ...rotations import Array
from ...system.compiled.states.evaluation import DriverStates
from ...system.compiled.states.stages import PointRoom, StageRoom
from ...system.layout import State
from .step_tangents import RestingTangents, SparseTangents

if TYPE_CHECKING:
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
