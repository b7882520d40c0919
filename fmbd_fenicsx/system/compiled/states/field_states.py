"""States of systems with elastic fields by the driver: balance and constraints in one call each.

The driver's tables of a field hold its matrices and ports, and what its own factor has solved for a size of step: there are
tables for states, where nothing is solved, and some with factors, which change with the size of the step. Rows of constraints
with their ports are NumPy's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....rotations import Array
from ...system import System
from ..tables.bodies.fields import Block, parts_of
from ..tables.tables import Tables
from .evaluation import Configurations, DriverStates


@dataclass
class Unsolved:
    """A field without a factor: the columns of its inertia and of its frame conditions, at unit compliance."""

    used: np.ndarray
    W: Array
    Y: Array
    factor: Any = field(default=None)
    in_use: Any = 0


def unsolved(part: Any) -> Unsolved:
    """What the tables ask for of a part with a field, before anything is solved."""
    conditions = np.arange(0 if part.shared_columns else part.n_frame_rows)
    count = part.inertia_columns.shape[1] + len(conditions)

    return Unsolved(conditions, np.eye(count), np.zeros((part.n, count)))


class FieldStates(DriverStates):
    """The driver of a system with fields, for states that Python asks for."""

    solves = False

    def __init__(self, system: System, library: Any) -> None:
        self._factored: dict[int | None, FactoredFieldStates] = {}  # complex ones by their places, None: real
        self._sliding = [part for _, part in system.fields if part.moves_ports]
        self._in_use = self._contacts
        super().__init__(system, library)

    @property
    def _contacts(self) -> list[Any]:
        """Which of the ports that move are in use."""
        return [part.in_use for part in self._sliding]

    def ask(self, function: Any, *given: float | None) -> bool:
        """As :meth:`DriverStates.ask`; contacts that have opened or closed since have other rows."""
        if self._sliding and self._in_use != self._contacts:
            self._in_use = self._contacts
            self.renew()
        return super().ask(function, *given)

    _of_steps: FactoredFieldStates | None = None

    def of_steps(self, blocks: Sequence[Block]) -> FactoredFieldStates:
        """As :meth:`factored`, apart from those that solve with other matrices between steps."""
        made = self._of_steps
        if made is None:
            self._of_steps = made = FactoredFieldStates(self, blocks)
        elif made.blocks is not blocks:
            made.take(blocks)
        return made

    def factored(self, blocks: Sequence[Block], place: int = 0) -> FactoredFieldStates:
        """The same system with factors of its fields, real ones or complex ones of a place; the last one that was asked for goes
        on with these.
        """
        key = place if max(map(parts_of, blocks)) > 1 else None
        made = self._factored.get(key)
        if made is None:
            self._factored[key] = made = FactoredFieldStates(self, blocks)
        elif made.blocks is not blocks or made.tangents != self.newest_tangents:
            made.take(blocks)  # masses have no tangents, but turn with the body since the newest ones
        return made

    @property
    def newest_tangents(self) -> list[int]:
        """Numbers of the tangents of the fields."""
        return [part.tangent_version for _, part in self.system.fields]

    def factored_by(self, blocks: Sequence[Block]) -> bool:
        """Whether the tables have these factors now."""
        return any(made.blocks is blocks for made in self._factored.values())

    def tables_of(self) -> Tables:
        """Tables with fields that nothing is solved for."""
        return Tables(self.system, redundant=0, blocks=[unsolved(part) for _, part in self.system.fields])

    def rows(self, at: Configurations) -> Array | None:
        """None: G of a field is kept by its ports."""
        return None


class FactoredFieldStates(FieldStates):
    """The same with the factors of a size of step, ``blocks`` of the fields, for solutions."""

    solves = True

    def __init__(self, states: FieldStates, blocks: Sequence[Block]) -> None:
        self.blocks = blocks
        super().__init__(states.system, states.library)
        self.tangents = self.newest_tangents  # in the tables

    def sway(self, corrected: bool) -> None:
        """Whether solutions correct moments on frames that columns of inertia leave out."""
        for one in self.tables.fields:
            one.sway(corrected)

    def take(self, blocks: Sequence[Block]) -> None:
        """Go on with the factors of another size of step."""
        self.blocks, self.tangents = blocks, self.newest_tangents
        if self.tables.take(blocks):
            self.factor.held = None
        else:
            self.renew()

    def tables_of(self) -> Tables:
        """Tables with these factors."""
        return Tables(self.system, redundant=self.dependent, blocks=self.blocks)
