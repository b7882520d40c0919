"""What each kind of body looks like: its mesh, its line, its shape; else bars from its centre of mass to what it is joined with.

A new kind of body that wants to be seen registers a function here (:func:`pieces_of`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np

from ...fem.mesh.mesh import Mesh
from ...mechanics.bodies.beams import Beam
from ...mechanics.bodies.bodies import AbsoluteBody, FloatingBody, RigidBody
from ...mechanics.bodies.coordinates import CoordinateBody
from ...mechanics.bodies.line_body import LineBody
from ...mechanics.catenary.wires import Wires
from ...mechanics.contact.obstacles import Obstacle
from ...mechanics.reduction.craig_bampton import ReducedBody
from ...mechanics.reduction.recovery import displacement_field
from ...rotations import Array
from .obstacles import shape_solid
from .places import Places
from .scene_graph import Deforming, MovingPoints, Piece, Role, Solid, joined
from .skins import gathered_nodes, painted, skin
from .solids import disk, hull, in_space, read_stl, sphere, swept
from .view import Paint

LARGEST = 2_000_000  # triangles that are still drawn
BALL, BAR = 1.3, 0.6  # of the size of symbols: centre of mass of a body without a shape, its bars
THINNEST = 0.2  # the same: radius of a beam or rod that would be too thin to be seen


@singledispatch
def pieces_of(body: Any, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    """Pieces of a body; ``symbol`` (m) is the size of what has no size of its own. Collective."""
    return []


# -- bodies on a mesh --------------------------------------------------------------------------------------------
@pieces_of.register
def _field(body: FloatingBody | AbsoluteBody, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    s = at.run.system
    _, part = s.part(body.name)
    absolute = part.frame == s.n_frames  # displacements from the place where the mesh lies
    origins = np.tile(part.field.center, (at.count, 1)) if absolute else at.frames[:, part.frame, : s.motions.dim]

    local = [part.field.points(u) for u in at.coordinates[body.name]]
    return [_skinned(body, at, paint, (part.field.space, part.frame, origins, local))]


@pieces_of.register
def _reduced(body: ReducedBody, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    s = at.run.system
    _, part = s.part(body.name)
    found, d = body.reduction, s.motions.dim
    n = len(found.phi) // d
    X = found.space.tabulate_dof_coordinates()[:n, :d] - found.constants.center
    local = [np.asarray(X + (found.phi @ eta).reshape(n, d)) for eta in at.coordinates[body.name]]
    return [_skinned(body, at, paint, (found.space, part.frame, at.frames[:, part.frame, :d], local))]


def _skinned(body: Any, at: Places, paint: Paint | None, where: tuple[Any, int, Array, list[Array]]) -> Piece:
    """The skin of a space at o + R P, P the nodes' places in the frame's axes: ``where`` = (space, frame, o, P)."""
    space, frame, origins, local = where
    comm = space.mesh.comm
    d = at.run.system.motions.dim
    surface = skin(space)
    axes = at.axes[:, frame, :d, :d]
    nodes = [o + P @ R.T for o, R, P in zip(origins, axes, local, strict=True)]
    x = np.array([in_space(gathered_nodes(comm, own)) for own in nodes])

    values = None
    if paint is not None and (paint.bodies is None or any(b.name == body.name for b in paint.bodies)):
        fields = (displacement_field(at.run, body, state) for state in at.states)
        values = np.array([painted(u, surface, paint.quantity) for u in fields])
    return Piece(body.name, Role.BODY, surface.triangles, surface.edges, Deforming(x), values)


# -- lines -------------------------------------------------------------------------------------------------------
@pieces_of.register
def _beam(body: Beam, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    origin, axes = at.frame(body)
    d = body.dim
    line = body.centre_line()
    amplitudes = at.coordinates[body.name]
    # centre line in the frame: at rest, and by the modes
    local = line[:, :, 0] + np.einsum("ndm,tm->tnd", line[:, :, 1:], amplitudes)
    x = origin[:, None, :d] + np.einsum("tij,tnj->tni", axes[:, :d, :d], local)

    radius = max(body.section.thickness / 2, THINNEST * symbol)
    return [tube(body.name, np.array([in_space(one) for one in x]), radius)]


@pieces_of.register
def _line(body: LineBody, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    z = body.curve(at.coordinates[body.name])[:, :, :2]

    return [tube(body.name, np.array([in_space(one) for one in z]), 0.3 * symbol)]


@pieces_of.register
def _own(body: CoordinateBody, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    """Equations of a user's own have no place in space but the one that their outline gives them."""
    if body.outline is None:
        return []
    drawn = [body.outline(q) for q in at.coordinates[body.name]]
    lines = [np.array([in_space(lines[i]) for lines in drawn]) for i in range(len(drawn[0]))]

    # the scene knows no length of such a body: as thick as symbols where these are small, else by the size of what is drawn
    points = np.concatenate([line.reshape(-1, 3) for line in lines])
    radius = min(0.5 * symbol, 0.006 * float(np.linalg.norm(np.ptp(points, axis=0))))
    return [tube(body.name, bar, radius) for line in lines for bar in _bars(line)]


def _bars(line: Array) -> list[Array]:
    """A line (instants, n, 3) of few points as bars: one tube around a sharp corner would be thin there."""
    n = line.shape[1]

    return [line[:, k : k + 2] for k in range(n - 1)] if n <= 8 else [line]


def tube(name: str, path: Array, radius: float) -> Piece:
    """A tube along a moving path (instants, n, 3): beams, lines, rods."""
    solids = [swept(one, radius) for one in path]

    return Piece(name, Role.BODY, solids[0].triangles, solids[0].edges, Deforming(np.array([s.points for s in solids])))


@pieces_of.register
def _wires(body: Wires, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    """Wires one above the other, a twentieth of the span apart; droppers between them, flagged where they are slack."""
    _, part = at.run.system.part(body.name)
    field = part.field
    u = at.coordinates[body.name]
    apart = body.length / 20
    x = np.linspace(0, body.length, 4 * body.cells + 1)

    def places_at(wire: int, x: Array) -> Array:
        rows = [field.shape(wire, xi) for xi in x]
        w = np.array([[table[0] @ one[dofs] for dofs, table in rows] for one in u])
        return np.stack((np.broadcast_to(x, w.shape), w - apart * wire, np.zeros_like(w)), -1)

    pieces = []
    chain = np.column_stack((np.arange(len(x) - 1), np.arange(1, len(x))))
    nothing = np.zeros((0, 3), dtype=int)
    for wire in range(len(body.wires)):
        pieces.append(Piece(f"{body.name}, wire {wire}", Role.WIRE, nothing, chain, Deforming(places_at(wire, x))))

    slack = np.array([field.tension(one)[0] <= 0 for one in u]) if body.droppers else np.zeros((at.count, 0))
    for k, dropper in enumerate(body.droppers):
        # a dropper hangs between its wires
        ends = [places_at(wire, np.array([dropper.x])) for wire in (dropper.upper, dropper.lower)]
        motion = Deforming(np.concatenate(ends, axis=1))
        name = f"{body.name}, dropper {k + 1}"
        pieces.append(Piece(name, Role.WIRE, nothing, np.array([[0, 1]]), motion, flag=slack[:, k]))
    return pieces


# -- rigid bodies ------------------------------------------------------------------------------------------------
@pieces_of.register
def _rigid(body: RigidBody, at: Places, paint: Paint | None, symbol: float) -> list[Piece]:
    origin, axes = at.frame(body)
    solid = _given_shape(body) or _contact_shape(body, at) or _ball(BALL * symbol, body.dim)

    if body.shape is None or not _is_cad(body.shape):  # bars show where it is held, inside the shape or outside of it
        solid = _with_bars(solid, body, at, symbol)
    return [Piece(body.name, Role.BODY, solid.triangles, solid.edges, MovingPoints(solid.points, origin, axes))]


def _given_shape(body: RigidBody) -> Solid | None:
    """The body's ``shape=``, in its axes from the centre of mass."""
    if body.shape is None:
        return None
    parts = body.shape if isinstance(body.shape, list | tuple) else [body.shape]
    return joined([_one_shape(body, part) for part in parts])


def _one_shape(body: RigidBody, part: Any) -> Solid:
    if isinstance(part, str | Path):
        return read_stl(part)
    if isinstance(part, Mesh):
        return _mesh_solid(part)
    return shape_solid(part, body.dim)


def _mesh_solid(mesh: Mesh) -> Solid:
    from dolfinx import fem

    space = fem.functionspace(mesh.dolfinx, ("Lagrange", 1, (mesh.dim,)))
    surface = skin(space)
    own = space.tabulate_dof_coordinates()[: space.dofmap.index_map.size_local]
    return Solid(gathered_nodes(mesh.dolfinx.comm, own), surface.triangles, surface.edges)


def _contact_shape(body: RigidBody, at: Places) -> Solid | None:
    """What the body touches with: balls, the hull of its corners, obstacles that it carries."""
    found: list[Solid] = []
    corners: list[Array] = []
    for contact in at.run.scene.contacts.values():
        points = contact.slave
        if points.body is body:
            if points.radius > 0:
                found += [_ball(points.radius, body.dim).moved(in_space(c[None])[0]) for c in points.points]
            else:
                corners.append(points.points)

        if isinstance(contact.master, Obstacle) and contact.master.on is body:
            found.append(shape_solid(contact.master.shape, body.dim))

    if corners:
        found.append(hull(np.concatenate(corners)))
    return joined(found) if found else None


def _ball(radius: float, dim: int) -> Solid:
    return disk(radius) if dim == 2 else sphere(radius)


def _is_cad(shape: Any) -> bool:
    """Whether it is a part drawn elsewhere, which needs no bars."""
    parts = shape if isinstance(shape, list | tuple) else [shape]

    return any(isinstance(p, str | Path | Mesh) for p in parts)


def _with_bars(solid: Solid, body: RigidBody, at: Places, symbol: float) -> Solid:
    """A solid with bars from the centre of mass to every joint and spring."""
    origin, axes = at.frame(body)
    ends = [axes[0].T @ (x - origin[0]) for x in _attached(body, at)]
    arms = [e for e in ends if np.linalg.norm(e) > 1e-9 * symbol]

    return joined([solid, *(swept(np.array([np.zeros(3), e]), BAR * symbol) for e in arms)])


def _attached(body: RigidBody, at: Places) -> Sequence[Array]:
    """Where joints and springs hold the body at the first instant, world axes, (n, 3)."""
    scene = at.run.scene
    found = []
    for joint in scene.joints.values():
        if not joint.coordinates:  # a drive acts on a joint that is drawn anyway
            markers = at.joint(joint.name)
            found += [at.markers[0, m] for side, m in zip((joint.a, joint.b), markers, strict=True) if side is body]
    for force in scene.forces.values():
        if force.b is not None and force.coordinate is None:
            markers = at.force(force.name)
            found += [at.markers[0, m] for side, m in zip((force.a, force.b), markers, strict=True) if side is body]
    return found
