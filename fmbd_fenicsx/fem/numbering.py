"""Numbers of the nodes of a space that do not depend on how the mesh is distributed.

A node is known by the smallest of ``k c + j`` over the cells c (their places in the mesh as it was read) in which it is node
number j of k. Nodes sorted by that key have the same numbers on any number of ranks. No coordinates are compared.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rotations import Array


class Numbering:
    """Canonical numbers of the nodes of a dolfinx space; collective to build, and to collect values.

    Attributes: ``count`` nodes of the whole mesh, ``of`` (count,) canonical numbers by global number, ``own`` those of this
    rank's nodes.
    """

    def __init__(self, space: Any) -> None:
        self.comm, index_map = space.mesh.comm, space.dofmap.index_map
        table = space.dofmap.list
        cells = np.asarray(space.mesh.topology.original_cell_index, dtype=np.int64)[: len(table)]
        keys = cells[:, None] * table.shape[1] + np.arange(table.shape[1])
        nodes = index_map.size_local + index_map.num_ghosts

        # a node is known by the smallest place that it has in a cell of the file
        smallest = np.full(nodes, np.iinfo(np.int64).max)
        np.minimum.at(smallest, table.ravel(), keys.ravel())
        numbers = index_map.local_to_global(np.arange(nodes, dtype=np.int32))

        # rank 0 sorts
        parts = self.comm.gather((numbers, smallest))
        self.count, of = int(index_map.size_global), np.zeros(0, dtype=np.int64)
        if parts is not None:
            key = np.full(self.count, np.iinfo(np.int64).max)
            for which, found in parts:
                np.minimum.at(key, which, found)
            of = np.empty(self.count, dtype=np.int64)
            of[np.argsort(key, kind="stable")] = np.arange(self.count)
        self.of = self.comm.bcast(of)

        low, high = index_map.local_range
        self.own = self.of[low:high]

    def collect(self, x: Array) -> Array | None:
        """Values of this rank's nodes, (n k,), to those of all nodes in canonical order, (count, k): on rank 0; collective."""
        rows = x.reshape(len(self.own), -1) if len(self.own) else None
        parts = self.comm.gather((self.own, rows))
        if parts is None:
            return None
        width = next(r.shape[1] for _, r in parts if r is not None)
        out = np.empty((self.count, width))
        for own, values in parts:
            if values is not None:
                out[own] = values
        return out

    def pick(self, x: Array) -> Array:
        """This rank's values, (n k,), of values in canonical order (count, k)."""
        return x[self.own].ravel()
