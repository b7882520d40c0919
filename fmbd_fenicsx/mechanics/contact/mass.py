"""Mass redistribution: no inertia on contact nodes, so that a contact force does not oscillate.

With inertia on a node that hits an obstacle, index reduction leaves an ill-posed equation for its velocity, and
multipliers oscillate without bound under the trapezoid rule. Without it, the contact nodes follow the interior in
equilibrium and the semi-discrete problem has a Lipschitz right-hand side (Khenous, Laborde and Renard,
doi:10.1016/j.euromechsol.2008.01.001).

In the kinetic energy only, the velocity of a contact node c is replaced by a mean of its nearest nodes without
contact, and the density by rho' = rho (1 + quadratic polynomial), the small polynomial chosen to keep all moments up
to the second:

    v_c = sum_j a_cj v_j,   sum_j a_cj = 1,   a >= 0,       M' = P^T M(rho') P                              (1)
    1^T M' 1,  1^T M' X,  X^T M' X   as those of M                                                          (2)

so total mass, centre of mass and inertia are exactly those of the body (on a mesh with too few other nodes: total
mass alone, with a warning), M' is symmetric, positive on the other nodes and zero on contact nodes. The mean was
preferred to a linear extrapolation of v (which would satisfy (2) by itself) for the force of a bar on a wall: it
leaves a quarter of the oscillation behind the first shock (docs/contact.md).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...errors import MeshError
from ...log import log
from ...rotations import Array


def nearest_mean(X: Array, target: Array) -> Array:
    """Weights a (n,) with sum 1 for nodes X (n, d), by inverse fourth powers of the distance."""
    W = ((X - target) ** 2).sum(1) ** -2.0
    return W / W.sum()


def redistribute_mass(field: Any, massless: np.ndarray) -> None:
    """Replace the mass matrix of a field by (1) for the owned node numbers ``massless``; collective.

    Raises:
        MeshError: the body has too few nodes besides its contact surfaces to carry the mass.
    """
    P = _substitution(field, massless)
    M = _moments_kept(field, P)
    B = M.ptap(P)
    M.destroy()
    P.destroy()
    field.replace_mass(B)


def _substitution(field: Any, massless: np.ndarray) -> Any:
    """The matrix P of (1)."""
    from petsc4py import PETSc

    comm = field.comm
    low = field.M.getOwnershipRange()[0]
    free = np.ones(field.n, dtype=bool)
    free[massless] = False
    P = PETSc.Mat().createAIJ(field.M.getSizes(), nnz=(field.dim + 2, field.dim + 2), comm=comm)
    P.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)

    for i in np.flatnonzero(free):
        P.setValue(low + i, low + i, 1.0)
    for i, numbers, weights in _means(field, free, massless):
        P.setValues([low + i], numbers, weights)
    P.assemble()
    return P


def _means(field: Any, free: np.ndarray, massless: np.ndarray) -> Iterator[tuple[int, list[int], Array]]:
    """For each massless node of this rank, the global numbers of the nodes that its velocity is a mean of, and their weights."""
    from scipy.spatial import cKDTree

    comm = field.comm
    low = field.M.getOwnershipRange()[0]
    # nodes of all ranks that keep their mass
    donors = np.concatenate(comm.allgather(field.X_world[free])).reshape(-1, field.dim)
    numbers = np.concatenate(comm.allgather(np.flatnonzero(free) + low))
    if len(donors) <= field.dim:
        raise MeshError(
            f'Body "{field.name}": nearly all its nodes lie on contact surfaces, none is left to '
            "carry the mass. Refine the mesh, "
            "raise the degree, or use redistribute_mass=False."
        )
    if not len(massless):
        return

    tree, places = cKDTree(donors), field.X_world[massless]
    reach = tree.query(places, k=field.dim + 1)[0][:, -1] * (1 + 1e-6)  # with all that are as near
    for i, near in zip(massless, tree.query_ball_point(places, reach), strict=True):
        yield i, [int(g) for g in numbers[near]], nearest_mean(donors[near], field.X_world[i])


def _moments_kept(field: Any, P: Any) -> Any:
    """The scalar mass matrix with the density rho' that satisfies (2)."""
    density = Density(field)
    affine = [np.ones(field.n), *((field.X_world - field.center) / field.size).T]
    moved = [_applied(P, values) for values in affine]

    unit = np.eye(density.terms)
    wanted = density.moments(unit[0], affine)
    T = np.stack([density.moments(e, moved) for e in unit], axis=1)
    c, lost = _polynomial(T, wanted, density)
    if lost and field.comm.rank == 0:
        log.warning(
            'body "%s": too few nodes besides its contact surfaces; without inertia on these the '
            "mesh keeps its mass but not its %s. "
            "Refine the mesh, or use redistribute_mass=False.",
            field.name,
            lost,
        )
    return density.mass(c)


def _applied(P: Any, values: Array) -> Array:
    """P times values of this rank's nodes."""
    z, s = P.createVecs()
    z.array[:] = values
    P.mult(z, s)
    out: Array = s.array.copy()
    z.destroy()
    s.destroy()
    return out


def _polynomial(T: Array, wanted: Array, density: Density) -> tuple[Array, str]:
    """Coefficients c with T c = wanted and a positive density; as many moments as that allows, and the name of those lost."""
    unit = np.eye(len(wanted))[0]
    all_of_them, linear = len(wanted), 1 + density.dim
    for kept, lost in ((all_of_them, ""), (linear, "inertia"), (1, "centre of mass and inertia")):  # noqa: B007, used below
        c = np.zeros(len(wanted))
        c[:kept] = np.linalg.lstsq(T[:kept, :kept], wanted[:kept], rcond=1e-12)[0]
        change = np.abs(c - unit)[1:] @ density.highest[1:]
        if change < 0.95:  # the density stays positive
            break
    return c, lost


class Density:
    """rho' = rho times a quadratic polynomial in y = (X - center) / size: a sum of products of the affine functions 1, y."""

    def __init__(self, field: Any) -> None:
        import ufl
        from dolfinx import fem

        mesh = field.mesh.dolfinx
        self.field, self.dim = field, field.dim
        coordinates = range(1, self.dim + 1)
        self.pairs = [(0, 0), *((0, k) for k in coordinates), *itertools.combinations_with_replacement(coordinates, 2)]
        self.terms = len(self.pairs)

        x = ufl.SpatialCoordinate(mesh)
        affine = [1.0, *((x[k] - float(field.center[k])) / field.size for k in range(self.dim))]
        self._c = fem.Constant(mesh, np.zeros(self.terms))
        weight = sum(self._c[i] * affine[a] * affine[b] for i, (a, b) in enumerate(self.pairs))
        self._density = field.rho * weight
        self._dx = ufl.dx(domain=mesh)

        self._space = fem.functionspace(mesh, ("Lagrange", field.forms.degree))
        self._f, self._g = fem.Function(self._space), fem.Function(self._space)
        self._moment = compat.form(self._density * self._f * self._g * self._dx)

    @property
    def highest(self) -> Array:
        """Largest value of each term in a box of the body's size, (terms,)."""
        corner = np.array(list(itertools.product((-0.5, 0.5), repeat=self.dim)))
        affine = np.abs(np.c_[np.ones(len(corner)), corner])
        return np.array([affine[:, [a, b]].prod(1).max() for a, b in self.pairs])

    def moments(self, c: Array, affine: list[Array]) -> Array:
        """Integrals of rho' f_a f_b for all terms, with coefficients c and nodal values f of the affine functions; collective."""
        from dolfinx import fem

        self._c.value[:] = c
        out = np.zeros(self.terms)
        for i, (a, b) in enumerate(self.pairs):
            for function, values in ((self._f, affine[a]), (self._g, affine[b])):
                function.x.array[: self.field.n] = values
                function.x.scatter_forward()
            out[i] = fem.assemble_scalar(self._moment)
        return np.asarray(self.field.total(out))

    def mass(self, c: Array) -> Any:
        """The scalar mass matrix; collective."""
        import dolfinx.fem.petsc as fp
        import ufl

        self._c.value[:] = c
        u = ufl.TrialFunction(self._space)
        v = ufl.TestFunction(self._space)
        M = fp.assemble_matrix(compat.form(self._density * u * v * self._dx))
        M.assemble()
        return M
