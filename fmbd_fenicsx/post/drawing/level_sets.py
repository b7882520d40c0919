"""The region where a function is negative, as triangles: how obstacles given by a signed distance are drawn.

A box is cut into simplices, the function taken at their corners and interpolated: marching triangles and tetrahedra.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import numpy as np

from ...rotations import Array
from .scene_graph import Solid
from .solids import in_space

CELLS = {2: 120, 3: 44}  # along the longest edge of the box


def region(distance: Callable[[Array], Array], low: Array, high: Array) -> Solid:
    """{x: distance(x) < 0} within a box: filled in the plane, its surface in space; ``distance`` (n, d) -> (n,)."""
    points, simplices = _grid(low, high)
    phi = distance(points)
    order = np.argsort(phi[simplices], axis=1)  # the most negative corner first
    sorted_simplices = np.take_along_axis(simplices, order, axis=1)
    inside = (phi[sorted_simplices] < 0).sum(1)

    d = points.shape[1]
    corners = [_cut(points, phi, sorted_simplices[inside == n], n) for n in range(1, d + 1)]
    if d == 2:
        corners.append(points[simplices[inside == 3]])
    found = np.concatenate(corners) if corners else np.zeros((0, 3, d))
    return Solid(in_space(found.reshape(-1, d)), np.arange(3 * len(found)).reshape(-1, 3))


def _grid(low: Array, high: Array) -> tuple[Array, np.ndarray]:
    """Points of a regular grid and the simplices of its cells (Kuhn's)."""
    d, size = len(low), high - low
    counts = np.maximum(np.ceil(CELLS[d] * size / size.max()).astype(int), 1)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, d)
    numbers = np.arange(len(points)).reshape(counts + 1)
    cells = numbers[tuple(slice(None, -1) for _ in range(d))].ravel()
    steps = [int(np.prod((counts + 1)[k + 1 :])) for k in range(d)]

    simplices = [
        cells[:, None] + np.cumsum([0, *(steps[k] for k in path)])  # from corner to corner of a cell
        for path in permutations(range(d))
    ]
    return points, np.concatenate(simplices)


def _cut(points: Array, phi: Array, simplices: np.ndarray, n: int) -> Array:
    """Triangles (m, 3, d) of simplices of which the first n corners lie inside."""
    d = points.shape[1]

    def on(i: int, j: int) -> Array:
        """Where the function vanishes between corners i and j."""
        a, b = simplices[:, i], simplices[:, j]
        share = phi[a] / (phi[a] - phi[b])
        return np.asarray(points[a] + share[:, None] * (points[b] - points[a]))

    def corner(i: int) -> Array:
        return points[simplices[:, i]]

    if d == 2:
        if n == 1:
            return np.stack((corner(0), on(0, 1), on(0, 2)), 1)
        if n == 2:
            quad = corner(0), corner(1), on(1, 2), on(0, 2)
            return np.concatenate((np.stack(quad[:3], 1), np.stack((quad[0], *quad[2:]), 1)))
        return np.zeros((0, 3, d))
    if n == 2:
        quad = on(0, 2), on(0, 3), on(1, 3), on(1, 2)
        return np.concatenate((np.stack(quad[:3], 1), np.stack((quad[0], *quad[2:]), 1)))
    alone, others = (0, (1, 2, 3)) if n == 1 else (3, (0, 1, 2))
    return np.stack([on(alone, j) if n == 1 else on(j, alone) for j in others], 1)
