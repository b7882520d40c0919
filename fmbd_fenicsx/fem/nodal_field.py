"""Nodes of an elastic body, their masses and its surfaces: what a displacement field is without its elasticity.

For displacements u in V_h (Lagrange, any degree) and material points X, in body axes,

    M_ij = int rho phi_i phi_j,     Q = [M 1_k, M (e_k x X)],     J = sum X x Q                              (1)

and, for every surface in use, the moments b_0, b_k of ``mechanics.frames`` as rows T of weights on its nodes. All of it is
assembled once. Arrays hold the nodes that this rank owns; sums over all ranks are made in a fixed order, so that
replicated numbers are equal on all ranks to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..ranks import rank_sum, together
from ..rotations import Array, Motions, motions
from .assembly import NodalVector, on_components, times_columns
from .density import density_on, mean_density

if TYPE_CHECKING:
    from .elastic_forms import ElasticForms
    from .numbering import Numbering


class Moments:
    """The moments of a surface that joints, loads and sensors see; collective to build.

    For a surface Gamma with centroid c, size l and area |Gamma| the weights of the owned node i are

        T_i0 = int phi_i / |Gamma|,     T_ik = int phi_i (X_k - c_k) / (l |Gamma|),   k = 1..d.                  (2)

    They act on each component of the nodal positions P (body axes): b_k = sum_i T_ik P_i.

    Attributes: ``nodes`` (n_s,) owned node numbers with a weight, ``weights`` (n_s, 1 + d), ``center`` (d,) centroid in
    world coordinates of the mesh, ``area`` (m^(d-1)), ``reference`` (1 + d, d): b for U = 0.
    """

    def __init__(self, space: Any, mesh: Any, surface: str, origin: Array, n_owned: int) -> None:
        d, comm = mesh.dim, mesh.dolfinx.comm
        weights = Weighted(space, mesh, surface)
        axes: list[Array] = list(np.eye(d))

        # the functions phi_i add up to one
        of_one = weights(1.0, np.zeros(d))
        self.area = _total(comm, of_one)
        mesh.check_area(surface, self.area)
        self.center = np.array([_total(comm, weights(0.0, axis)) for axis in axes]) / self.area

        levers = [weights(-float(c), axis) for c, axis in zip(self.center, axes, strict=True)]
        X = space.tabulate_dof_coordinates()[:n_owned, :d]
        second = sum(_total(comm, (X[:, k] - self.center[k]) * levers[k]) for k in range(d))
        self.length = float(np.sqrt(max(second, 0.0) / self.area)) or 1.0

        T = np.stack([of_one, *(x / self.length for x in levers)], axis=1) / self.area
        self.nodes = np.flatnonzero(np.abs(T).max(axis=1) > 0)
        self.weights = T[self.nodes]
        self.reference = np.sum(comm.allgather(self.weights.T @ (X[self.nodes] - origin)), axis=0)


class Weighted:
    """int phi_i (a + b . X) over one surface, of the owned nodes: one form for all linear functions; phi_i of a scalar ``space``.
    Collective.
    """

    def __init__(self, space: Any, mesh: Any, surface: str) -> None:
        import ufl
        from dolfinx import fem

        msh = mesh.dolfinx
        ds = ufl.Measure("ds", domain=msh, subdomain_data=mesh.facet_tags)(mesh.surface_tag(surface))

        self.a, self.b = fem.Constant(msh, 0.0), fem.Constant(msh, np.zeros(mesh.dim))
        f = self.a + ufl.dot(self.b, ufl.SpatialCoordinate(msh))
        self.integrals = NodalVector(compat.form(f * ufl.TestFunction(space) * ds))

    def __call__(self, a: float, b: Array) -> Array:
        """The integrals, of each node that this rank owns."""
        self.a.value, self.b.value[:] = a, b
        return self.integrals.assembled()


def _total(comm: Any, x: Array) -> float:
    """Sum of the entries of all ranks, the same bits everywhere."""
    return float(sum(comm.allgather(float(x.sum()))))


Product = Callable[[Array], Array]


@dataclass(frozen=True)
class RigidConstants:
    """A field as a rigid body, (1): ``mass`` (kg), ``center`` (d,) and ``inertia`` about it, (n_rot, n_rot).

    ``X`` (n, d): owned nodes about the centre, ``Q`` (n d, n_twist); ``size`` (m): of the box around all nodes.
    """

    mass: float
    center: Array
    X: Array
    Q: Array
    inertia: Array
    size: float

    @classmethod
    def of(cls, x: Array, times_mass: Product, total: Product, m: Motions, comm: Any) -> RigidConstants:
        """Those of nodes at the places x (n, d), by products with M and sums over the ranks; collective."""
        n, d = x.shape
        one = times_mass(np.ones((n, d)))
        mass = float(total(np.array(one[:, 0].sum())))
        center = total((one * x).sum(0)) / mass
        X = x - center

        arms, J = m.lever(X), np.empty((m.n_rot, m.n_rot))
        Q = one[:, :1, None] * m.rigid(X)
        for k in range(m.n_rot):
            Q[:, :, d + k] = times_mass(arms[..., k])
            J[:, k] = m.moment(X, Q[:, :, d + k]).sum(0)
        return cls(mass, center, X, Q.reshape(n * d, m.n_twist), total(J), _size(x, comm))


def _size(x: Array, comm: Any) -> float:
    """The diagonal of the box around all nodes; collective."""
    n, d = x.shape
    low = comm.allgather(x.min(0) if n else np.full(d, np.inf))
    high = comm.allgather(x.max(0) if n else np.full(d, -np.inf))
    return float(np.linalg.norm(np.max(high, axis=0) - np.min(low, axis=0)))


class NodalField:
    """Nodes and inertia of one displacement field on one mesh; collective to build.

    Attributes: ``X`` (n, d) owned nodes (m, relative to the centre of mass), ``X_world`` (n, d) those of the mesh,
    ``mass_total`` (kg), ``center`` (d,), ``inertia`` (n_rot, n_rot) about the centre of mass, ``Q`` (n d, n_twist),
    ``n`` owned nodes, ``M`` the mass matrix of one component.
    """

    def __init__(self, name: str, mesh: Any, forms: ElasticForms) -> None:
        import dolfinx.fem.petsc as fp
        import ufl

        compat.check_versions()
        self.name, self.forms, self.mesh = name, forms, mesh
        self.comm = mesh.dolfinx.comm
        self.dim = d = mesh.dim
        self.motions = motions(d)

        # one numbering of nodes for displacements and for what has one component
        self.space = mesh.space(forms.degree, (d,))
        self.n = self.space.dofmap.index_map.size_local
        self.n_global = self.space.dofmap.index_map.size_global * d
        self.scalar_space = scalar = mesh.space(forms.degree)
        same = np.array_equal(self.space.dofmap.list, scalar.dofmap.list)
        together(self.comm, None if same else RuntimeError("DOLFINx numbered scalar and vector spaces differently"))

        # inertia: the same of every component
        p, q = ufl.TrialFunction(scalar), ufl.TestFunction(scalar)
        self.rho = density_on(name, mesh, forms.density)
        self.scalar_mass = compat.form(self.rho * p * q * mesh.dx)
        self.M = fp.assemble_matrix(self.scalar_mass)
        self.M.assemble()
        self._mass_matrix: Any = None
        self.redistributed = False  # whether masses were moved between nodes, see replace_mass
        self.kept_bound: tuple[int, float] | None = None  # of frequencies with a tangent: mechanics.elastic.modes
        self._of_component = [self.M.createVecRight(), self.M.createVecLeft()]
        self.known_moments: dict[str, Moments] = {}  # by surface; another field of the same body may take them
        self._rigid_properties()

    # -- inertia ------------------------------------------------------------------------------------------------
    def mass(self, A: Array) -> Array:
        """M A for nodal vectors, (n, d) -> (n, d), or for many of them side by side; collective."""
        if A.shape[1] > self.dim:
            return times_columns(self.M, A)
        x, y = self._of_component
        out = np.empty_like(A)
        for k in range(self.dim):
            x.array[:] = A[:, k]
            self.M.mult(x, y)
            out[:, k] = y.array
        return out

    def mass_columns(self, U: Array) -> Array:
        """M U for many displacements, in columns (n d, k) or by nodes (n, d, k); collective."""
        return times_columns(self.M, U.reshape(self.n, self.dim * U.shape[-1])).reshape(U.shape)

    def mass_matrix(self) -> Any:
        """The scalar mass matrix on each component of vectors (aij), which the field keeps; collective."""
        if self._mass_matrix is None:
            self._mass_matrix = on_components(self.M, self.dim)
        return self._mass_matrix

    @cached_property
    def mass_form(self) -> Any:
        """The compiled form of M on vectors."""
        import ufl

        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        return compat.form(self.rho * ufl.inner(u, v) * self.mesh.dx)

    @cached_property
    def mean_density(self) -> float:
        """Mass over volume, kg/m^3; collective."""
        return mean_density(self)

    def replace_mass(self, M: Any) -> None:
        """Use another scalar mass matrix with the same layout from now on (see ``mechanics.contact.mass``); collective."""
        for x in (self.M, self._mass_matrix):
            if x is not None:
                x.destroy()
        self.M, self._mass_matrix, self.redistributed, self.kept_bound = M, None, True, None
        self._rigid_properties()

    def _rigid_properties(self) -> None:
        """What (1) says of the field as a rigid body; collective."""
        self.X_world = self.space.tabulate_dof_coordinates()[: self.n, : self.dim]
        found = RigidConstants.of(self.X_world, self.mass, self.total, self.motions, self.comm)
        self.mass_total, self.center, self.inertia, self.size = found.mass, found.center, found.inertia, found.size
        self.X, self.Q = found.X, found.Q

    # -- nodes and surfaces -------------------------------------------------------------------------------------
    def total(self, x: Array) -> Array:
        """Sum of a rank-local contribution over the ranks."""
        return rank_sum(self.comm, x)

    def points(self, U: Array) -> Array:
        """P = X + U, (n, d)."""
        return self.X + U.reshape(-1, self.dim)

    def moments(self, surface: str) -> Moments:
        """Moments of a named surface, assembled at first use; collective."""
        known = self.known_moments
        if surface not in known:
            known[surface] = Moments(self.scalar_space, self.mesh, surface, self.center, self.n)
        return known[surface]

    @cached_property
    def numbering(self) -> Numbering | None:
        """Numbers of the nodes that do not depend on the ranks; None for fields that every rank holds whole. Collective."""
        from .numbering import Numbering

        return Numbering(self.space)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for x in (self.M, self._mass_matrix, *self._of_component):
            if x is not None:
                x.destroy()
