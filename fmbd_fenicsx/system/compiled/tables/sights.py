"""Where C finds what records tell of markers, joints and force elements."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from .structures import structure

if TYPE_CHECKING:
    from .layout import TableLayout


def seen_places(tables: TableLayout) -> int:
    """The address of places (d) of the markers that sensors look at in their frames, and of how they are turned (d x d)."""
    mk, seen = tables.system.markers, tables.looks.markers
    place = np.where((tables.frame[seen] > tables.nb)[:, None], 0.0, mk.position[seen])
    return tables.store.address(np.concatenate((place, mk.rotation[seen].reshape(len(seen), tables.dim**2)), axis=1))


def reaction_of(tables: TableLayout, name: str, side: int) -> Any:
    """One structure Reaction: the items of a joint's rows on the side of its first body, or of an element on a side."""
    marker, found = _of_joint(tables, name) if side < 0 else _of_element(tables, tables.looks.slots[name].start, side)
    batch, item, sides = np.array(found, dtype=int).reshape(-1, 3).T
    frame = int(tables.frame[marker])
    place = np.zeros(tables.dim) if frame > tables.nb else tables.system.markers.position[marker]
    integers = tables.store.integers
    return structure("Reaction", tables.dim)(
        items=len(found), frame=frame, p=(ctypes.c_double * tables.dim)(*place),
        batch=integers(batch), item=integers(item), side=integers(sides),
    )  # fmt: skip


def _of_joint(tables: TableLayout, joint: str) -> tuple[int, list[tuple[int, int, int]]]:
    """The marker of a joint on its first body; number of the batch, of the item, and side of the items that act there."""
    block = tables.system.block(joint)
    found = []
    for number, items in enumerate(tables.sources):
        if items.row is not None:
            inside = (items.row >= block.rows.start) & (items.row < block.rows.stop)
            mine = np.argwhere(inside[:, None] & (items.markers == block.a))
            found += [(number, int(i), int(side)) for i, side in mine]
    return block.a, found


def _of_element(tables: TableLayout, slot: int, side: int) -> tuple[int, list[tuple[int, int, int]]]:
    """The same of an element that is read, on one of its sides."""
    for number, items in enumerate(tables.sources):
        if items.slot is not None and slot in items.slot:
            i = int(np.flatnonzero(items.slot == slot)[0])
            return int(items.markers[i, side]), [(number, i, side)]
    raise AssertionError(slot)
