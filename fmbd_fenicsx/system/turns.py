"""Revolutions that the angles of joints count: a step that is repeated must not count those of iterates that failed."""

from __future__ import annotations

from ..rotations import Array
from .system import System


def turns(system: System) -> list[Array]:
    """The angles that constraints and forces use, as counted last (rad)."""
    return [r.last for r in system.turning]


def count_from(system: System, angles: list[Array]) -> None:
    """Count from earlier :func:`turns`."""
    for r, last in zip(system.turning, angles, strict=True):
        r.last = last
