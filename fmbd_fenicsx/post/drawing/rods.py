"""What a rod looks like: its section along the deformed curve."""

from __future__ import annotations

import numpy as np

from ...mechanics.rods.rods import Rod, node_name
from ...mechanics.rods.strains import shape_of
from ...polynomials import lagrange_values
from ...rotations import Array, quaternion_matrix
from .bodies import THINNEST, pieces_of
from .places import Places
from .scene_graph import Deforming, Piece, Role
from .solids import loop, walls
from .view import Paint

ROUND = 12  # corners of a section without an outline
SLENDER = 0.01  # its radius over the length of the rod
PIECES = 4  # of an element


def centreline(rod: Rod, poses: Array) -> tuple[Array, Array]:
    """Places (n, 3) and rotations (n, 3, 3) along a rod whose nodes have the ``poses`` (nodes, 7), ``PIECES`` to an element."""
    nodes = shape_of(rod.degree).nodes
    xi = np.linspace(-1.0, 1.0, PIECES + 1)
    N = lagrange_values(nodes, xi)

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
    fan = np.array([(0, m, m + 1) for m in range(1, corners - 1)], dtype=int).reshape(-1, 3)  # over an end
    last = (n - 1) * corners
    triangles = np.concatenate((walls(n, corners), fan[:, ::-1], last + fan))
    return triangles, np.concatenate((loop(corners), last + loop(corners)))
