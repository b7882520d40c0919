"""What the steppers of all schemes with contact hold."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar

from ...linear.complementarity.delassus import Compliance
from ...linear.condensation import StepSolver
from ...mechanics.contact.contact_set import ContactSet
from ...system.layout import State
from ...system.sensors.contact import ContactState
from ...system.serialisation import Memory, plain, worker
from ...system.system import System
from ..newton import Newton
from ..stepping import TimeStepper
from .compiled.problem import CompiledProblem, compiled_problem
from .contact_ledger import ContactLedger


class ContactStepper(TimeStepper):
    """Contact rows, their compliance, the books of contact, and the present state."""

    keeps: ClassVar = {"state": Memory.state, "local_error": plain(), "ledger": worker, "compliance": worker}
    state: ContactState

    def __init__(self, system: System, solver: StepSolver, newton: Newton, state: State) -> None:
        self.system, self.solver, self.newton = system, solver, newton
        self.contacts: ContactSet = system.contacts
        self.compliance = Compliance(solver, self.contacts)
        self.ledger = ContactLedger(system)
        self.local_error = 0.0
        self.state = self.ledger.open(state)

    @cached_property
    def problem(self) -> CompiledProblem | None:
        """Who finds contact forces in compiled code; looked for at the first step, since starts are NumPy's."""
        return compiled_problem(self.system, self.ledger.components)

    @property
    def counters(self) -> dict[str, float]:
        """Statistics of contact for the run's counters."""
        return self.ledger.counters(self.compliance.columns, self.compliance.blocks.products)
