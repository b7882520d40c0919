"""Many states made consistent, as :mod:`.consistent` makes one: in compiled code one behind the other, without Python between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..linear.blocks.field_blocks import Weights
from ..linear.condensation import StepSolver
from ..system.layout import State, States
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

    def together(some: States, own: Sequence[Weights]) -> States | None:
        found = None if solver.driver is None else solver.driver.all_corrected(some, own)
        return None if found is None else replace(some, a=found[0], lam=found[1])

    return _by_metrics(system, states, metrics, together, lambda s, metric: corrected(system, s, solver, metric))


def projected(system: System, states: States, solver: StepSolver, metrics: Sequence[Weights]) -> States:
    """States with q, then v, moved on the constraints, each in a metric of its own; a and lambda kept; collective."""

    def together(some: States, own: Sequence[Weights]) -> States | None:
        found = None if solver.driver is None else solver.driver.all_closed(some, own)
        return None if found is None else replace(some, q=found[0], v=found[1])

    return _by_metrics(system, states, metrics, together, lambda s, metric: project(system, s, solver, metric))


def _by_metrics(
    system: System,
    states: States,
    metrics: Sequence[Weights],
    together: Callable[[States, Sequence[Weights]], States | None],
    alone: Callable[[State, Weights], State],
) -> States:
    """What is made of states ``together`` where that can be, else of each ``alone``; with fields of one metric after the other,
    as their factors are those of one.
    """
    different = dict.fromkeys(metrics)
    if not system.fields or len(different) < 2:
        made = together(states, metrics)
        return States.of(list(map(alone, states.each(), metrics))) if made is None else made

    every = replace(states, q=states.q.copy(), v=states.v.copy(), a=states.a.copy(), lam=states.lam.copy())
    for metric in different:
        which = np.array([x == metric for x in metrics])
        of_one = [metric] * int(which.sum())
        every.put(which, _by_metrics(system, states.chosen(which), of_one, together, alone))
    return every


def metrics_of(h: np.ndarray, metric: Callable[[float], Weights]) -> list[Weights]:
    """Those of steps of sizes h (k,), s."""
    sizes, which = np.unique(h, return_inverse=True)
    known = [metric(float(size)) for size in sizes]
    return [known[i] for i in which]
