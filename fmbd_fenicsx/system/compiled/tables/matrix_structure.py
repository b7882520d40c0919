"""What the matrices of scenes have in common: the same bodies, joints and forces between them, in the same order.

Such scenes differ in their data only, and share one :class:`Structure`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..order import Fronts, RowGroup
from .structures import Store

STRUCTURES = 16  # that are kept


@dataclass(frozen=True)
class MatrixShape:
    """The structure of a scene's matrix: widths of the bodies' blocks, groups of rows, ``pairs`` of bodies that forces couple.

    ``apart``: the group of rows that holds the last unknowns of a body, as many, on which nothing else acts.
    """

    widths: tuple[int, ...]
    groups: tuple[RowGroup, ...]
    pairs: frozenset[tuple[int, int]]
    apart: Mapping[int, RowGroup] = field(default_factory=dict)

    @cached_property
    def largest(self) -> float:
        """A bound of the largest eigenvalue of G M^-1 G^T scaled to a diagonal of 1: the most rows on the bodies of a row."""
        on = Counter(body for group in self.groups for body in group.bodies for _ in group.rows)
        return float(max((sum(on[body] for body in group.bodies) for group in self.groups), default=1))


class Structure:
    """The fronts of one shape, and the places that were found in them."""

    def __init__(self, shape: MatrixShape) -> None:
        ends = np.cumsum(shape.widths, dtype=int)
        count = int(ends[-1]) if len(ends) else 0
        unknowns = [np.arange(end - width, end) for end, width in zip(ends, shape.widths, strict=True)]
        apart = []
        for body, group in shape.apart.items():
            unknowns[body], held = np.split(unknowns[body], [-len(group.rows)])
            apart.append(np.append(held, count + np.array(group.rows)))
        taken = {group.rows for group in shape.apart.values()}
        groups = [group for group in shape.groups if group.rows not in taken]
        unknowns += [count + np.array(group.rows) for group in groups]
        self.shape = shape
        self.fronts = Fronts(unknowns, groups, set(shape.pairs), apart)
        self.store = Store()
        self._found: dict[Any, Any] = {}

    def once(self, key: Any, find: Callable[[], Any]) -> Any:
        """What ``find`` returns, found once for a key."""
        if key not in self._found:
            self._found[key] = find()
        return self._found[key]


structures_kept: dict[tuple[Any, ...], Structure] = {}  # the newest, by what acts between which frames


def structure_of(connections: tuple[Any, ...], shape: Callable[[], MatrixShape]) -> Structure:
    """The structure of scenes with these connections, made once, from their ``shape``."""
    found = structures_kept.pop(connections, None) or Structure(shape())
    structures_kept[connections] = found
    if len(structures_kept) > STRUCTURES:
        del structures_kept[next(iter(structures_kept))]
    return found
