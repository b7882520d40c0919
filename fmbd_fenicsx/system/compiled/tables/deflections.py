"""Deformations in the norms of errors, as C reads them (``Deflection`` of driver/tables.h)."""

from __future__ import annotations

from typing import Any

from ...system import System
from .structures import Store, array_of, structure


def deflections_of(system: System, deforming: list[tuple[int, Any]], store: Store) -> Any:
    """The parts of these numbers, with the places of their coordinates."""
    one = structure("Deflection", system.motions.dim)
    return array_of(one, len(deforming))(
        *(
            one(
                at_q=system.slices[0][k].start,
                at_v=system.slices[1][k].start,
                n=part.n,
                rms=None if part.rms is None else store.address(part.rms),
            )
            for k, part in deforming
        )
    )
