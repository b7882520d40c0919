"""Joints with their axes, drives, springs, dampers, wheels, and the ground where something is held by it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...mechanics.forces.forces import CoordinateForce, Spring, Tyre
from ...mechanics.joints.drives import Coupling
from ...mechanics.joints.joints import Joint, ground
from ...rotations import Array
from .places import Places
from .scene_graph import Deforming, MovingPoints, Piece, Role, Solid
from .solids import (
    box,
    carried_on,
    coil,
    cylinder,
    dashpot,
    disk,
    frame_of,
    polygon,
    rectangle,
    ring,
    sphere,
    turn_arrow,
    zigzag,
)

ACROSS = 1.1  # radius of springs, in symbols
STANDING = ("revolute", "spherical", "universal", "fixed")  # joints that stand on the ground; others slide over it
STRAIGHT = np.eye(3)[0]


def connection_pieces(at: Places, symbol: float, up: Array) -> list[Piece]:
    """Pieces of all joints and force elements; ``symbol`` (m) is their size."""
    scene = at.run.scene
    pieces: list[Piece] = []

    for joint in scene.joints.values():
        if isinstance(joint, Coupling):
            pieces += _drive(joint, at, symbol)
        else:
            pieces += _joint(joint, at, symbol, up)

    for force in scene.forces.values():
        if isinstance(force, Spring):
            pieces += _spring(force, at, symbol, up)
        elif isinstance(force, CoordinateForce):
            pieces += _on_coordinate(force, at, symbol)
        elif isinstance(force, Tyre):
            pieces += _wheel(force, at)
    return pieces


# -- joints ------------------------------------------------------------------------------------------------------
def _joint(joint: Joint, at: Places, symbol: float, up: Array) -> list[Piece]:
    a, b = at.joint(joint.name)
    x, turns = at.markers, at.turns
    if joint.kind == "distance":
        return [_rod(joint.name, x[:, a], x[:, b])]
    if joint.kind in ("drive", "own"):
        return []

    # the symbol sits at b and turns with a, in which the axes of joints are fixed
    solid = _symbol(joint, at.run.system.motions.dim, symbol)
    pieces = [_piece(joint.name, Role.JOINT, solid, x[:, b], turns[:, a])]
    if ground in (joint.a, joint.b) and joint.kind in STANDING:
        held = x[:, a] if joint.a is ground else x[:, b]
        pieces.append(_foot(f"ground at {joint.name}", held, symbol, up, at.run.system.motions.dim))
    return pieces


def _symbol(joint: Joint, dim: int, r: float) -> Solid:
    """Pins are round, sliders long along their axis, welds square."""
    axis = np.zeros(3)
    if joint.axis is not None:
        axis[: len(joint.axis)] = joint.axis

    if dim == 2:
        if joint.kind in ("prismatic", "point on line"):
            return rectangle((4.5 * r, 1.6 * r)).moved(np.zeros(3), _plane_axes(axis))
        return rectangle((1.6 * r, 1.6 * r)) if joint.kind == "fixed" else disk(0.8 * r, 24)

    # in space, along the axis
    if joint.kind == "revolute":
        return cylinder(0.8 * r, 4.0 * r, axis)
    if joint.kind == "cylindrical":
        return cylinder(0.5 * r, 8.0 * r, axis)
    if joint.kind == "planar":
        return cylinder(3.0 * r, 0.3 * r, axis)
    if joint.kind in ("prismatic", "point on line"):
        return box((1.4 * r, 1.4 * r, 6.0 * r)).moved(np.zeros(3), frame_of(axis))
    return box((1.5 * r,) * 3) if joint.kind == "fixed" else sphere(r)


def _plane_axes(axis: Array) -> Array:
    """Columns: an axis of the plane, the direction across, z."""
    e = axis / np.linalg.norm(axis)

    return np.array([[e[0], -e[1], 0.0], [e[1], e[0], 0.0], [0.0, 0.0, 1.0]])


def _rod(name: str, start: Array, end: Array) -> Piece:
    """A line between two moving points (instants, 3)."""
    motion = Deforming(np.stack((start, end), axis=1))

    return Piece(name, Role.WIRE, np.zeros((0, 3), dtype=int), np.array([[0, 1]]), motion)


def _foot(name: str, x: Array, r: float, up: Array, dim: int) -> Piece:
    """The ground under a point: a triangle in the plane, a cone in space."""
    if dim == 2:
        solid = polygon(r * np.array([(0.0, 0.0), (-1.7, -2.6), (1.7, -2.6)]))
        return _piece(name, Role.GROUND, solid, x, np.tile(np.eye(3), (len(x), 1, 1)))
    from .solids import swept

    cone = swept(np.array([np.zeros(3), -3.0 * r * up]), np.array([0.2 * r, 2.0 * r]), 20)
    return _piece(name, Role.GROUND, cone, x, np.tile(np.eye(3), (len(x), 1, 1)))


def _drive(joint: Coupling, at: Places, symbol: float) -> list[Piece]:
    """An arrow about or along the first coordinate of a drive; gears, screws and couplings show through the joints that they
    couple.
    """
    if joint.kind != "drive":
        return []
    return _effort_mark(joint.name, joint.terms[0][0], at, symbol)


def _effort_mark(name: str, coordinate: Any, at: Places, symbol: float) -> list[Piece]:
    if coordinate.joint.name not in at.run.scene.joints or not coordinate.kind.angular:
        return []
    a, b = at.joint(coordinate.joint.name)
    solid = turn_arrow(2.4 * symbol)
    axis = coordinate.joint.axis
    if axis is not None and len(axis) == 3 and at.run.system.motions.dim == 3:
        solid = solid.moved(np.zeros(3), frame_of(axis))
    return [_piece(name, Role.DRIVE, solid, at.markers[:, b], at.turns[:, a])]


# -- force elements ----------------------------------------------------------------------------------------------
def _spring(force: Spring, at: Places, symbol: float, up: Array) -> list[Piece]:
    a, b = at.force(force.name)
    start, end = at.markers[:, a], at.markers[:, b]
    dim = at.run.system.motions.dim
    pieces = []
    if force.stiffness or force.law is not None:
        pieces.append(_coiled(force.name, start, end, (ACROSS * symbol, dim)))
    if force.damping:
        pieces.append(_between(f"{force.name}, damper", dashpot(), start, end, 0.55 * symbol))
    for side, x in ((force.a, start), (force.b, end)):
        if side is ground:
            pieces.append(_foot(f"ground at {force.name}", x, 0.8 * symbol, up, dim))
    return pieces


def _on_coordinate(force: CoordinateForce, at: Places, symbol: float) -> list[Piece]:
    """A spiral at a hinge, a spring along a slider, an arrow for an effort; on a sum, at the joint of its first term."""
    on = force.on.coordinates[0]
    joint = on.joint
    if joint.name not in at.run.scene.joints:
        return []
    if force.law is not None and not force.stiffness and not force.damping:
        return _effort_mark(force.name, on, at, symbol)
    a, b = at.joint(joint.name)
    if not on.kind.angular:
        return [_coiled(force.name, at.markers[:, a], at.markers[:, b], (symbol, at.run.system.motions.dim))]

    angle = np.linspace(0, 5 * np.pi, 90)
    radius = symbol * np.linspace(0.9, 2.6, 90)
    path = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.zeros(90)))
    chain = np.column_stack((np.arange(89), np.arange(1, 90)))
    solid = Solid(path, np.zeros((0, 3), dtype=int), chain)
    if at.run.system.motions.dim == 3 and joint.axis is not None:
        solid = solid.moved(np.zeros(3), frame_of(joint.axis))
    return [_piece(force.name, Role.SPRING, solid, at.markers[:, b], at.turns[:, a])]


def _coiled(name: str, start: Array, end: Array, form: tuple[float, int]) -> Piece:
    """A spring between two moving points; ``form``: its radius (m) and the dimension of the scene."""
    radius, dim = form
    length = float(np.linalg.norm(end[0] - start[0]))
    solid = zigzag() if dim == 2 else coil(max(length / radius, 1.0))

    return _between(name, solid, start, end, radius)


def _between(name: str, solid: Solid, start: Array, end: Array, radius: float) -> Piece:
    """A solid along (0 ... 1, 0, 0) stretched from one moving point to the other."""
    return Piece(
        name, Role.SPRING, solid.triangles, solid.edges, MovingPoints(solid.points, start, stretch(start, end, radius))
    )


def stretch(start: Array, end: Array, radius: float) -> Array:
    """Matrices (instants, 3, 3) that take (1, 0, 0) to end - start and have the given size across."""
    out = np.zeros((len(start), 3, 3))
    first = (end - start)[0]
    across = np.array([-first[1], first[0], 0.0])  # in the plane it stays in the plane
    for k in range(len(start)):
        along = end[k] - start[k]
        length = np.linalg.norm(along)
        if length == 0:
            continue
        e = np.asarray(along / length)

        # the direction across is carried on from instant to instant, so that a coil does not spin
        across = carried_on(across, e)
        out[k] = np.stack((along, radius * across, radius * np.cross(e, across)), axis=1)
    return out


def _wheel(force: Tyre, at: Places) -> list[Piece]:
    """The circle of a wheel about its centre, and in the plane the road below it."""
    a, _ = at.force(force.name)
    centre = at.markers[:, a]
    d = at.run.system.motions.dim
    circle = ring(force.radius)
    if d == 3:
        circle = circle.moved(np.zeros(3), frame_of(np.asarray(np.cross(np.asarray(force.up, dtype=float), STRAIGHT))))
    pieces = [_piece(force.name, Role.JOINT, circle, centre, np.tile(np.eye(3), (at.count, 1, 1)))]
    if d == 2:
        pieces.append(_road(force, at, centre))
    return pieces


def _road(force: Tyre, at: Places, centre: Array) -> Piece:
    """The road's profile four radii to both sides of a wheel, at each instant."""
    up = np.asarray(force.up, dtype=float)[:2]
    along = np.array([up[1], -up[0]])
    s = force.radius * np.linspace(-4, 4, 81)
    x = np.zeros((at.count, len(s), 3))
    for k, state in enumerate(at.states):
        foot = centre[k, :2] - (centre[k, :2] @ up) * up
        points = foot + s[:, None] * along
        heights = np.array([float(force.road(p, state.t)) for p in points])
        x[k, :, :2] = points + heights[:, None] * up
    chain = np.column_stack((np.arange(80), np.arange(1, 81)))
    return Piece(f"road under {force.name}", Role.OBSTACLE, np.zeros((0, 3), dtype=int), chain, Deforming(x))


def _piece(name: str, role: Role, solid: Solid, origin: Array, matrix: Array) -> Piece:
    return Piece(name, role, solid.triangles, solid.edges, MovingPoints(solid.points, origin, matrix))
