"""What the steppers of all schemes with contact hold."""

from __future__ import annotations

from ...linear.complementarity.delassus import Compliance
from ...linear.condensation import StepSolver
from ...linear.redundancy import least
from ...mechanics.contact.rows import ContactSet
from ...rotations import Array
from ...system.sensors.contact import ContactState
from ...system.serialisation import Memory
from ...system.system import State, System
from ..newton import Newton
from .contact_ledger import Ledger


class ContactStepper:
    """Contact rows, their compliance, the books of contact, and the present state."""

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton = system, solver, newton
        self.contacts: ContactSet = system.contacts
        self.compliance = Compliance(solver, self.contacts)
        self.ledger = Ledger(system)
        self.local_error = 0.0
        self.state: ContactState = self.ledger.open(state)

    def _reactions(self, t: float, q: Array, lam: Array) -> Array:
        """Multipliers of a configuration; of those with the same forces the smallest."""
        if not self.solver.core.redundant:
            return lam
        return least(self.solver, self.system.at(t, q), lam)

    def remember(self, m: Memory) -> None:
        """State with contact forces, and the books."""
        self.state, self.local_error = m.state("state", self.state), m("local error", self.local_error)
        self.ledger.remember(m.inside("ledger"))
        self.compliance.remember(m.inside("compliance"))

    @property
    def counters(self) -> dict[str, float]:
        """Statistics of contact for the run's counters."""
        return self.ledger.counters(self.compliance.columns, self.compliance.blocks.products)
