"""Bushings in the driver's tables: batches whose items have all components of a displacement and a rotation at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.forces.force_elements import Loads
from ...declarations import enumeration
from ..squares import rates_of, square_places
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout

MOUNT = enumeration("ROW")["MOUNT"]  # the role


def mount_batch(tables: TableLayout, loads: Loads) -> Any:
    """One structure Batch of role MOUNT for bushings; its constants are places, turns, K and C, as mounts.c reads them."""
    mk = tables.system.markers
    store = tables.store
    matrices = loads.mounts()
    assert matrices is not None
    markers = np.stack((loads.a, loads.b), axis=1)
    frames = tables.frame[markers]
    n = len(markers)
    size = tables.twist
    d, rot = tables.dim, size - tables.dim
    places = np.where((frames > tables.nb)[..., None], 0.0, mk.position[markers])
    turns = mk.rotation[markers].reshape(n, 2, -1)
    sides = [x[:, side] for side in (0, 1) for x in (places, turns)]
    constants = np.concatenate([*sides, *(x.reshape(n, -1) for x in matrices)], axis=1)

    return structure("Batch", tables.dim)(
        role=MOUNT, n=n, width=constants.shape[1], mapped=1, P=store.address(constants), pair=store.integers(frames),
        at=store.integers(tables.twist_places(frames).reshape(n, -1)),
        known=store.address(np.zeros(n * (2 * size + d * d + rot * rot + 3 * d + rot))),
        **square_places(tables, store, rates_of(tables, frames)),
    )  # fmt: skip
