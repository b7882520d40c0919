"""Named surfaces of elastic bodies as meshes of their own: the trace of V_h on Gamma.

The trace of a Lagrange space on a straight edge or a flat triangle is the Lagrange space of the same degree there, so the
whole of it is known from the facets' node numbers and points. A flat quadrilateral, the face of a hexahedron, is cut along a
diagonal into two triangles that both have all of its functions, so that all facets are edges or triangles (``quadrilaterals``).
These few numbers are gathered to all ranks, sorted by place and not by rank: multiplier spaces, norms and mortar integrals are
then plain arrays, equal on any number of ranks, with or without facets on a rank, and on every version of DOLFINx. Only the
columns of the coupling matrices are distributed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...errors import MeshError
from ...ranks import together
from ...rotations import Array, cross3
from ..mesh.mesh import cells_of
from .quadrilaterals import half_turn, skew_of, skewing, unskewed


@lru_cache(maxsize=32)
def lagrange(dim: int, degree: int, halved: bool = False) -> Any:
    """Basix element on the reference facet of the given dimension (1: interval, 2: triangle, the half of a square if halved)."""
    import basix

    cell = {1: basix.CellType.interval, 2: basix.CellType.triangle}[dim]
    if halved:
        cell = basix.CellType.quadrilateral
    variant = basix.LagrangeVariant.gll_warped
    return basix.create_element(basix.ElementFamily.P, cell, degree, variant, discontinuous=degree == 0)


def shape_functions(dim: int, degree: int, points: Array, halved: bool = False) -> Array:
    """Values of the Lagrange functions at reference points (..., dim) -> (..., k); vertices come first."""
    flat = np.ascontiguousarray(points.reshape(-1, dim))
    element = lagrange(dim, degree, halved)
    if len(flat) == 0:
        return np.zeros((*points.shape[:-1], element.dim))
    values = element.tabulate(0, flat)[0, :, :, 0]
    return np.asarray(values.reshape(*points.shape[:-1], -1))


def quadrature(dim: int, degree: int) -> tuple[Array, Array]:
    """Points (n, dim) and weights with sum 1 on the reference facet, exact for the given degree."""
    import basix

    cell = {1: basix.CellType.interval, 2: basix.CellType.triangle}[dim]
    points, weights = basix.make_quadrature(cell, max(degree, 1))
    return np.asarray(points), np.asarray(weights) / np.sum(weights)


@dataclass(frozen=True, eq=False)
class Trace:
    """A surface as a mesh with the nodes of V_h, replicated; facets and nodes are sorted by place.

    Attributes: ``points`` (n, d) nodes in the mesh's coordinates (m), ``nodes`` (n_f, k) node numbers of the
    facets, vertices first, ``normals`` (n_f, d) outward, ``degree`` of V_h, ``owned`` (n,) the node's number on this
    rank or -1, ``n_owned`` nodes of the body on this rank, ``label`` for messages; ``skew`` (n_f, 2): facets are the halves of
    quadrilaterals with these (a, b), which have the nodes of the whole.
    """

    label: str
    points: Array
    nodes: np.ndarray
    normals: Array
    degree: int
    owned: np.ndarray
    n_owned: int
    comm: Any
    skew: Array | None = None

    @property
    def halved(self) -> bool:
        """Whether facets are the halves of quadrilaterals."""
        return self.skew is not None

    @cached_property
    def order(self) -> int:
        """Degree of the functions of V_h as polynomials on a facet; where they are none, the degree to integrate them with."""
        if self.skew is None:
            return self.degree
        return 2 * self.degree + (SKEWED if self.skew.any() else 0)

    def shape(self, reference: Array, facets: Any = slice(None)) -> Array:
        """The functions of V_h at reference points (q, d-1) of all facets, or (n, q, d-1) of some: (n or 1, q, k)."""
        points = reference.reshape(-1, *reference.shape[-2:])
        if self.skew is not None:
            points = unskewed(points, self.skew[facets])
        return shape_functions(self.dim - 1, self.degree, points, self.halved)

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return int(self.points.shape[1])

    @property
    def n(self) -> int:
        """Nodes."""
        return len(self.points)

    @cached_property
    def corners(self) -> Array:
        """Vertices of the facets, (n_f, d, d)."""
        return np.asarray(self.points[self.nodes[:, : self.dim]])

    @cached_property
    def sizes(self) -> Array:
        """Lengths (m) or areas (m^2) of the facets, (n_f,)."""
        return np.asarray(np.linalg.norm(across(self.corners), axis=1) / (self.dim - 1))

    @cached_property
    def h(self) -> float:
        """Mean facet diameter, m."""
        edges = [self.corners[:, i] - self.corners[:, j] for i in range(self.dim) for j in range(i)]
        return float(np.mean(np.max([np.linalg.norm(e, axis=1) for e in edges], axis=0)))

    @cached_property
    def border(self) -> np.ndarray:
        """Nodes on the border of the surface: end points in the plane, border edges in space; sorted."""
        if self.dim == 2:
            ends, count = np.unique(self.nodes[:, :2], return_counts=True)
            return np.asarray(ends[count == 1])

        # edges that one facet has: of two neighbours both have it
        sides = lagrange(2, self.degree, self.halved).entity_closure_dofs[1]
        if self.halved:
            sides = sides[:2]  # the others are those of the other half
        edges = np.concatenate([self.nodes[:, s] for s in sides])
        _, first, count = np.unique(np.sort(edges[:, :2], axis=1), axis=0, return_index=True, return_counts=True)
        return np.unique(edges[first[count == 1]])

    def place(self, reference: Array) -> Array:
        """Points (n_f, m, d) at reference points (m, d-1) of every facet."""
        return np.einsum("ma,fad->fmd", shape_functions(self.dim - 1, 1, reference), self.corners)

    @property
    def mean_normal(self) -> Array:
        """The mean of the outward normals, (d,): of unit length where the surface is flat."""
        return np.asarray((self.sizes[:, None] * self.normals).sum(0) / self.sizes.sum())

    @property
    def flat(self) -> bool:
        """Whether its normals are all the same."""
        return bool(np.linalg.norm(self.mean_normal) >= 1 - 1e-6)

    def integrals(self, function: Callable[[Array], Array], p: int, degree: int) -> Array:
        """int psi_Fa f over each facet, (n_f, k_p, c), with its functions psi of degree p, for a function of points (n, d) ->
        (n, c) or (n,); exact for products of this ``degree``.
        """
        q, w = quadrature(self.dim - 1, degree)
        f = np.asarray(function(self.place(q).reshape(-1, self.dim))).reshape(len(self.nodes), len(q), -1)
        psi = shape_functions(self.dim - 1, p, q)
        return np.asarray(np.einsum("f,q,qa,fqc->fac", self.sizes, w, psi, f, optimize=True))

    def columns(self, B: sp.spmatrix) -> sp.csr_matrix:
        """Columns of a matrix on all trace nodes that this rank owns: (rows, n) -> (rows, n_owned)."""
        mine = np.flatnonzero(self.owned >= 0)
        B = sp.coo_matrix(B.tocsc()[:, mine])
        return sp.csr_matrix((B.data, (B.row, self.owned[mine][B.col])), shape=(B.shape[0], self.n_owned))

    def values(self, u: Array) -> Array:
        """Nodal values on all trace nodes from this rank's share, (n_owned, ...) -> (n, ...); collective."""
        out = np.zeros((self.n, *u.shape[1:]))
        mine = np.flatnonzero(self.owned >= 0)
        for at, part in self.comm.allgather((mine, u[self.owned[mine]])):
            out[at] = part
        return out

    def mass(self, weight: Array | None = None) -> sp.csr_matrix:
        """int phi_i phi_j (times a facet-wise weight), (n, n)."""
        sizes = self.sizes if weight is None else self.sizes * weight
        q, w = quadrature(self.dim - 1, 2 * self.order)
        phi = self.shape(q)
        M = (np.swapaxes(phi, 1, 2) * w) @ phi
        return scatter(sizes[:, None, None] * M, self.nodes, self.nodes, (self.n, self.n))

    def stiffness(self) -> sp.csr_matrix:
        """int grad_Gamma phi_i . grad_Gamma phi_j, (n, n)."""
        m = self.dim - 1
        q, w = quadrature(m, 2 * self.order)

        # gradients on the facet, those of halves by the (xi, eta) of the whole
        points = q[None] if self.skew is None else unskewed(q[None], self.skew)
        values = lagrange(m, self.degree, self.halved).tabulate(1, points.reshape(-1, m))[1:, :, :, 0]
        grad = np.moveaxis(values.reshape(m, *points.shape[:2], -1), 0, 2)  # (f or 1, q, m, k)
        if self.skew is not None:
            grad = np.linalg.solve(np.swapaxes(skewing(points, self.skew), 2, 3), grad)

        # surface gradients by the metric of the facet
        J = np.swapaxes(self.corners[:, 1:] - self.corners[:, :1], 1, 2)  # (f, d, m)
        inverse = np.linalg.inv(np.swapaxes(J, 1, 2) @ J)

        K = (np.swapaxes(grad, 2, 3) @ inverse[:, None] @ grad * w[:, None, None]).sum(1) * self.sizes[:, None, None]
        return scatter(K, self.nodes, self.nodes, (self.n, self.n))


def across(corners: Array) -> Array:
    """Vectors across facets with these corners, (n, d, d) -> (n, d): as long as an edge, or as two triangles are large."""
    e = corners[:, 1:] - corners[:, :1]
    return np.stack((e[:, 0, 1], -e[:, 0, 0]), axis=1) if corners.shape[2] == 2 else cross3(e[:, 0], e[:, 1])


def scatter(blocks: Array, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> sp.csr_matrix:
    """Sum of element matrices (n, r, c) with row numbers (n, r) and column numbers (n, c)."""
    i = np.broadcast_to(rows[:, :, None], blocks.shape).ravel()
    j = np.broadcast_to(columns[:, None, :], blocks.shape).ravel()
    return sp.coo_matrix((blocks.ravel(), (i, j)), shape=shape).tocsr()


@lru_cache(maxsize=64)
def reference_mass(dim: int, rows: int, columns: int) -> Array:
    """int psi_a phi_b over the reference facet of size 1, Lagrange of degrees ``rows`` and ``columns``."""
    q, w = quadrature(dim, rows + columns)
    return np.einsum("q,qa,qb->ab", w, shape_functions(dim, rows, q), shape_functions(dim, columns, q))


def trace_of(space: Any, mesh: Any, surface: str) -> Trace:
    """The trace of a Lagrange space (scalar or vector) on a named surface; collective.

    Raises:
        MeshError: no facets on the boundary, next to no area, facets that are curved or warped.
    """
    from dolfinx import fem

    d, comm = mesh.dim, mesh.dolfinx.comm
    # of tensor products, too: all polynomials of this degree and none higher along an edge
    degree = int(space.ufl_element().embedded_subdegree)
    label = f'surface "{surface}" of {mesh.label}'
    error, local = None, None
    sides = int(mesh.dolfinx.ufl_domain().ufl_coordinate_element().embedded_subdegree)
    shape = fem.functionspace(mesh.dolfinx, ("Lagrange", sides)) if sides > 1 else None
    try:
        # cells of higher degree may have straight facets there
        if shape is not None:
            _own_facets(shape, mesh, surface, sides)
        local = _own_facets(space, mesh, surface, degree)
    except MeshError as exc:
        error = MeshError(f"{label}: {exc}")
    together(comm, error)
    parts = [p for p in comm.allgather(local) if len(p[0])]
    if not parts:
        raise MeshError(f"{label}: it has no facets on the boundary.")

    # facets of all ranks; each node once, numbered by its place so that the ranks do not matter
    ids, x, normals = (np.concatenate([p[i] for p in parts]) for i in range(3))
    unique, first, inverse = np.unique(ids.ravel(), return_index=True, return_inverse=True)
    points = x.reshape(-1, d)[first]
    order = _by_place(points)
    number = np.empty_like(order)
    number[order] = np.arange(len(order))
    nodes = number[inverse.reshape(ids.shape)]
    middles = points[order][nodes[:, :d]].mean(axis=1)
    facets = _by_place(middles)

    # where this rank's own displacements are among them
    low, high = space.dofmap.index_map.local_range
    found = unique[order]
    owned = np.where((found >= low) & (found < high), found - low, -1)
    made = Trace(label, points[order], nodes[facets], normals[facets], degree, owned, high - low, comm)
    if mesh.dolfinx.topology.cell_name() == "hexahedron":
        made = replace(made, skew=skew_of(made.points[made.nodes[:, :4]]))
    mesh.check_area(surface, float(made.sizes.sum()))
    return made


def surface_trace(mesh: Any, surface: str, degree: int = 1) -> Trace:
    """The trace of the scalar Lagrange space of a degree on a named surface; collective."""
    from dolfinx import fem

    return trace_of(fem.functionspace(mesh.dolfinx, ("Lagrange", degree)), mesh, surface)


def _by_place(x: Array) -> np.ndarray:
    """Order of points by their coordinates, rounded so that it does not depend on roundoff."""
    size = float(np.ptp(x, axis=0).max()) or 1.0
    return np.lexsort(np.round((x - x.min(0)) / size, 9).T[::-1])


def _own_facets(space: Any, mesh: Any, surface: str, degree: int) -> tuple[np.ndarray, Array, Array]:
    """Own facets: global node numbers (n, k), their points (n, k, d), outward normals (n, d); quadrilaterals as two halves."""
    from dolfinx.mesh import exterior_facet_indices

    msh, d = mesh.dolfinx, mesh.dim
    topology = msh.topology
    topology.create_connectivity(d - 1, d)
    halved = topology.cell_name() == "hexahedron"

    # own facets of the surface that lie on the boundary
    facets = np.intersect1d(mesh.facets(surface), exterior_facet_indices(topology))
    facets = facets[facets < topology.index_map(d - 1).size_local]
    cells, sides = cells_of(topology, facets)

    k = lagrange(d - 1, degree, halved).dim
    if len(facets) == 0:
        return np.zeros((0, k), dtype=np.int64), np.zeros((0, k, d)), np.zeros((0, d))

    # the nodes of each, those of the cell's side
    closure = np.array(space.element.basix_element.entity_closure_dofs[d - 1])
    dofs = np.take_along_axis(space.dofmap.list[cells], closure[sides], axis=1)
    coordinates = space.tabulate_dof_coordinates()[:, :d]
    x = coordinates[dofs]

    # outward normals: away from the middle of the cell
    normals = across(x[:, :d])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inside = coordinates[space.dofmap.list[cells]].mean(axis=1)
    normals *= np.where(((x[:, 0] - inside) * normals).sum(1) < 0, -1.0, 1.0)[:, None]

    # nodes in the order of a reference facet, whatever the cell's
    rank_order = _reference_order(x, degree, halved)
    dofs = np.take_along_axis(dofs, rank_order, axis=1)
    x = np.take_along_axis(x, rank_order[:, :, None], axis=1)
    if halved:
        other = half_turn(np.asarray(lagrange(d - 1, degree, halved).points))
        dofs, x = np.concatenate((dofs, dofs[:, other])), np.concatenate((x, x[:, other]))
        normals = np.concatenate((normals, normals))
    ids = space.dofmap.index_map.local_to_global(dofs.ravel().astype(np.int32)).reshape(dofs.shape)
    return ids.astype(np.int64), x, normals


SKEWED = 12  # degrees of quadrature more where functions are no polynomials: patch tests to 1e-7 on cells that are half triangles
STRAIGHT = 1e-6  # of the size of a facet: how far its nodes may lie beside a straight one's


def _reference_order(x: Array, degree: int, halved: bool) -> np.ndarray:
    """Permutation of each facet's nodes into the order of the reference element spanned by its first d nodes."""
    n, k, d = x.shape
    wanted = np.asarray(lagrange(d - 1, degree, halved).points)
    corners = 4 if halved else d
    at = np.einsum("ma,fad->fmd", shape_functions(d - 1, 1, wanted, halved), x[:, :corners])

    distance = np.linalg.norm(at[:, :, None] - x[:, None, :], axis=3)
    order = distance.argmin(axis=2)

    size = distance.max(axis=(1, 2))
    off = distance.min(axis=2).max(axis=1)
    if halved:
        # the fourth corner of a flat one lies in the plane of the others
        normal = across(x[:, :3])
        off = np.maximum(off, np.abs(((x[:, 3] - x[:, 0]) * normal).sum(1)) / np.linalg.norm(normal, axis=1))
    if (np.sort(order, axis=1) != np.arange(k)).any() or (off > STRAIGHT * size).any():
        shape = "curved or warped" if halved else "curved"
        raise MeshError(
            f"its facets are {shape} (nodes are up to {(off / size).max():.2g} of their size off); multiplier fields, "
            "ties and contact of two elastic surfaces need straight ones, whose intersections are polygons. Mesh the surface "
            "with cells of the first order, a warped one with tetrahedra, or hold its mean by a joint, as fmbd.fixed does."
        )
    return np.asarray(order)


def refined(trace: Trace, times: int, degree: int) -> Trace:
    """The surface cut into finer facets with Lagrange nodes of the given degree, for norms: it owns no nodes of the body."""
    m = trace.dim - 1
    pieces = np.concatenate((np.zeros((1, m)), np.eye(m)))[None]
    for _ in range(times):
        pieces = np.concatenate([cut(pieces) for cut in _halves(m)])

    x = np.einsum("pva,fad->fpvd", shape_functions(m, 1, pieces), trace.corners).reshape(-1, trace.dim, trace.dim)
    nodes = np.einsum("ka,fad->fkd", shape_functions(m, 1, np.asarray(lagrange(m, degree).points)), x)

    # nodes at the same place are one
    flat = nodes.reshape(-1, trace.dim)
    key = np.round((flat - flat.min(0)) / float(np.ptp(flat, axis=0).max()), 9)
    _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
    none = np.full(len(first), -1)
    number = inverse.reshape(nodes.shape[:2])
    normals = np.repeat(trace.normals, len(pieces), axis=0)
    return Trace(trace.label, flat[first], number, normals, degree, none, 0, trace.comm)


def _halves(m: int) -> list[Callable[[Array], Array]]:
    """The maps that cut an interval in two, a triangle in four; on corners (n, m+1, m)."""
    if m == 1:
        return [lambda p: np.stack((p[:, 0], p.mean(1)), axis=1), lambda p: np.stack((p.mean(1), p[:, 1]), axis=1)]

    def middle(p: Array, i: int, j: int) -> Array:
        return np.asarray(0.5 * (p[:, i] + p[:, j]))

    return [
        lambda p: np.stack((p[:, 0], middle(p, 0, 1), middle(p, 0, 2)), axis=1),
        lambda p: np.stack((p[:, 1], middle(p, 1, 2), middle(p, 0, 1)), axis=1),
        lambda p: np.stack((p[:, 2], middle(p, 0, 2), middle(p, 1, 2)), axis=1),
        lambda p: np.stack((middle(p, 0, 1), middle(p, 1, 2), middle(p, 0, 2)), axis=1),
    ]
