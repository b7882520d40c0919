"""Bushings in the driver's tables: batches whose items have all components of a displacement and a rotation at once."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.forces.force_elements import Loads
from ...declarations import enumeration
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout

MOUNT = enumeration("ROW")["MOUNT"]  # the role


def squares(tables: TableLayout, frames: np.ndarray) -> tuple[int, int]:
    """Addresses of where the places of each pair of frames (n, 2) begin, and of places of the lower halves of their blocks."""
    rates = [np.concatenate([tables.rates(int(f)) for f in pair]) for pair in frames]
    counts = np.array([len(x) * (len(x) + 1) // 2 for x in rates])
    found = []
    for x in rates:
        c, r = np.tril_indices(len(x))
        found.append(tables.fronts.place(x[c], x[r]))
    first = np.concatenate(([0], np.cumsum(counts)))
    return tables.store.array(first, np.int64)[1], tables.store.integers(np.concatenate(found))


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

    square_start, square_to = squares(tables, frames)
    return structure("Batch", tables.dim)(
        role=MOUNT, n=n, width=constants.shape[1], mapped=1, P=store.address(constants), pair=store.integers(frames),
        at=store.integers(tables.twist_places(frames).reshape(n, -1)),
        known=store.address(np.zeros(n * (2 * size + d * d + rot * rot + 3 * d + rot))),
        square_start=square_start, square_to=square_to,
    )  # fmt: skip
