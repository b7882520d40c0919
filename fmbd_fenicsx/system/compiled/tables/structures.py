"""The structures of ``driver/tables.h``, and a store that keeps their arrays alive."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from ....kernel_cache import address_of
from ....rotations import Array
from ..declarations import TABLES, enumeration, structure_of


def structure(name: str, dim: int) -> type[ctypes.Structure]:
    """``Batch``, ``Surface``, ``Body``, ``Front``, ``Rod`` .. or ``System`` of the driver in ``dim`` dimensions."""
    return structure_of(TABLES, name, dim)


@cache
def array_of(kind: type[ctypes.Structure], count: int) -> Any:
    """The type of ``count`` structures; ctypes would make it again for every scene."""
    return kind * count


Sizes = Mapping[str, int | tuple[int, ...]]  # of arrays by name
LANES = 8  # numbers in a line of the cache
# vectors of ``driver/onestep/secants.c``: of pairs, and three more
SECANTS = 2 * enumeration("PAIRS", "onestep/secants.c")["PAIRS"] + 3


def zeros_of(sizes: Sizes) -> dict[str, tuple[Array, int]]:
    """Arrays of zeros by name, one behind the other in one piece of memory, and their addresses; none is empty there.
    Each begins with a line of the cache.
    """
    spans, count = [], 0
    for name, shape in sizes.items():
        size = shape if isinstance(shape, int) else math.prod(shape)
        spans.append((name, shape, count, size))
        count += -(-(size or 1) // LANES) * LANES
    whole: Array = np.zeros(count + LANES)
    first = address_of(whole)
    before = -(first // 8) % LANES  # numbers in front of the next line
    whole, first = whole[before:], first + 8 * before

    made: dict[str, tuple[Array, int]] = {}
    for name, shape, at, size in spans:
        x = whole[at : at + size]
        made[name] = x if isinstance(shape, int) else x.reshape(shape), first + 8 * at
    return made


class Store:
    """Arrays that C reads and writes: kept here as long as the tables live."""

    def __init__(self) -> None:
        self.kept: list[Any] = []

    def array(self, values: Any, dtype: Any = np.float64) -> tuple[Array, int]:
        """A contiguous copy and its address."""
        copy = np.array(values, dtype=dtype, order="C")
        self.kept.append(copy)
        return copy, address_of(copy)

    def zeros(self, sizes: Mapping[str, int | tuple[int, ...]]) -> dict[str, tuple[Array, int]]:
        """Arrays of zeros by name, as :func:`zeros_of` makes them."""
        made = zeros_of(sizes)
        self.kept += [x for x, _ in made.values()][:1]  # which keeps all of them
        return made

    def copies(self, given: Mapping[str, Array]) -> dict[str, int]:
        """The addresses of copies by name, in one piece of memory as that of :meth:`zeros`."""
        made = self.zeros({name: x.shape for name, x in given.items()})
        for name, x in given.items():
            made[name][0][...] = x
        return {name: address for name, (_, address) in made.items()}

    def address(self, values: Any) -> int:
        """The address of a contiguous copy as C's double."""
        return self.array(values, np.float64)[1]

    def shared(self, values: Array) -> int:
        """The address of an array itself, which C only reads, where it is contiguous."""
        kept = np.ascontiguousarray(values)
        self.kept.append(kept)
        return address_of(kept)

    def structure(self, one: Any) -> int:
        """The address of a structure."""
        self.kept.append(one)
        return ctypes.addressof(one)

    def integers(self, values: Any) -> int:
        """The address of a copy as C's int."""
        return self.array(values, np.int32)[1]
