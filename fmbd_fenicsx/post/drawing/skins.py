"""Skins of bodies on a mesh: the surface in space, the body itself in the plane, in its nodes' global numbers.

Curved (P2) facets are drawn with their mid nodes. Everything here is collective.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...fem.mesh.mesh import cells_of
from ...rotations import Array


@dataclass(frozen=True)
class Skin:
    """Triangles (m, 3) and edge segments (k, 2) of all ranks, and of this rank's triangles the cell and the point within it.

    ``cells`` (m',) local numbers, ``places`` (m',) rows of ``middles`` (p, d): reference points of the triangles' centres.
    """

    triangles: np.ndarray
    edges: np.ndarray
    cells: np.ndarray
    places: np.ndarray
    middles: Array


def skin(space: Any) -> Skin:
    """Skin of a space of displacements."""
    msh, dofs = space.mesh, space.dofmap
    tdim = msh.topology.dim
    facets = _outer_facets(msh)
    layout = dofs.dof_layout
    numbers = dofs.index_map.local_to_global
    ends = [layout.entity_closure_dofs(tdim - 1, f) for f in range(_facets_of_a_cell(msh))]
    borders = [dofs.cell_dofs(cell)[ends[f]] for cell, f in facets]

    # what is filled: boundary facets in space, whole cells in the plane
    if tdim == 3:
        kinds, owners = ends, facets
        lines = [segment for b in borders for segment in _outline(b)]
    else:
        kinds = [layout.entity_closure_dofs(tdim, 0)]
        owners = [(c, 0) for c in range(msh.topology.index_map(tdim).size_local)]
        lines = [segment for b in borders for segment in _polyline(b)]

    nodes = compat.interpolation_points(space)
    patterns = [triangles_of(k) for k in kinds]
    first = np.cumsum([0, *(len(p) for p in patterns)])
    faces = [dofs.cell_dofs(cell)[np.array(t)] for cell, kind in owners for t in patterns[kind]]

    return Skin(
        _gathered(msh.comm, numbers, faces, 3),
        _gathered(msh.comm, numbers, lines, 2),
        np.array([cell for cell, kind in owners for _ in patterns[kind]], dtype=np.int32),
        np.array([first[kind] + i for _, kind in owners for i in range(len(patterns[kind]))], dtype=int),
        np.array([nodes[t].mean(0) for pattern in patterns for t in pattern]),
    )


def painted(u: Any, skin: Skin, quantity: Callable[[Any], Any]) -> Array:
    """A scalar quantity(u) in UFL, u a Function of displacements, at the centres of all triangles of the skin, (m,)."""
    from dolfinx import fem

    msh = u.function_space.mesh
    cells, row = np.unique(skin.cells, return_inverse=True)
    expression = fem.Expression(quantity(u), skin.middles)
    values = np.asarray(expression.eval(msh, cells.astype(np.int32))).reshape(len(cells), -1)
    return np.concatenate(msh.comm.allgather(values[row, skin.places]))


def gathered_nodes(comm: Any, own: Array) -> Array:
    """Points (n, 3) of all ranks in global order on rank 0, this rank's elsewhere."""
    parts = comm.gather(own)

    return own if parts is None else np.concatenate(parts)


def _outer_facets(msh: Any) -> list[tuple[int, int]]:
    """Boundary facets of this rank as (cell, number of the facet in the cell)."""
    from dolfinx import mesh as dm

    tdim = msh.topology.dim
    msh.topology.create_connectivity(tdim - 1, tdim)
    cells, numbers = cells_of(msh.topology, dm.exterior_facet_indices(msh.topology))
    return [(int(cell), int(number)) for cell, number in zip(cells, numbers, strict=True)]


def _facets_of_a_cell(msh: Any) -> int:
    """Number of facets of a cell; all cells are of one type."""
    from dolfinx.cpp.mesh import cell_num_entities

    return int(cell_num_entities(msh.topology.cell_type, msh.topology.dim - 1))


def _gathered(comm: Any, numbers: Any, local: list[Any], width: int) -> np.ndarray:
    """Rows of local node numbers as global ones, of all ranks."""
    own = np.array(local, dtype=np.int32).reshape(-1, width)

    return np.concatenate(comm.allgather(numbers(own.ravel()).reshape(-1, width)))


def triangles_of(n: Any) -> list[list[int]]:
    """Triangles of a face: 3 nodes, 6 (corners, then the mid nodes opposite to them), 4 or 9 (tensor order)."""
    if len(n) in (4, 9):
        return [[n[0], n[1], n[3]], [n[0], n[3], n[2]]]
    if len(n) == 6:
        return [[n[i] for i in t] for t in ((0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5))]
    return [[n[0], n[1], n[2]]]


def _outline(n: Array) -> list[list[int]]:
    """Border of a face as segments."""
    if len(n) in (4, 9):
        return [[n[a], n[b]] for a, b in ((0, 1), (1, 3), (3, 2), (2, 0))]
    if len(n) == 6:
        return [s for a, m, b in ((0, 5, 1), (1, 3, 2), (2, 4, 0)) for s in ([n[a], n[m]], [n[m], n[b]])]
    return [[n[a], n[b]] for a, b in ((0, 1), (1, 2), (2, 0))]


def _polyline(n: Array) -> list[list[int]]:
    """Segments of an edge with two ends and, for P2, a mid node."""
    return [[n[0], n[2]], [n[2], n[1]]] if len(n) == 3 else [[n[0], n[1]]]
