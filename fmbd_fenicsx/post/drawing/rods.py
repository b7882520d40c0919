"""What a rod looks like: its section along the deformed curve."""

from __future__ import annotations

import numpy as np

from ...mechanics.rods.rods import Rod, node_name
from ...mechanics.rods.skin import skin
from ...rotations import Array
from .bodies import THINNEST, pieces_of
from .places import Places
from .scene_graph import Deforming, Piece, Role
from .view import Paint


@pieces_of.register
def _rod(body: Rod, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    rings = np.array([skin(body, _poses(body, at, k)) for k in range(at.count)])  # (instants, n, corners, 3)
    _, n, corners, _ = rings.shape

    # a cable of millimetres in a scene of metres would be thinner than a pixel
    middle = rings.mean(axis=2, keepdims=True)
    radius = float(np.linalg.norm(rings - middle, axis=-1).max())
    rings = middle + max(1.0, THINNEST * symbol / radius) * (rings - middle)
    triangles, edges = _tube(n, corners)

    return [Piece(body.name, Role.BODY, triangles, edges, Deforming(rings.reshape(at.count, -1, 3)))]


def _poses(body: Rod, at: Places, k: int) -> Array:
    """Poses of the nodes (nodes, 7) at an instant."""
    s = at.run.system
    first = s.frame_names.index(node_name(body.name, 0))

    return s.poses(at.states[k].q)[first : first + len(body.nodes)]


def _tube(n: int, corners: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles between n rings and over both ends, and the edges of the end rings."""
    i, j = (x.ravel() for x in np.meshgrid(np.arange(n - 1), np.arange(corners), indexing="ij"))
    a = i * corners + j
    b = i * corners + (j + 1) % corners
    sides = np.concatenate((np.column_stack((a, b, b + corners)), np.column_stack((a, b + corners, a + corners))))

    # fans over the ends
    fan = np.array([(0, m, m + 1) for m in range(1, corners - 1)], dtype=int).reshape(-1, 3)
    last = (n - 1) * corners
    ring = np.column_stack((np.arange(corners), np.roll(np.arange(corners), -1)))
    return np.concatenate((sides, fan[:, ::-1], last + fan)), np.concatenate((ring, last + ring))
