"""Stiff springs whose efforts are unknowns of an implicit step (:mod:`...tangents.stiff_ties`) among the items of the driver."""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from ....kernel_cache import address_of
from ...sparsity import Pattern
from ..declarations import TABLES, structure_of

if TYPE_CHECKING:
    from ...tangents.stiff_ties import StiffTies
    from ..tables.tables import Tables
    from .couplings import Couplings

Ties = structure_of(TABLES, "Ties")


class TiedItems:
    """Those of the tables; ``rows``: the pattern of R, (p, n_v); ``address``: of what C reads, None without ties."""

    def __init__(self, stiff: StiffTies, couplings: Couplings, tables: Tables) -> None:
        self._couplings = couplings
        found: list[tuple[int, int]] = []  # batch and item of each
        self._bodies: list[list[int]] = []
        for loads, which in stiff.springs:
            of_spring = {
                int(number): (batch, item)
                for batch, items in enumerate(tables.sources)
                if items.loads is loads and items.number is not None
                for item, number in enumerate(items.number)
            }
            found += [of_spring[int(i)] for i in which]
        for batch, item in found:
            both: Any = tables.body_of(tables.sources[batch].frames[item])
            self._bodies.append([b for b in dict.fromkeys(both.tolist()) if b >= 0])

        own = [np.concatenate([couplings.of_body[b] for b in bodies]) for bodies in self._bodies]
        none, lengths = np.zeros(0, int), [len(x) for x in own]
        self.rows = Pattern.of(
            (len(own), couplings.n), np.repeat(np.arange(len(own)), lengths), np.concatenate([none, *own])
        )
        self.address = self._tell(np.array(found, int).reshape(-1, 2), len(tables.batches))

    def _tell(self, found: np.ndarray, batches: int) -> int | None:
        """What C reads."""
        if not len(found):
            return None
        number = np.lexsort(found.T[::-1])
        start = np.searchsorted(found[number, 0], np.arange(batches + 1))
        self._kept = [np.ascontiguousarray(x, np.int32) for x in (start, found[number, 1], number)]
        self.c = Ties(len(found), *map(address_of, self._kept))
        return ctypes.addressof(self.c)

    def among(self, order: np.ndarray, first: int) -> np.ndarray:
        """An order of elimination with efforts, unknowns from number ``first`` on, behind the first body of each spring: their
        compliance is a pivot there, however stiff the spring.
        """
        place = np.argsort(order)
        ends = [min(place[self._couplings.of_body[b]].max() for b in bodies) + 0.5 for bodies in self._bodies]
        every = np.concatenate((np.arange(len(order), dtype=float), ends))
        return np.concatenate((order, first + np.arange(len(ends))))[np.argsort(every, kind="stable")]
