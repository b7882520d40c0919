"""Trace functionals of named surfaces: the moments that joints, loads and sensors see.

For a surface Gamma with centroid c, size l and area |Gamma| the weights of the owned node i are

    T_i0 = int phi_i / |Gamma|,     T_ik = int phi_i (X_k - c_k) / (l |Gamma|),   k = 1..d.                  (1)

They act on each component of the nodal positions P (body axes): b_k = sum_i T_ik P_i.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array
from .assembly import NodalVector


class Moments:
    """Weights (1) of one surface on the owned nodes, from their scalar functions; collective to build.

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
