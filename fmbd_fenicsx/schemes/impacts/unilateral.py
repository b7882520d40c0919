"""Unilateral sliding contact on top of any scheme: loss of contact and return.

A step is taken with each contact closed (g = 0) or open (lambda = 0). A closed contact that would pull is opened and the step
repeated. An open contact whose gap has closed at the end of a step meets plastically: positions and velocities are projected in
the mass metric, accelerations and multipliers computed anew; if the new multiplier pulls, the contact stays open.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...errors import require
from ...linear.condensation import StepSolver
from ...mechanics.catenary.sliding import HeadSide, WireSide
from ...system.layout import State
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ..consistent import accelerations, project
from ..declared import Declared, checked_scheme
from ..newton import Newton
from ..onestep.alpha.generalized_alpha import GeneralizedAlpha
from ..stepping import TimeStepper, made_stepper


@dataclass(frozen=True)
class Unilateral:
    """``scheme`` with sliding contacts that may open and close; contacts without an idle coordinate stay closed."""

    scheme: Any = GeneralizedAlpha(0.6)

    def __post_init__(self) -> None:
        checked_scheme(self.scheme, "Unilateral: scheme")

    @property
    def name(self) -> str:
        """For reports."""
        return f"unilateral {self.scheme.name}"

    @property
    def order(self) -> int:
        """Of the scheme between changes of contact."""
        return int(self.scheme.order)

    @property
    def turn_limit(self) -> float | None:
        """Of the scheme between changes of contact."""
        return Declared.by(self.scheme).turn_limit

    def stepper(self, system: System, solver: StepSolver, newton: Newton, state: State) -> Switching:
        """A run's worker, from a consistent state with closed contacts."""
        return Switching(self, system, solver, newton, state)


class Switching(TimeStepper):
    """Advances the inner stepper and changes the contacts' status where their conditions are violated."""

    keeps: ClassVar = {"opened": plain(), "returned": plain(), "inner": worker}

    def __init__(self, outer: Unilateral, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.outer, self.system, self.solver, self.newton = outer, system, solver, newton
        laws: list[Any] = [law for law, _ in system.port_constraints]
        wires = {law.status.rows.start: law for law in laws if isinstance(law, WireSide)}
        heads = [law for law in laws if isinstance(law, HeadSide) and law.idle is not None]
        self.pairs: list[tuple[Any, Any]] = [(wires[head.status.rows.start], head) for head in heads]
        require(not Declared.by(outer.scheme).adaptive, "Unilateral contact needs a constant step.")
        self.inner = made_stepper(outer.scheme, system, solver, newton, state)
        self.opened = self.returned = 0

    @property
    def state(self) -> State:  # type: ignore[override]
        """The last state."""
        return self.inner.state

    @state.setter
    def state(self, state: State) -> None:
        self.inner.state = state

    @property
    def local_error(self) -> float:  # type: ignore[override]
        """Of the inner scheme."""
        return self.inner.local_error

    @property
    def counters(self) -> dict[str, float]:
        """How often contact was lost and found again."""
        return {**self.inner.counters, "contact lost": self.opened, "contact found": self.returned}

    def remember(self, m: Memory) -> None:
        """With the contacts that are closed."""
        closed = m("closed", [wire.status.closed for wire, _ in self.pairs])
        for (wire, _), now in zip(self.pairs, closed, strict=True):
            wire.status.closed = now
        super().remember(m)

    def gap(self, state: State, pair: tuple[Any, Any]) -> float:
        """y - w, m: negative where the contact is open."""
        wire, head = pair
        s = self.system
        port = s.at(state.t, state.q).port
        w = port[s.port_slice(wire.part)][4 * wire.slot]
        return float(port[s.port_slice(head.part)][head.coordinate] - w)

    def advance(self, h: float) -> State:
        """One step; collective."""
        before = copy.copy(self.inner)
        state = self.inner.advance(h)
        pulling = [p for p in self.pairs if p[0].status.closed and state.lam[p[0].status.rows.start] < 0]
        if pulling:
            for wire, _ in pulling:
                wire.status.closed = False
                self.opened += 1
            self.inner = before
            state = self.inner.advance(h)
        met = [p for p in self.pairs if not p[0].status.closed and p not in pulling and self.gap(state, p) >= 0]
        return self._close(state, met) if met else state

    def _close(self, state: State, met: list[tuple[Any, Any]]) -> State:
        """Close contacts at the end of a step, unless they would pull at once."""
        for wire, _ in met:
            wire.status.closed = True
        closed = accelerations(self.system, project(self.system, state, self.solver), self.solver)
        rows = [wire.status.rows.start for wire, _ in met]
        if np.any(closed.lam[rows] < 0):
            for wire, _ in met:
                wire.status.closed = False
            return state
        self.returned += len(met)
        self.inner = made_stepper(self.outer.scheme, self.system, self.solver, self.newton, closed)
        return closed
