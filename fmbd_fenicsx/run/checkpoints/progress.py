"""How far a march has come, and everything that its next step depends on."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ...linear.condensation import StepSolver
from ...schemes.newton import Newton
from ...schemes.stepping import TimeStepper
from ...system.serialisation import worker
from ...system.system import System
from ..judges.force_balance import Balanced
from ..recording.recorder import Recorder

if TYPE_CHECKING:
    from ...system.serialisation import Memory


@dataclass
class RunProgress:
    """The workers of a march, the judge of its balance, steps ``done``, largest ``local_error``, back-solves of the ``first``
    step, and the seconds that processes before a restart took.
    """

    system: System
    solver: StepSolver
    newton: Newton
    stepper: TimeStepper
    recorder: Recorder
    balanced: Balanced | None = None
    done: int = 0
    local_error: float = 0.0
    first: int = 0
    earlier: float = 0.0
    begun: float = field(default_factory=clock.perf_counter)

    def remember(self, m: Memory, where: Any = "") -> None:
        """Write all of it, or read it from the checkpoint ``where``; see :mod:`fmbd_fenicsx.system.serialisation`. Collective."""
        from .fingerprint import check_effect

        self.remember_steps(m)
        self.recorder.remember(m.inside("recorder"))
        self.done, self.local_error, self.first = m("course", (self.done, self.local_error, self.first))
        now = clock.perf_counter()
        spent = m("seconds", self.earlier + now - self.begun)
        if m.reading:
            self.earlier, self.begun = spent, now
        check_effect(self.system, self.stepper.state, m.inside("effect"), where)

    def remember_steps(self, m: Memory) -> None:
        """The same of what the next steps are made by, and judged."""
        from ...linear.blocks.solver_memory import remember_solver
        from ...system.element_memory import memories, memory_types, restore

        restore(self.system, m("elements", memories(self.system), *memory_types(self.system)))
        for k, part in enumerate(self.system.parts):
            part.remember(m.inside(f"part {k}"))
        self.stepper.remember(m.inside("stepper"))
        remember_solver(self.solver, m.inside("solver"), self.stepper.state)
        n = self.newton
        n.iterations, n.theta, n.renewals = m("Newton", (n.iterations, n.theta, n.renewals))
        worker(m, "balanced", self.balanced)
        worker(m, "closed", self.recorder.drift.closed)
