"""How far a march has come, and everything that its next step depends on."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass, field
from typing import Any

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...schemes.newton import Newton
from ...schemes.stepping import TimeStepper
from ...system.layout import State
from ...system.serialisation import Memory, worker
from ...system.system import System
from ..judges.force_balance import Balanced
from ..recording.recorder import Recorder


def remember_solver(solver: StepSolver, m: Memory, state: State) -> None:
    """Elastic factors, made again for ``state`` by the same method, the pressures that bodies carry, and counts; collective.

    Tangents must have been taken up before: a carried pressure belongs to the factor that was made with it.
    """
    system, elastic = solver.system, solver.elastic
    weights, stepping = m("weights", solver.weights, Weights), m("stepping", elastic.stepping, Weights)

    for k, part in system.fields:
        part.field.indefinite = m(f"indefinite {k}", part.field.indefinite)
    if m.reading and system.fields:
        ev = system.at(state.t, state.q, state.v)
        ev.forces = state.a, state.lam
        solver.prepare(ev, weights)
        if stepping is not None:
            elastic.beside(ev.jacobian, stepping)
    for k, part in system.fields:
        field = part.field
        if field.carried:
            x = m.nodal(f"pressure {k}", field.pressure_values, field.pressure_numbering)  # type: ignore[attr-defined]
            field.pressure_values = x  # type: ignore[attr-defined]

    counts = (elastic.factorisations, solver.core.factorisations, elastic.back_solves, solver.worst_residual)
    elastic.factorisations, solver.core.factorisations, solves, worst = m("counts", counts)
    elastic.other_solves += solves - elastic.back_solves
    solver.core.judge.worst = max(solver.core.judge.worst, worst)


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
        from ...system.element_memory import memories, memory_types, restore

        restore(self.system, m("elements", memories(self.system), *memory_types(self.system)))
        for k, part in enumerate(self.system.parts):
            part.remember(m.inside(f"part {k}"))
        self.stepper.remember(m.inside("stepper"))
        remember_solver(self.solver, m.inside("solver"), self.stepper.state)
        n = self.newton
        n.iterations, n.theta, n.renewals = m("Newton", (n.iterations, n.theta, n.renewals))
        worker(m, "tangents", n.account)
        worker(m, "balanced", self.balanced)
        worker(m, "closed", self.recorder.drift.closed)
