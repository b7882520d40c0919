"""Surfaces of simple solids as triangles: what bodies without a mesh, joints, springs, obstacles and arrows look like."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...mechanics.joints.joints import basis
from ...rotations import Array
from .scene_graph import Solid, joined

AROUND = 24  # corners of a circle


def frame_of(axis: Array) -> Array:
    """Columns: two directions across an axis, and the axis (3, 3)."""
    return basis(np.asarray(axis, dtype=float)).T


def in_space(x: Array) -> Array:
    """Points (n, 2) or (n, 3) as (n, 3)."""
    x = np.asarray(x, dtype=float)
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def loop(n: int) -> np.ndarray:
    """Edges between n points in a circle."""
    return np.column_stack((np.arange(n), np.roll(np.arange(n), -1)))


def walls(n: int, corners: int) -> np.ndarray:
    """Triangles between n rings of so many corners: quads between neighbours, each as two."""
    i, j = np.indices((n - 1, corners)).reshape(2, -1)
    a, b = i * corners + j, i * corners + (j + 1) % corners
    return np.concatenate((np.column_stack((a, b, b + corners)), np.column_stack((a, b + corners, a + corners))))


def polygon(corners: Array) -> Solid:
    """A convex polygon of the plane, its corners (n, 2) in order."""
    n = len(corners)
    fan = np.array([[0, i, i + 1] for i in range(1, n - 1)], dtype=int).reshape(-1, 3)

    return Solid(in_space(corners), fan, loop(n))


def disk(radius: float, corners: int = 2 * AROUND) -> Solid:
    """A disk of the plane about the origin."""
    angle = 2 * np.pi * np.arange(corners) / corners

    return polygon(radius * np.column_stack((np.cos(angle), np.sin(angle))))


def ring(radius: float) -> Solid:
    """A circle of the plane about the origin, its edge alone."""
    whole = disk(radius, 3 * AROUND)

    return Solid(whole.points, np.zeros((0, 3), dtype=int), whole.edges)


def rectangle(size: Sequence[float]) -> Solid:
    """A rectangle of the plane about the origin."""
    half = np.asarray(size, dtype=float)[:2] / 2

    return polygon(half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]))


def box(size: Sequence[float]) -> Solid:
    """A box about the origin with edges along the axes."""
    signs = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]

    return Solid(signs * np.asarray(size, dtype=float) / 2, np.array(triangles), np.array(edges))


def swept(path: Array, radius: Array | float, sides: int = 12) -> Solid:
    """A round tube along a path (n, 3) with the given radius at each of its points, ends closed."""
    path = np.asarray(path, dtype=float)
    n = len(path)
    radii = np.broadcast_to(np.asarray(radius, dtype=float), (n,))
    directions = np.gradient(path, axis=0) if n > 2 else np.repeat(np.diff(path, axis=0), 2, axis=0)
    angle = 2 * np.pi * np.arange(sides) / sides

    rings = []
    across = frame_of(directions[0] if np.linalg.norm(directions[0]) else np.eye(3)[2])[:, 0]
    for x, e, r in zip(path, directions, radii, strict=True):
        length = np.linalg.norm(e)
        e = e / length if length else np.eye(3)[2]

        # carried along the path, so that the tube does not twist
        across = carried_on(across, e)
        other = np.cross(e, across)
        rings.append(x + r * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other))

    # fans about the middles of both ends
    first, last = n * sides, n * sides + 1
    caps = [np.column_stack((np.full(sides, first), loop(sides)[:, ::-1]))]
    caps.append(np.column_stack((np.full(sides, last), loop(sides) + (n - 1) * sides)))

    return Solid(np.concatenate((*rings, path[[0, -1]])), np.concatenate((walls(n, sides), *caps)))


def carried_on(across: Array, e: Array) -> Array:
    """A unit vector across the direction e, as near as it can be to the one that was ``across`` a direction before."""
    across = across - (across @ e) * e
    size = np.linalg.norm(across)
    return across / size if size > 1e-9 else frame_of(e)[:, 0]


def cylinder(radius: float, length: float, axis: Sequence[float] | Array) -> Solid:
    """A cylinder about the origin along an axis, with the edges of its rims."""
    e = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    tube = swept(np.array([-0.5 * length * e, 0.5 * length * e]), radius, AROUND)

    return Solid(tube.points, tube.triangles, np.concatenate((loop(AROUND), loop(AROUND) + AROUND)))


def sphere(radius: float, rings: int = 14) -> Solid:
    """A sphere about the origin."""
    angle = np.linspace(0, np.pi, rings + 1)
    path = np.column_stack((np.zeros((rings + 1, 2)), -radius * np.cos(angle)))

    return swept(path, radius * np.sin(angle), AROUND)


def hull(points: Array) -> Solid:
    """The convex hull of points in the plane or in space; their segments or themselves where they span less."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):  # fewer points than a triangle or tetrahedron, or all on one line
        chain = np.column_stack((np.arange(len(points) - 1), np.arange(1, len(points))))
        return Solid(in_space(points), np.zeros((0, 3), dtype=int), chain)

    if points.shape[1] == 2:
        return polygon(points[found.vertices])

    sides = np.sort(found.simplices[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    return Solid(points, found.simplices, _creases(points, found.simplices, sides))


def _creases(points: Array, triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Sides of triangles at which the surface has an edge of more than 20 degrees."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]

    owners: dict[tuple[int, int], list[int]] = {}
    for number, (p, q) in enumerate(sides):
        owners.setdefault((int(min(p, q)), int(max(p, q))), []).append(number // 3)

    def sharp(pair: list[int]) -> bool:
        return len(pair) != 2 or abs(float(normal[pair[0]] @ normal[pair[1]])) < np.cos(np.pi / 9)

    # also sides of one triangle alone: borders
    return np.array([side for side, pair in owners.items() if sharp(pair)], dtype=int).reshape(-1, 2)


def arrow(radius: float) -> Solid:
    """An arrow from the origin to (1, 0, 0): stretched by a motion; ``radius`` of its shaft across."""
    path = np.array([(0.0, 0, 0), (0.78, 0, 0), (0.78, 0, 0), (1.0, 0, 0)])

    return swept(path, np.array([1.0, 1.0, 2.6, 0.0]) * radius, 10)


def coil(slenderness: float) -> Solid:
    """A helical spring along (0 ... 1, 0, 0) with straight ends; radius 1 across, where it is stretched to ``slenderness`` the
    wire is round.
    """
    turns, wire = 7, 0.14
    s = np.linspace(0.0, 1.0, 14 * turns + 1)
    phase = 2 * np.pi * turns * s
    body = np.column_stack((0.12 + 0.76 * s, np.cos(phase), np.sin(phase)))
    path = np.concatenate(([(0.0, 0, 0), (0.12, 0, 0)], body, [(0.88, 0, 0), (1.0, 0, 0)]))
    longer = np.array([slenderness, 1.0, 1.0])
    # swept where it is stretched, so that the wire is round there
    true = swept(path * longer, wire, 6)

    return Solid(np.asarray(true.points / longer, dtype=float), true.triangles)


def zigzag() -> Solid:
    """A spring of the plane along (0 ... 1, 0, 0), radius 1 across, as a line."""
    teeth = [(0.15 + 0.07 * (k + 0.5), 1.0 - 2.0 * (k % 2), 0.0) for k in range(10)]
    path: Array = np.array([(0.0, 0, 0), (0.15, 0, 0), *teeth, (0.85, 0, 0), (1.0, 0, 0)], dtype=float)
    chain = np.column_stack((np.arange(len(path) - 1), np.arange(1, len(path))))

    return Solid(path, np.zeros((0, 3), dtype=int), chain)


def dashpot() -> Solid:
    """A damper along (0 ... 1, 0, 0): a pot and a piston rod; radius 1 across."""
    pot = swept(np.array([(0.3, 0, 0), (0.62, 0, 0)]), 0.8, 12)
    rods = [swept(np.array([(a, 0.0, 0), (b, 0, 0)]), 0.22, 8) for a, b in ((0.0, 0.3), (0.62, 1.0))]

    return joined([pot, *rods])


def turn_arrow(radius: float) -> Solid:
    """Three quarters of a circle about z with an arrow head: something turns."""
    angle = np.linspace(-0.25 * np.pi, 1.25 * np.pi, 40)
    path = radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(40)))
    # the head points along the tangent
    tip = path[-1] + 0.55 * radius * np.array([-np.sin(angle[-1]), np.cos(angle[-1]), 0.0])
    head = swept(np.array([path[-1], tip]), np.array([0.22, 0.0]) * radius, 10)

    return joined([swept(path, 0.07 * radius, 8), head])


def read_stl(file: str | Path) -> Solid:
    """The surface of an STL file, ASCII or binary, lengths as they are in the file (m)."""
    raw = Path(file).read_bytes()
    # binary files tell their number of facets behind 80 bytes, and have 50 bytes for each
    count = int.from_bytes(raw[80:84], "little") if len(raw) >= 84 else -1

    if count >= 0 and len(raw) == 84 + 50 * count:
        facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        corners = np.frombuffer(raw[84:], facet)["corners"].reshape(-1, 3).astype(float)
    else:
        words = [line.split() for line in raw.decode("ascii", "replace").splitlines()]
        try:
            corners = np.array([w[1:4] for w in words if w[:1] == ["vertex"]], dtype=float).reshape(-1, 3)
        except ValueError as error:
            raise InputError(f"{file} is no readable STL file: a vertex has no three numbers.") from error

    if len(corners) == 0 or len(corners) % 3 or not np.isfinite(corners).all():
        raise InputError(f"{file} is no readable STL file: found {len(corners)} corners of triangles.")

    points, numbers = np.unique(corners, axis=0, return_inverse=True)
    triangles = numbers.reshape(-1, 3)
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    return Solid(points, triangles, _creases(points, triangles, sides))
