"""Revolutions that angles count: a step that is repeated must not count those of iterates that failed.

Joints, laws and sensors that follow an angle beyond a full turn keep the angle (rad) they saw last.
"""

from __future__ import annotations

import numpy as np

from ..mechanics.joints.relative import Turn
from ..rotations import Array
from .system import System


def turning(system: System) -> tuple[Turn, ...]:
    """The angles of joints that constraints and forces use."""
    if "turning" not in system.cache:
        used = [r for batch, _ in system.batches for r, _, _ in getattr(batch, "terms", ())]
        used += [getattr(f, "relative", None) for f in system.forces]
        system.cache["turning"] = tuple(r for r in used if isinstance(r, Turn))
    return system.cache["turning"]  # type: ignore[no-any-return]


def followed(system: System) -> tuple[Turn, ...]:
    """The same, then those of sensors that have been read."""
    return (*turning(system), *(x for x in system.cache.values() if isinstance(x, Turn)))


def turns(system: System, *, sensors: bool = False) -> list[Array]:
    """The angles (rad) as counted last, of constraints and forces, with ``sensors`` of these too."""
    return [r.last for r in (followed(system) if sensors else turning(system))]


def count_from(system: System, angles: list[Array]) -> None:
    """Count from earlier :func:`turns`, with or without sensors."""
    which = turning(system)
    if len(angles) != len(which):
        which = followed(system)
    for r, last in zip(which, angles, strict=True):
        r.last = last


def rewind(system: System) -> None:
    """Count anew: a motion starts from the initial configuration once more."""
    count_from(system, [np.zeros_like(r.last) for r in followed(system)])
