"""Trace functionals of named surfaces: the moments that joints, loads and sensors see.

For a surface Gamma with centroid c, size l and area |Gamma| the weights of the owned node i are

    T_i0 = int phi_i / |Gamma|,     T_ik = int phi_i (X_k - c_k) / (l |Gamma|),   k = 1..d.                  (1)

They act on each component of the nodal positions P (body axes): b_k = sum_i T_ik P_i.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rotations import Array


class Moments:
    """Weights (1) of one surface on the owned nodes; collective to build.

    Attributes: ``nodes`` (n_s,) owned node numbers with a weight, ``weights`` (n_s, 1 + d), ``center`` (d,) centroid in
    world coordinates of the mesh, ``area`` (m^(d-1)), ``reference`` (1 + d, d): b for U = 0.
    """

    def __init__(self, space: Any, mesh: Any, surface: str, origin: Array, n_owned: int) -> None:
        import ufl
        from dolfinx import fem, la

        from .. import dolfinx_compat as compat

        msh, d, comm = mesh.dolfinx, mesh.dim, mesh.dolfinx.comm
        tag = mesh.surface_tag(surface)
        ds = ufl.Measure("ds", domain=msh, subdomain_data=mesh.facet_tags)(tag)
        x = ufl.SpatialCoordinate(msh)
        scalar = fem.functionspace(msh, ("Lagrange", space.ufl_element().degree))
        v = ufl.TestFunction(scalar)
        one = fem.Constant(msh, 1.0)

        def integral(f: Any) -> float:
            parts = comm.allgather(fem.assemble_scalar(compat.form(f * ds)))
            return float(sum(parts))

        self.area = integral(one)
        mesh.check_area(surface, self.area)
        self.center = np.array([integral(x[k]) for k in range(d)]) / self.area
        second = sum(integral((x[k] - float(self.center[k])) ** 2) for k in range(d))
        self.length = float(np.sqrt(max(second, 0.0) / self.area)) or 1.0
        center = fem.Constant(msh, self.center)

        def weights(f: Any) -> Array:
            b = fem.assemble_vector(compat.form(f * v * ds))
            b.scatter_reverse(la.InsertMode.add)
            return b.array[:n_owned].copy()

        columns = [weights(one / self.area)]
        for k in range(d):
            columns.append(weights((x[k] - center[k]) / (self.length * self.area)))
        T = np.stack(columns, axis=1)
        self.nodes = np.flatnonzero(np.abs(T).max(axis=1) > 0)
        self.weights = T[self.nodes]
        X = space.tabulate_dof_coordinates()[:n_owned, :d][self.nodes] - origin
        self.reference = np.sum(comm.allgather(self.weights.T @ X), axis=0)
