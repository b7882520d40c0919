"""The nodes of elastic surfaces that may touch, equal on all ranks, with the weights of their dual
multipliers.

The traces of contact surfaces are small against the bodies, so every rank keeps all of their nodes; only products
with nodal fields of the body are distributed. Gaps are distances of nodes, and their forces f_i = int p phi_i act on
nodes, whatever the basis. For quadratic triangles int phi_i vanishes at the vertices; there the pressure is that of the basis

    phi~_v = phi_v + a sum_e phi_e,   phi~_e = (1 - 2 a) phi_e,   a = 1/5                                   (1)

of the same space, whose integrals D~ are positive: p_i = f~_i / D~_i with f~_v = f_v + a sum_e f_e, f~_e = (1 - 2a) f_e (Popp,
Wohlmuth, Gee and Wall, doi:10.1137/110848190). To write the gaps in it too would subtract a share of those of the vertices from
those between them: beside an obstacle of radius R they would be off by h^2 / (12 R).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ... import dolfinx_compat as compat
from ...errors import MeshError
from ...fem.assembly import NodalVector
from ...fem.mesh.mesh import cells_of
from ...fem.numbering import Numbering
from ...rotations import Array

_SHIFT = 0.2  # a in (1)


@dataclass(frozen=True)
class SurfaceNodes:
    """One surface of a trace: numbers in it (n_s,), weights D~ (n_s,) and the matrix f -> f~ of (1); None: f itself."""

    nodes: np.ndarray
    weights: Array
    gather: Any


@dataclass(frozen=True, eq=False)
class BodyNodes:
    """All nodes of an elastic body: its scalar-blocked ``space`` on ``mesh``, positions (n, d) of this rank's nodes.

    ``X``: in the axes of the body's frame, ``X_world``: where they lie at rest.
    """

    space: Any
    mesh: Any
    degree: int
    X: Array
    X_world: Array

    @cached_property
    def numbering(self) -> Numbering:
        """Numbers of the nodes that do not depend on the ranks; collective at first use."""
        return Numbering(self.space)


class ContactTrace:
    """All contact nodes of one elastic part; collective to build.

    A :class:`FieldTrace` sees nodal values of a field, a :class:`ModalTrace` amplitudes of modes.

    Attributes: ``part`` its number, ``own`` owned node numbers of this rank, ``first`` where they start in
    the common list, ``X`` (n, d) reference positions in the body's axes (the world's without a ``moving`` frame),
    ``n``, ``dim``, ``size`` of the body (m), ``surfaces``.
    """

    def __init__(self, number: int, part: Any, nodes: BodyNodes, surfaces: list[str], *, moving: bool) -> None:
        self.part = number
        self.body_nodes = nodes
        self.comm = nodes.mesh.dolfinx.comm
        self.alone = self.comm.size == 1
        self.dim = nodes.mesh.dim
        self.frame = part.frame
        self.moving = moving
        self.size = part.size

        lists = {s: _facet_dofs(nodes, s) for s in surfaces}
        used = np.unique(np.concatenate([f.ravel() for f, _ in lists.values()]))

        # node numbers are those over all ranks; owned ones follow each other
        low, high = nodes.space.dofmap.index_map.local_range
        self.own = (used[(used >= low) & (used < high)] - low).astype(int)
        self.first = int(np.searchsorted(used, low))
        self.n = len(used)

        self.at_rest = self._everywhere(nodes.X_world)
        self.X = self._everywhere(nodes.X) if moving else self.at_rest
        self.surfaces = {s: self._surface(s, np.searchsorted(used, f), w) for s, (f, w) in lists.items()}

    def _everywhere(self, x: Array) -> Array:
        """Rows (n_own, k) of this rank's nodes at all contact nodes, (n, k), on all ranks; collective."""
        mine = x[self.own]
        return mine if self.alone else np.concatenate(self.comm.allgather(mine))

    def gather(self, w: Array) -> Array:
        """Values at the contact nodes, (n, d), on all ranks, of local coordinates of the part; collective."""
        raise NotImplementedError

    @property
    def thickness(self) -> float:
        """Shortest edge of the box around the body at rest, m; collective."""
        X = self.body_nodes.X_world
        none = np.full(self.dim, np.inf)
        low = np.min(self.comm.allgather(X.min(0) if len(X) else none), axis=0)
        return float((np.max(self.comm.allgather(X.max(0) if len(X) else -none), axis=0) - low).min())

    def _surface(self, name: str, facets: np.ndarray, weights: dict[int, float]) -> SurfaceNodes:
        nodes = np.unique(facets)
        local = np.searchsorted(nodes, facets)
        D = np.array([weights[int(g)] for g in self.global_numbers[nodes]])
        n = len(nodes)
        gather: Any = None
        # quadratic faces: functions of corners have integral zero, a share of the edges' is given to them
        if self.dim == 3 and facets.shape[1] == 6:
            vertices = _edge_vertices(self.X[nodes], local)
            rows, cols, values = [], [], []
            for e, pair in vertices.items():
                rows += [e, *pair]
                cols += [e, e, e]
                values += [-2 * _SHIFT, _SHIFT, _SHIFT]
            gather = (sp.identity(n) + sp.csr_matrix((values, (rows, cols)), shape=(n, n))).tocsr()
            D = gather @ D

        if (D <= 0).any():
            raise MeshError(
                f'Contact surface "{name}": a shape function has no positive integral on it; use degree 1 or 2.'
            )
        return SurfaceNodes(nodes, D, gather)

    @cached_property
    def global_numbers(self) -> np.ndarray:
        """Global numbers of the body's nodes by their number in the trace, (n,); collective at first use."""
        low = self.body_nodes.space.dofmap.index_map.local_range[0]
        return np.concatenate(self.comm.allgather(self.own + low))


class FieldTrace(ContactTrace):
    """Contact nodes of an elastic field, whose local coordinates are nodal displacements."""

    def __init__(self, number: int, part: Any, surfaces: list[str], *, moving: bool) -> None:
        self.field = f = part.field
        nodes = BodyNodes(f.space, f.mesh, f.forms.degree, f.X, f.X_world)
        super().__init__(number, part, nodes, surfaces, moving=moving)

    def gather(self, w: Array) -> Array:
        """Values of a nodal vector (n_own d,) of the part at the contact nodes, (n, d), on all ranks; collective."""
        mine = w.reshape(-1, self.dim)[self.own]
        return mine if self.alone else np.concatenate(self.comm.allgather(mine))

    def spread(self, f: Array, out: Array) -> None:
        """Add values (n, d) at the contact nodes to a nodal vector (n_own d,) of this rank."""
        out.reshape(-1, self.dim)[self.own] += f[self.first : self.first + len(self.own)]

    def unit_columns(self, dofs: np.ndarray) -> Array:
        """Unit nodal vectors (n_own d, len(dofs)) of trace unknowns (node d + component)."""
        out = np.zeros((self.field.n * self.dim, len(dofs)), order="F")
        node = dofs // self.dim - self.first
        c = dofs % self.dim
        # columns of other ranks' nodes are zero here
        mine = np.flatnonzero((node >= 0) & (node < len(self.own)))
        out[self.own[node[mine]] * self.dim + c[mine], mine] = 1.0
        return out


class ModalTrace(ContactTrace):
    """Contact nodes of a reduced body, u = Phi eta; its rows act on the amplitudes, which belong to the core.

    ``modes`` (n d, m): Phi at the contact nodes.
    """

    def __init__(self, number: int, part: Any, nodes: BodyNodes, phi: Array, surfaces: list[str]) -> None:
        super().__init__(number, part, nodes, surfaces, moving=True)
        m = phi.shape[1]
        self.modes: Array = self._everywhere(phi.reshape(len(nodes.X), self.dim * m)).reshape(self.n * self.dim, m)

    def gather(self, w: Array) -> Array:
        """Displacements Phi eta of the contact nodes, (n, d)."""
        return (self.modes @ w).reshape(-1, self.dim)


def surface_nodes(field: Any, surfaces: list[str]) -> np.ndarray:
    """Owned nodes on some surfaces of a field, ascending; collective."""
    nodes = BodyNodes(field.space, field.mesh, field.forms.degree, field.X, field.X_world)
    used = np.unique(np.concatenate([_facet_dofs(nodes, s)[0].ravel() for s in surfaces]))
    low, high = field.space.dofmap.index_map.local_range
    return (used[(used >= low) & (used < high)] - low).astype(int)


def _facet_dofs(nodes: BodyNodes, surface: str) -> tuple[np.ndarray, dict[int, float]]:
    """Global scalar dofs of the facets of a surface (n_f, n_loc), and int phi_i of each dof; equal on all
    ranks.
    """
    import ufl
    from dolfinx import fem

    mesh, space = nodes.mesh, nodes.space
    msh = mesh.dolfinx
    comm = msh.comm
    d = mesh.dim

    # each facet once: on the rank that owns its cell
    cells, sides = cells_of(msh.topology, mesh.facets(surface))
    mine = cells < msh.topology.index_map(d).size_local
    closure = np.array(space.element.basix_element.entity_closure_dofs[d - 1])
    dofs = np.take_along_axis(space.dofmap.list[cells[mine]], closure[sides[mine]], axis=1)

    index_map = space.dofmap.index_map
    rows = index_map.local_to_global(dofs.ravel().astype(np.int32)).reshape(dofs.shape)
    facets = np.concatenate(comm.allgather(rows.astype(np.int64)))
    if len(facets) == 0:
        raise MeshError(f'Surface "{surface}" of {mesh.label} has no facets on the boundary.')

    # int phi_i over the surface
    scalar = fem.functionspace(msh, ("Lagrange", nodes.degree))
    ds = ufl.Measure("ds", domain=msh, subdomain_data=mesh.facet_tags)(mesh.surface_tag(surface))
    of_nodes = NodalVector(compat.form(ufl.TestFunction(scalar) * ds)).assembled()

    low, high = index_map.local_range
    mine = np.unique(facets)
    mine = mine[(mine >= low) & (mine < high)]
    weights = {
        int(g): float(w) for part in comm.allgather(list(zip(mine, of_nodes[mine - low], strict=True))) for g, w in part
    }
    return facets, weights


def _edge_vertices(X: Array, facets: np.ndarray) -> dict[int, tuple[int, int]]:
    """The two vertices of each node on an edge of six-node triangles, by its position."""
    out = {}
    for f in facets:
        for e in f[3:]:
            # the pair whose middle it is
            pairs = [(f[0], f[1]), (f[0], f[2]), (f[1], f[2])]
            away = [float(np.linalg.norm(0.5 * (X[a] + X[b]) - X[e])) for a, b in pairs]
            a, b = pairs[int(np.argmin(away))]
            out[int(e)] = (int(a), int(b))
    return out
