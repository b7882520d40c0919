"""Material points of a mesh: the cell that holds a point, and the shape functions of a displacement space there.

    u(X) = sum_n N_n(X) u_n,    grad u(X) = sum_n u_n (dN_n/dX)^T                                        (1)

over the nodes of one cell. The point is found once; afterwards a value costs one small sum over ranks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError
from ..ranks import rank_max, rank_sum
from ..rotations import Array

SAME = 1e-10  # of the mesh's largest coordinate: distances that differ by less are the same
CLOSE = 1e-6  # of the mesh's extent: a point so far outside of the mesh counts as on its boundary


@dataclass(frozen=True, eq=False)
class MaterialPoint:
    """A point within a cell, all ranks alike but for what only one of them can know.

    Attributes: ``owner`` the rank that holds the cell, ``cell`` its number there (-1 elsewhere), ``reference`` (1, d) the point
    in the reference cell; ``shape`` (k,) and ``gradient`` (k, d) the shape functions of the cell's nodes and their derivatives
    by X; ``own`` (k,) the nodes' numbers on this rank where it owns them, else -1.
    """

    comm: Any
    owner: int
    cell: int
    reference: Array
    shape: Array
    gradient: Array
    own: np.ndarray

    def nodal(self, U: Array) -> Array:
        """Values (.., k, m) of the cell's nodes from those of the nodes that this rank owns, (.., n, m); collective."""
        found = np.zeros((*U.shape[:-2], len(self.own), U.shape[-1]))
        here = self.own >= 0
        found[..., here, :] = U[..., self.own[here], :]

        return rank_sum(self.comm, found)


def distance_to(msh: Any, point: Array) -> tuple[float, int, int]:
    """Distance (m) of a point to a mesh, the rank with the nearest cell, its number there (-1 elsewhere); collective.

    Of several cells that share the point it is the first of the mesh as it was read: strains jump from one to the next, and
    may not depend on how the mesh is distributed.
    """
    from dolfinx import geometry

    tdim = msh.topology.dim
    cells = np.arange(msh.topology.index_map(tdim).size_local, dtype=np.int32)
    x = np.zeros((1, 3))
    x[0, : len(point)] = point

    same = SAME * float(rank_max(msh.comm, np.abs(msh.geometry.x).max(initial=0.0)))
    distance, place, cell = np.inf, -1, -1
    if len(cells):
        tree = geometry.bb_tree(msh, tdim, entities=cells, padding=same)
        middles = geometry.create_midpoint_tree(msh, tdim, cells)
        nearest = geometry.compute_closest_entity(tree, middles, msh, x)
        near = np.append(nearest, geometry.compute_collisions_points(tree, x).array).astype(np.int32)
        apart = np.sqrt(geometry.squared_distance(msh, tdim, near, np.repeat(x, len(near), axis=0)))
        places = np.asarray(msh.topology.original_cell_index)[near]
        distance, place, cell = _first(apart, places, near, same)

    found = msh.comm.allgather((distance, place))
    distances, places = (np.array(x) for x in zip(*found, strict=True))
    distance, _, owner = _first(distances, places, np.arange(len(found)), same)
    return distance, owner, cell if msh.comm.rank == owner else -1


def _first(distances: Array, places: np.ndarray, names: np.ndarray, same: float) -> tuple[float, int, int]:
    """Distance, place and name of what has the lowest place among the nearest."""
    nearest = np.flatnonzero(distances <= distances.min() + same)
    k = nearest[np.argmin(places[nearest])]
    return float(distances[k]), int(places[k]), int(names[k])


def check_point(mesh: Any, point: Sequence[float] | Array, what: str) -> None:
    """Refuse a point that lies outside a :class:`~fmbd_fenicsx.Mesh`; collective."""
    distance, _, _ = distance_to(mesh.dolfinx, np.asarray(point, dtype=float))
    if distance > CLOSE * mesh.extent:
        nodes = mesh.dolfinx.geometry.x[:, : mesh.dim]
        of_ranks = mesh.dolfinx.comm.allgather((nodes.min(0), nodes.max(0)) if len(nodes) else None)
        boxes = np.array([box for box in of_ranks if box is not None])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        raise InputError(
            f"{what}: the point {tuple(float(c) for c in point)} lies {distance:.3g} m outside of {mesh.label}, which reaches "
            f"from {low.round(6).tolist()} to {high.round(6).tolist()}. Points are those of the mesh as it was placed."
        )


def material_point(space: Any, point: Array) -> MaterialPoint:
    """The cell of a point and the shape functions of a space of displacements there; collective."""
    msh = space.mesh
    _, owner, cell = distance_to(msh, point)
    sent = None
    if cell >= 0:
        sent = (*_shape_functions(space, cell, point), _global_nodes(space, cell))
    reference, shape, gradient, nodes = msh.comm.bcast(sent, root=owner)

    first, last = space.dofmap.index_map.local_range
    own = np.where((nodes >= first) & (nodes < last), nodes - first, -1)
    return MaterialPoint(msh.comm, owner, cell, reference, shape, gradient, own)


def _global_nodes(space: Any, cell: int) -> np.ndarray:
    local = np.asarray(space.dofmap.cell_dofs(cell), dtype=np.int32)

    return np.asarray(space.dofmap.index_map.local_to_global(local))


def _shape_functions(space: Any, cell: int, point: Array) -> tuple[Array, Array, Array]:
    """Reference point (1, d), N (k,) and dN/dX (k, d) of (1)."""
    import basix.ufl

    msh, d = space.mesh, len(point)
    nodes = msh.geometry.x[compat.geometry_dofmap(msh)[cell]][:, :d]
    reference = compat.pull_back(msh, point[None], nodes)

    # gradients of the map from the reference cell, then of the displacements
    cell_type = msh.basix_cell()
    bend = msh.ufl_domain().ufl_coordinate_element().embedded_superdegree
    map_gradient = basix.ufl.element("Lagrange", cell_type, bend).tabulate(1, reference)[1:, 0]
    J = np.einsum("ni,jn->ij", nodes, map_gradient)  # dX_i / dxi_j
    degree = space.ufl_element().embedded_superdegree
    table = basix.ufl.element("Lagrange", cell_type, degree).tabulate(1, reference)[:, 0]
    return reference, table[0], table[1:].T @ np.linalg.inv(J)
