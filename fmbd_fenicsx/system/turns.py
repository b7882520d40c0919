"""Revolutions that the angles of joints count: a step that is repeated must not count those of iterates that failed."""

from __future__ import annotations

from ..mechanics.relative import Turn
from ..rotations import Array
from .system import System


def turning(system: System) -> tuple[Turn, ...]:
    """The angles of joints that constraints and forces use."""
    if "turning" not in system.cache:
        used = [r for batch, _ in system.batches for r, _, _ in getattr(batch, "terms", ())]
        used += [getattr(f, "relative", None) for f in system.forces]
        system.cache["turning"] = tuple(r for r in used if isinstance(r, Turn))
    return system.cache["turning"]  # type: ignore[no-any-return]


def turns(system: System) -> list[Array]:
    """The angles that constraints and forces use, as counted last (rad)."""
    return [r.last for r in turning(system)]


def count_from(system: System, angles: list[Array]) -> None:
    """Count from earlier :func:`turns`."""
    for r, last in zip(turning(system), angles, strict=True):
        r.last = last
