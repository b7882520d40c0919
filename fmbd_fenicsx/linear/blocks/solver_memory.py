"""What the solver of a run in progress remembers (:mod:`fmbd_fenicsx.system.serialisation`)."""

from __future__ import annotations

from ...system.layout import State
from ...system.serialisation import Memory
from ..condensation import StepSolver
from .field_blocks import Weights


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
    elastic.retired_solves.append(solves - elastic.back_solves)
    solver.core.judge.worst = max(solver.core.judge.worst, worst)
