"""The skin of a rod for pictures: its section's outline carried along the interpolated curve."""

from __future__ import annotations

import numpy as np

from ...rotations import Array, quaternion_matrix
from .rods import Rod
from .strains import shape_of

ROUND = 12  # corners of a section without an outline
SLENDER = 0.01  # its radius over the length of the rod
PIECES = 4  # of an element


def centreline(rod: Rod, poses: Array) -> tuple[Array, Array]:
    """Places (n, 3) and rotations (n, 3, 3) along a rod whose nodes have the ``poses`` (nodes, 7), ``PIECES`` to an element."""
    nodes = shape_of(rod.degree).nodes
    xi = np.linspace(-1.0, 1.0, PIECES + 1)
    N = np.stack([np.prod([(xi - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes], axis=1)

    nodal = poses[rod.connectivity].copy()
    for i in range(1, nodal.shape[1]):  # quaternions of one sign within each element
        same = (nodal[:, i, 3:] * nodal[:, i - 1, 3:]).sum(-1, keepdims=True)
        nodal[:, i, 3:] *= np.where(same < 0, -1.0, 1.0)
    along = N @ nodal  # (elements, PIECES + 1, 7)
    along = np.concatenate((along[:, :-1].reshape(-1, 7), along[-1, -1:]))
    p = along[:, 3:] / np.linalg.norm(along[:, 3:], axis=-1, keepdims=True)
    return along[:, :3], quaternion_matrix(p)


def outline(rod: Rod) -> Array:
    """Corners (k, 2) of the section across the curve, m; a thin circle where the section gives none."""
    if rod.section.outline is not None:
        return np.asarray(rod.section.outline, dtype=float)
    angle = np.linspace(0.0, 2.0 * np.pi, ROUND, endpoint=False)
    return SLENDER * rod.length * np.stack((np.cos(angle), np.sin(angle)), axis=1)


def skin(rod: Rod, poses: Array) -> Array:
    """Rings (n, k, 3) of the deformed rod's surface, world axes."""
    x, R = centreline(rod, poses)
    corners = outline(rod)
    rings: Array = x[:, None] + np.einsum("kc,nac->nka", corners, R[:, :, 1:])
    return rings
