"""Obstacles and the shapes of contact as surfaces: boxes, balls, cylinders, half-spaces, level sets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...mechanics.contact.obstacles import Obstacle
from ...mechanics.shapes import Box, Cylinder, HalfSpace, Shape, SignedDistance, Sphere
from ...rotations import Array
from .places import Places
from .render import pyvista
from .scene_graph import MovingPoints, Piece, Role, Solid
from .solids import box, cylinder, disk, frame_of, in_space, rectangle, ring, sphere

CELLS = {2: 120, 3: 44}  # along the longest edge of the box


def region(distance: Callable[[Array], Array], low: Array, high: Array) -> Solid:
    """{x: distance(x) < 0} within a box: filled in the plane, its surface in space; ``distance`` (n, d) -> (n,).

    Of the function's values on a regular grid, between which it counts as linear.
    """
    d, size = len(low), high - low
    counts = np.maximum(np.ceil(CELLS[d] * size / size.max()).astype(int), 1)
    flat = np.ones(3 - d)
    grid = pyvista().ImageData(
        dimensions=np.append(counts + 1, flat).astype(int),
        spacing=np.append(size / counts, flat),
        origin=np.append(low, 0.0 * flat),
    )
    grid["distance"] = distance(np.asarray(grid.points)[:, :d])
    inside = grid.contour([0.0], "distance") if d == 3 else grid.clip_scalar("distance").extract_surface()
    return Solid(np.asarray(inside.points, dtype=float), inside.triangulate().faces.reshape(-1, 4)[:, 1:])


Bounds = tuple[Array, Array]
UNBOUNDED = (-np.ones(3), np.ones(3))


def shape_solid(shape: Shape, dim: int, bounds: Bounds = UNBOUNDED) -> Solid:
    """The surface of a shape in its own axes; ``bounds`` cut off what is infinite or given by a function."""
    if isinstance(shape, Box):
        solid = rectangle(_sized(shape.size)) if dim == 2 else box(_sized(shape.size))
        axes = np.eye(3)
        axes[:dim, :dim] = shape.axes
        return solid.moved(_point(shape.center), axes)
    if isinstance(shape, Sphere):
        return _ball(shape, dim).moved(_point(shape.center))

    reach = float(np.linalg.norm(bounds[1] - bounds[0]))
    if isinstance(shape, Cylinder):
        length = shape.length if np.isfinite(shape.length) else 1.5 * reach
        return cylinder(shape.radius, length, np.asarray(shape.axis, dtype=float)).moved(_point(shape.center))
    if isinstance(shape, HalfSpace):
        return _half_space(shape, dim, bounds)
    return _level_set(shape, dim, bounds)


def _point(center: Any) -> Array:
    return in_space(np.asarray(center, dtype=float)[None])[0]


def _sized(size: Any) -> Any:
    return np.asarray(size, dtype=float)


def _ball(shape: Sphere, dim: int) -> Solid:
    """A ball or disk; a hollow shows its circle, in space three of them."""
    if not shape.inside:
        return disk(shape.radius) if dim == 2 else sphere(shape.radius)
    one = ring(shape.radius)
    if dim == 2:
        return one
    from .scene_graph import joined

    turned = [one.moved(np.zeros(3), np.roll(np.eye(3), k, axis=0)) for k in range(3)]
    return joined(turned)


def _half_space(shape: HalfSpace, dim: int, bounds: Bounds) -> Solid:
    """A plate whose upper side lies in the plane, as wide as the scene."""
    n = np.zeros(3)
    n[: len(shape.normal)] = np.asarray(shape.normal, dtype=float)
    n /= np.linalg.norm(n)
    middle = 0.5 * (bounds[0] + bounds[1])
    reach = float(np.linalg.norm(bounds[1] - bounds[0]))
    middle = middle - ((middle - _point(shape.point)) @ n) * n  # its foot in the plane
    depth = 0.04 * reach

    if dim == 2:
        along = np.array([n[1], -n[0], 0.0])
        plate = rectangle((1.1 * reach, depth))
        return plate.moved(middle - 0.5 * depth * n, np.stack((along, n, np.eye(3)[2]), axis=1))
    return box((1.1 * reach, 1.1 * reach, depth)).moved(middle - 0.5 * depth * n, frame_of(n))


def _level_set(shape: Shape, dim: int, bounds: Bounds) -> Solid:
    grown = 0.15 * (bounds[1] - bounds[0])[:dim]
    low = bounds[0][:dim] - grown
    high = bounds[1][:dim] + grown
    # a flat box would hold no grid
    thin = 0.05 * float((high - low).max())
    low, high = np.where(high - low < thin, low - thin, low), np.where(high - low < thin, high + thin, high)

    def distance(y: Array) -> Array:
        return shape.values(y) if isinstance(shape, SignedDistance) else shape.evaluate(y)[0]

    return region(distance, low, high)


def obstacle_pieces(at: Places, bounds: Bounds) -> list[Piece]:
    """Obstacles at rest or moved by a prescription; those that a rigid body carries belong to the body."""
    d = at.run.system.motions.dim
    drawn: dict[int, Piece] = {}
    for contact in at.run.scene.contacts.values():
        obstacle = contact.master
        if not isinstance(obstacle, Obstacle) or obstacle.on is not None or id(obstacle) in drawn:
            continue
        origin, matrix = _motion(obstacle, at, d)
        reach = 0.5 * (bounds[1] - bounds[0])
        own = bounds if obstacle.motion is None else (-reach, reach)
        solid = shape_solid(obstacle.shape, d, own)
        motion = MovingPoints(solid.points, origin, matrix)
        drawn[id(obstacle)] = Piece(obstacle.name, Role.OBSTACLE, solid.triangles, solid.edges, motion)
    return list(drawn.values())


def _motion(obstacle: Obstacle, at: Places, d: int) -> tuple[Array, Array]:
    """Origin (instants, 3) and axes (instants, 3, 3) of an obstacle."""
    origin = np.zeros((at.count, 3))
    matrix = np.tile(np.eye(3), (at.count, 1, 1))
    if obstacle.motion is None:
        return origin, matrix
    for k, state in enumerate(at.states):
        x, R = obstacle.motion(state.t)
        origin[k, :d] = np.asarray(x, dtype=float)[:d]
        if d == 2:
            c, s = np.cos(float(R)), np.sin(float(R))
            R = np.array([[c, -s], [s, c]])
        matrix[k, :d, :d] = R
    return origin, matrix
