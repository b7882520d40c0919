"""Names, sizes and units of the blocks, and the way between the arrays of a system and PETSc's vectors.

On each rank a vector of PETSc holds its share of the core, its nodal values of each body, its share of the multipliers of each
joint. Unknowns x of a block are ``scale`` times those of PETSc, forces those of PETSc over ``scale``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array
from ...system.system import System


class SplitLayout:
    """Of one system: the core if there is one, the fields, then blocks of rows. ``rows``: block of multipliers -> its rows."""

    def __init__(self, system: System) -> None:
        self.system, self.comm = system, system.comm
        self.rows = _blocks_of_rows(system)
        self.first = int(system.n_core > 0)  # number of the first field
        self.names = [*["frame"][: self.first], *(split_name(f.name) for _, f in system.fields), *self.rows]
        self.scale = np.ones(len(self.names))

        # on this rank
        core = [_size(share(system.n_core, self.comm))][: self.first]
        multipliers = [_size(share(_size(r), self.comm)) for r in self.rows.values()]
        self.sizes = [*core, *(f.n for _, f in system.fields), *multipliers]

    @property
    def fields(self) -> slice:
        """The numbers of the fields among the blocks."""
        return slice(self.first, self.first + len(self.system.fields))

    def pack(self, core: Array, local: list[Array], lam: Array) -> Array:
        """This rank's entries of a vector of forces: on the core, on the nodes of each field, on all rows."""
        shares = [self._mine(core)][: self.first]
        parts = (*shares, *local, *(self._mine(lam[r]) for r in self.rows.values()))
        return np.concatenate([d * x for d, x in zip(self.scale, parts, strict=True)])

    def unpack(self, x: Array) -> tuple[Array, list[Array], Array]:
        """Core, nodal values of each field, and all multipliers of a vector of unknowns; collective."""
        parts: list[Array] = [d * y for d, y in zip(self.scale, self.split(x), strict=True)]
        local = parts[self.fields]

        # what is shared among ranks comes back together
        mine = [*parts[: self.first], *parts[self.fields.stop :]]
        ranks = self.comm.allgather(mine)
        whole = [np.concatenate([rank[j] for rank in ranks]) for j in range(len(mine))]

        core: Array = whole[0] if self.first else np.zeros(0)
        lam: Array = np.zeros(self.system.n_lam)
        for r, y in zip(self.rows.values(), whole[self.first :], strict=True):
            lam[r] = y
        return core, local, lam

    def _mine(self, x: Array) -> Array:
        """This rank's entries of a replicated array."""
        return x[share(len(x), self.comm)]

    def split(self, x: Array) -> list[Array]:
        """The blocks of a vector, this rank's entries."""
        return np.split(x, np.cumsum(self.sizes)[:-1])

    def norms(self, vectors: list[Array]) -> Array:
        """Norms of the blocks of vectors of forces, in their own units, (vectors, blocks); collective."""
        squares = np.array([[float(part @ part) for part in self.split(x)] for x in vectors])
        field = self.system.fields[0][1].field
        return np.asarray(np.sqrt(field.total(squares)) / self.scale)


def _blocks_of_rows(system: System) -> dict[str, slice]:
    """Name of each block of multipliers, and its rows; joints that share rows are one."""
    rows: dict[str, slice] = {}
    for block in system.blocks:
        name = f"{block.name.removeprefix('frame of ')}.frame" if block.kind == "frame" else block.name
        empty = not _size(block.rows)
        if not empty and not any(block.rows == r for r in rows.values()):
            rows[f"{name}.force".replace(" ", "_")] = block.rows
    return rows


def split_name(body: str) -> str:
    """PETSc's name of the split of a body."""
    return f"{body}.u".replace(" ", "_")


def share(n: int, comm: Any) -> slice:
    """This rank's rows of n that all ranks know."""
    each, more = divmod(n, comm.size)
    low = comm.rank * each + min(comm.rank, more)
    return slice(low, low + each + (comm.rank < more))


def _size(rows: slice) -> int:
    return int(rows.stop - rows.start)
