"""Bushings in the driver's tables: batches whose items have all components of a displacement and a rotation at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.forces.force_elements import Loads
from .structures import structure

if TYPE_CHECKING:
    from .tables import Tables

MOUNT = 6  # the role, as in driver/tables.h


def mount_batch(tables: Tables, loads: Loads) -> Any:
    """One structure Batch of role MOUNT for bushings; its constants are places, turns, K and C, as mounts.c reads them."""
    mk, store, matrices = tables.system.markers, tables.store, loads.mounts()
    assert matrices is not None
    markers = np.stack((loads.a, loads.b), axis=1)
    frames, n = tables.frame[markers], len(markers)
    places = np.where((frames > tables.nb)[..., None], 0.0, mk.position[markers])
    turns = mk.rotation[markers].reshape(n, 2, -1)
    sides = [x[:, side] for side in (0, 1) for x in (places, turns)]
    constants = np.concatenate([*sides, *(x.reshape(n, -1) for x in matrices)], axis=1)

    rates = [np.concatenate([tables.rates(int(f)) for f in pair]) for pair in frames]
    counts = np.array([len(x) * (len(x) + 1) // 2 for x in rates])
    squares = []
    for x in rates:
        c, r = np.tril_indices(len(x))
        squares.append(tables.fronts.place(x[c], x[r]))
    return structure("Batch", tables.dim)(
        role=MOUNT, n=n, width=constants.shape[1], mapped=1, P=store.address(constants), pair=store.integers(frames),
        at=store.integers(tables.twist_places(frames).reshape(n, -1)),
        square_start=store.array(np.concatenate(([0], np.cumsum(counts))), np.int64)[1],
        square_to=store.integers(np.concatenate(squares)),
    )  # fmt: skip
