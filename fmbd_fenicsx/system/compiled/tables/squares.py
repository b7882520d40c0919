"""Places of the symmetric blocks that items with frames on surfaces have on the rates of their bodies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .layout import TableLayout


def rates_of(tables: TableLayout, frames: np.ndarray) -> list[np.ndarray]:
    """The rates that move each item of frames (n, k), frame by frame: those of a body with two of them stand twice."""
    return [np.concatenate([tables.rates(int(f)) for f in each]) for each in frames]


def square_places(tables: TableLayout, store: Any, rates: list[np.ndarray], needed: bool = True) -> dict[str, int]:
    """Fields of a structure Batch: the rates of its items, the places of the lower halves of blocks on them where these are
    ``needed``, and where those of an item begin.
    """
    counts = np.array([len(x) for x in rates])
    starts = [np.concatenate(([0], np.cumsum(x))).astype(np.int64) for x in (counts, counts * (counts + 1) // 2)]
    squares = [np.zeros(0, int)]
    for x in rates if needed else ():
        c, r = np.tril_indices(len(x))
        squares.append(tables.fronts.place(x[c], x[r]))
    return {
        "row_start": store.array(starts[0], np.int64)[1],
        "row_on": store.integers(np.concatenate(rates)),
        "square_start": store.array(starts[1], np.int64)[1],
        "square_to": store.integers(np.concatenate(squares)),
    }
