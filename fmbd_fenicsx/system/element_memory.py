"""What force elements and controllers remember from step to step: changed by accepted steps only.

Friction keeps where it sticks, a controller its own memory, a viscoelastic rod the strains of its dashpots. An evaluation reads
the memory and never changes it, so a step that is rejected has nothing to undo.
"""

from __future__ import annotations

from dataclasses import is_dataclass
from typing import Any

import numpy as np

from ..rotations import Array
from .control.memory_points import PointRule
from .layout import State
from .system import System


def memories(system: System) -> list[Any]:
    """The memory of each batch of elements that has one."""
    return [f.kept for f in system.keepers]


def memory_types(system: System) -> set[type]:
    """The dataclasses among the memories."""
    return {type(f.kept) for f in system.keepers if is_dataclass(f.kept)}


def restore(system: System, kept: list[Any]) -> None:
    """Take the memories back to earlier ones of :func:`memories`."""
    for loads, value in zip(system.keepers, kept, strict=True):
        loads.kept = value


def reset(system: System, state: State) -> None:
    """The memories that a run starts with in ``state``; collective."""
    keepers = system.keepers
    if keepers:
        ev = system.at(state.t, state.q, state.v)
        known = system.remembered or (None,) * len(keepers)
        restore(system, [loads.first(ev, state) if x is None else x for loads, x in zip(keepers, known, strict=True)])


def next_sample(system: System) -> float:
    """When a controller samples next, s; infinite without one."""
    return float(min((loads.due for loads in system.forces), default=np.inf))


def whole_steps(system: System, t: float, h: float) -> float:
    """How many steps of size h (s) from t end before the next sample of a controller; infinite without one."""
    due = next_sample(system)
    return float(np.floor((due - t) / h - 1e-6)) if np.isfinite(due) else np.inf


def overran(system: System, state: State, h: float, rtol: float) -> bool:
    """Whether a step of h (s) to ``state``, chosen by its error with this tolerance, was too long for an element with a memory;
    collective.
    """
    ev = system.at(state.t, state.q, state.v)
    return any(loads.overran(ev, h, rtol) for loads in system.forces)


def accept(system: System, state: State) -> bool:
    """Note a step that was accepted and ended in ``state``; whether forces have jumped with it. Collective."""
    keepers = system.keepers
    if not keepers:
        return False
    ev = system.at(state.t, state.q, state.v)
    kept = [loads.accepted(ev, state) for loads in keepers]
    jumped = any(loads.jumps(value) for loads, value in zip(keepers, kept, strict=True))
    restore(system, kept)
    return jumped


def sample(system: System, state: State) -> None:
    """Controllers that are due sample in a state, that of the memories of all other elements; collective."""
    due = [loads for loads in system.forces if loads.due <= state.t]
    ev = system.at(state.t, state.q, state.v)
    for loads, kept in zip(due, [loads.accepted(ev, state) for loads in due], strict=True):
        loads.kept = kept


def drag(system: System, state: State) -> None:
    """What is moved by ends of steps is moved by the end of a part, before an impact, too; collective."""
    dragged = [loads for loads in system.keepers if loads.by_ends]
    if dragged:
        ev = system.at(state.t, state.q, state.v)
        for loads in dragged:
            loads.kept = loads.accepted(ev, state)


def collocated(system: System) -> list[Any]:
    """The elements whose memory is found at the points of an implicit step together."""
    return [loads for loads in system.forces if loads.collocates]


def collocate(system: System, rule: PointRule, q: Array, v: Array) -> None:
    """Find the memories at the points of an implicit step, q (k, n_q) and v (k, n_v); collective."""
    finding = collocated(system)
    if finding:
        kins = [system.at(float(t), q[i], v[i]).kin for i, t in enumerate(rule.t)]
        for loads in finding:
            loads.collocate(rule, kins)


def divide(system: System, times: Array) -> None:
    """Take the last step for several, which began at these times (s), the newest first."""
    for loads in collocated(system):
        loads.divide(times)


def lead_memories(system: System, share: float) -> None:
    """Where a tangent of the step is taken memories answer to their rates by so much (s)."""
    for loads in collocated(system):
        loads.lead(share)
