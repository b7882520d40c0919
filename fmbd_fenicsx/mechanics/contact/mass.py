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
from typing import Any

import numpy as np

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
    from scipy.spatial import cKDTree

    comm = field.comm
    low = field.M.getOwnershipRange()[0]
    free = np.ones(field.n, dtype=bool)
    free[massless] = False
    donors = np.concatenate(comm.allgather(field.X_world[free])).reshape(-1, field.dim)
    numbers = np.concatenate(comm.allgather(np.flatnonzero(free) + low))
    if len(donors) <= field.dim:
        raise MeshError(
            f'Body "{field.name}": nearly all its nodes lie on contact surfaces, none is left to '
            "carry the mass. Refine the mesh, "
            "raise the degree, or use redistribute_mass=False."
        )
    tree = cKDTree(donors)
    P = PETSc.Mat().createAIJ(field.M.getSizes(), nnz=(field.dim + 2, field.dim + 2), comm=comm)
    P.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    for i in np.flatnonzero(free):
        P.setValue(low + i, low + i, 1.0)
    if len(massless):
        reach = tree.query(field.X_world[massless], k=field.dim + 1)[0][:, -1] * (1 + 1e-6)  # with all that are as near
        for i, js in zip(massless, tree.query_ball_point(field.X_world[massless], reach), strict=True):
            P.setValues([low + i], [int(g) for g in numbers[js]], nearest_mean(donors[js], field.X_world[i]))
    P.assemble()
    return P


def _moments_kept(field: Any, P: Any) -> Any:
    """The scalar mass matrix with the density rho' that satisfies (2)."""
    import dolfinx.fem.petsc as fp
    import ufl
    from dolfinx import fem

    from ... import dolfinx_compat as compat

    msh, d = field.mesh.dolfinx, field.dim
    scalar = fem.functionspace(msh, ("Lagrange", field.forms.degree))
    x = ufl.SpatialCoordinate(msh)
    y = [(x[k] - float(field.center[k])) / field.size for k in range(d)]
    pairs = [
        (0, 0),
        *((0, k) for k in range(1, d + 1)),
        *itertools.combinations_with_replacement(range(1, d + 1), 2),
    ]
    affine = [1.0, *y]
    coefficients = fem.Constant(msh, np.zeros(len(pairs)))
    weight = sum(coefficients[i] * affine[a] * affine[b] for i, (a, b) in enumerate(pairs))
    rho = fem.Constant(msh, float(field.forms.density))
    f, g = fem.Function(scalar), fem.Function(scalar)
    moment = compat.form(rho * weight * f * g * ufl.dx(domain=msh))
    nodal = [np.ones(field.n), *((field.X_world - field.center) / field.size).T]
    changed = []
    for values in nodal:
        z, s = P.createVecs()
        z.array[:] = values
        P.mult(z, s)
        changed.append(s.array.copy())
        z.destroy()
        s.destroy()

    def moments(c: Array, fields: list[Array]) -> Array:
        coefficients.value[:] = c
        out = np.zeros(len(pairs))
        for i, (a, b) in enumerate(pairs):
            for function, values in ((f, fields[a]), (g, fields[b])):
                function.x.array[: field.n] = values
                function.x.scatter_forward()
            out[i] = fem.assemble_scalar(moment)
        return np.asarray(field.total(out))

    unit = np.eye(len(pairs))
    wanted = moments(unit[0], nodal)
    T = np.stack([moments(e, changed) for e in unit], axis=1)
    corner = np.array(list(itertools.product((-0.5, 0.5), repeat=d)))
    highest = np.array([np.abs(np.c_[np.ones(len(corner)), corner])[:, [a, b]].prod(1).max() for a, b in pairs])
    for kept, lost in ((len(pairs), ""), (1 + d, "inertia"), (1, "centre of mass and inertia")):  # noqa: B007, used below
        c = np.zeros(len(pairs))
        c[:kept] = np.linalg.lstsq(T[:kept, :kept], wanted[:kept], rcond=1e-12)[0]
        if np.abs(c - unit[0])[1:] @ highest[1:] < 0.95:  # the density stays positive
            break
    if lost and field.comm.rank == 0:
        log.warning(
            'body "%s": too few nodes besides its contact surfaces; without inertia on these the '
            "mesh keeps its mass but not its %s. "
            "Refine the mesh, or use redistribute_mass=False.",
            field.name,
            lost,
        )
    coefficients.value[:] = c
    u, v = ufl.TrialFunction(scalar), ufl.TestFunction(scalar)
    M = fp.assemble_matrix(compat.form(rho * weight * u * v * ufl.dx(domain=msh)))
    M.assemble()
    return M
