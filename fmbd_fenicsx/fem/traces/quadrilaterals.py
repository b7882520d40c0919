"""Faces of hexahedra in two halves: flat quadrilaterals, cut along a diagonal into triangles that both have all of its functions.

A quadrilateral x = x_0 + xi e_1 + eta e_2 + xi eta (a e_1 + b e_2) has functions of (xi, eta). On its half (s, t) of the triangle
x_0, x_0 + e_1, x_0 + e_2

    s = xi + a xi eta,     t = eta + b xi eta                                                                (1)

and the other half is that of the quadrilateral turned by half a turn. On parallelograms, a = b = 0, the functions are polynomials
of twice the degree on the triangles, and all integrals are exact; on others they are none, and more points are taken. Either way
they reproduce linear functions, so that no tie holds a constant strain up.
"""

from __future__ import annotations

import numpy as np

from ...rotations import Array

ROUNDOFF = 1e-12  # (a, b) of parallelograms
NEWTON = 8  # steps from the parallelogram, which converge for all convex quadrilaterals that are no triangles


def skew_of(corners: Array) -> Array:
    """(a, b) of (1), (n, 2), of flat quadrilaterals with corners (n, 4, d) in the order of a tensor product."""
    edges = np.swapaxes(corners[:, 1:3] - corners[:, :1], 1, 2)
    beyond = corners[:, 3] - corners[:, 1] - corners[:, 2] + corners[:, 0]
    skew = (np.linalg.pinv(edges) @ beyond[:, :, None])[..., 0]
    return np.where(np.abs(skew) > ROUNDOFF, skew, 0.0)


def skewing(points: Array, skew: Array) -> Array:
    """d(s, t) / d(xi, eta) at points (xi, eta) (n, q, 2): (n, q, 2, 2)."""
    return np.asarray(np.eye(2) + skew[:, None, :, None] * points[:, :, None, ::-1])


def unskewed(points: Array, skew: Array) -> Array:
    """(xi, eta) of (1) at points (s, t) (n or 1, q, 2), by Newton's method: (n, q, 2)."""
    wanted = np.broadcast_to(points, (len(skew), *points.shape[1:]))
    x = wanted.copy()
    for _ in range(NEWTON if skew.any() else 0):
        off = x + skew[:, None] * (x[..., :1] * x[..., 1:]) - wanted
        x -= np.linalg.solve(skewing(x, skew), off[..., None])[..., 0]
    return x


def half_turn(points: Array) -> np.ndarray:
    """Order of the nodes, at points (k, 2) of the unit square, after half a turn."""
    return np.asarray(np.linalg.norm(points[:, None] - (1.0 - points), axis=2).argmin(axis=0))
