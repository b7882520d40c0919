"""What the steppers of all schemes with contact hold."""

from __future__ import annotations

from ..linear.delassus import Compliance
from ..linear.schur import StepSolver
from ..mechanics.contact_rows import ContactSet
from ..system.sensors_contact import ContactState
from ..system.system import State, System
from .contact_ledger import Ledger
from .newton import Newton


class ContactStepper:
    """Contact rows, their compliance, the books of contact, and the present state."""

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton = system, solver, newton
        self.contacts: ContactSet = system.contacts
        self.compliance = Compliance(solver, self.contacts)
        self.ledger = Ledger(system)
        self.local_error = 0.0
        self.state: ContactState = self.ledger.open(state)

    @property
    def counters(self) -> dict[str, float]:
        """Statistics of contact for the run's counters."""
        return self.ledger.counters(self.compliance.columns, self.compliance.blocks.products)
