"""Volumes of the cells of a deformed field: a cell below zero is turned inside out.

Energies of C = F^T F do not see it: St Venant-Kirchhoff bodies, or any in a mirror, may rest in such a shape.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rotations import Array

TOGETHER = 4096  # cells


def least_volume(field: Any, U: Array) -> float:
    """The smallest volume of a cell at displacements U (n d,) of a nonlinear field over its volume at rest; collective.

    X and U are of one space, which holds linear functions: volumes are integrals of the Jacobians of both, by a rule of twice
    its degree.
    """
    import basix

    element = field.space.element.basix_element
    points, weights = basix.make_quadrature(element.cell_type, 2 * element.embedded_subdegree)
    slopes = element.tabulate(1, points)[1:, :, :, 0]  # (d, q, k)

    x = field.space.tabulate_dof_coordinates()[:, : field.dim]
    field.place(U)
    u = field.argument.x.array.reshape(x.shape)
    smallest = np.inf
    for cells in np.array_split(field.space.dofmap.list, 1 + len(field.space.dofmap.list) // TOGETHER):
        at_rest, deformed = (
            np.linalg.det(np.einsum("ckx,iqk->cqxi", places[cells], slopes, optimize=True)) @ weights
            for places in (x, x + u)
        )
        smallest = np.min(deformed / at_rest, initial=smallest)
    return float(min(field.comm.allgather(smallest)))
