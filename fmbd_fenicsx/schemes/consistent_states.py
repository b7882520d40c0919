"""Many states made consistent, as :mod:`.consistent` makes one: in compiled code one behind the other, without Python between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..linear.blocks.field_blocks import Weights
from ..linear.condensation import StepSolver
from ..system.layout import States
from ..system.system import System
from .consistent import accelerations, corrected, project


def accelerated(system: System, states: States, solver: StepSolver) -> States:
    """Consistent (q, v) with their accelerations and multipliers; collective."""
    driver, s = solver.driver, states.state(0)
    compiled = None if driver is None else driver.one_call(s.t, s.q, s.v)
    found = None if compiled is None else compiled.all_accelerations(states)
    if found is not None:
        return replace(states, a=found[0], lam=found[1])
    return States.of([accelerations(system, s, solver) for s in states.each()])


def all_corrected(system: System, states: States, solver: StepSolver, metrics: Sequence[Weights]) -> States:
    """States with a and lambda as :func:`.consistent.corrected` has them, each in a metric of its own; collective."""
    driver = solver.driver
    found = None if driver is None else driver.all_corrected(states, metrics)
    if found is not None:
        return replace(states, a=found[0], lam=found[1])
    return States.of([corrected(system, s, solver, metric) for s, metric in zip(states.each(), metrics, strict=True)])


def projected(system: System, states: States, solver: StepSolver, metrics: Sequence[Weights]) -> States:
    """States with q, then v, moved on the constraints, each in a metric of its own; a and lambda kept; collective."""
    different = dict.fromkeys(metrics)
    if system.fields and len(different) > 1:  # their factors are those of one metric
        every = replace(states, q=states.q.copy(), v=states.v.copy())
        for metric in different:
            which = np.array([x == metric for x in metrics])
            every.put(which, projected(system, states.chosen(which), solver, [metric] * int(which.sum())))
        return every

    driver = solver.driver
    found = None if driver is None else driver.all_closed(states, metrics)
    if found is not None:
        return replace(states, q=found[0], v=found[1])
    return States.of([project(system, s, solver, metric) for s, metric in zip(states.each(), metrics, strict=True)])


def metrics_of(h: np.ndarray, metric: Callable[[float], Weights]) -> list[Weights]:
    """Those of steps of sizes h (k,), s."""
    sizes, which = np.unique(h, return_inverse=True)
    known = [metric(float(size)) for size in sizes]
    return [known[i] for i in which]
