"""What force elements and controllers remember from step to step: changed by accepted steps only.

Friction keeps where it sticks, a controller its own memory. An evaluation reads the memory and never changes it, so a step that
is rejected has nothing to undo.
"""

from __future__ import annotations

from typing import Any

from ..mechanics.forces.force_elements import Loads
from .system import State, System


def _keepers(system: System) -> list[Loads]:
    return [f for f in system.forces if f.kept is not None]


def memories(system: System) -> list[Any]:
    """The memory of each batch of elements that has one."""
    return [f.kept for f in _keepers(system)]


def restore(system: System, kept: list[Any]) -> None:
    """Take the memories back to earlier ones of :func:`memories`."""
    for loads, value in zip(_keepers(system), kept, strict=True):
        loads.kept = value


def reset(system: System, state: State) -> None:
    """The memories that a run starts with in ``state``; collective."""
    keepers = _keepers(system)
    if keepers:
        kin = system.at(state.t, state.q, state.v).kin
        restore(system, [loads.first(kin, state.t) for loads in keepers])


def accept(system: System, state: State) -> None:
    """Note a step that was accepted and ended in ``state``; collective."""
    keepers = _keepers(system)
    if keepers:
        kin = system.at(state.t, state.q, state.v).kin
        restore(system, [loads.accepted(kin, state.t) for loads in keepers])
