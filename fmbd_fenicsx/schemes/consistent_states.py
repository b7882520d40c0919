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
    apart = _by_metrics(system, states, metrics, lambda some, own: all_corrected(system, some, solver, own))
    if apart is not None:
        return apart
    driver = solver.driver
    found = None if driver is None else driver.all_corrected(states, metrics)
    if found is not None:
        return replace(states, a=found[0], lam=found[1])
    return States.of([corrected(system, s, solver, metric) for s, metric in zip(states.each(), metrics, strict=True)])


def projected(system: System, states: States, solver: StepSolver, metrics: Sequence[Weights]) -> States:
    """States with q, then v, moved on the constraints, each in a metric of its own; a and lambda kept; collective."""
    apart = _by_metrics(system, states, metrics, lambda some, own: projected(system, some, solver, own))
    if apart is not None:
        return apart
    driver = solver.driver
    found = None if driver is None else driver.all_closed(states, metrics)
    if found is not None:
        return replace(states, q=found[0], v=found[1])
    return States.of([project(system, s, solver, metric) for s, metric in zip(states.each(), metrics, strict=True)])


def _by_metrics(
    system: System, states: States, metrics: Sequence[Weights], made: Callable[[States, list[Weights]], States]
) -> States | None:
    """What is ``made`` of states, of one metric after the other, as factors of fields are those of one; None without fields, and
    where all states have the same metric.
    """
    different = dict.fromkeys(metrics)
    if not system.fields or len(different) < 2:
        return None
    every = replace(states, q=states.q.copy(), v=states.v.copy(), a=states.a.copy(), lam=states.lam.copy())
    for metric in different:
        which = np.array([x == metric for x in metrics])
        every.put(which, made(states.chosen(which), [metric] * int(which.sum())))
    return every


def metrics_of(h: np.ndarray, metric: Callable[[float], Weights]) -> list[Weights]:
    """Those of steps of sizes h (k,), s."""
    sizes, which = np.unique(h, return_inverse=True)
    known = [metric(float(size)) for size in sizes]
    return [known[i] for i in which]
