"""Forces as arrows: applied forces, reactions, contact forces; one scale for each kind, longest a fifth of the scene."""

from __future__ import annotations

import numpy as np

from ...mechanics.forces.forces import PointForce
from ...rotations import Array
from ...system.sensors.contact import forces_of
from ...system.sensors.sensors import reaction_force
from .connections import stretch
from .places import Places
from .scene_graph import ArrowScale, MovingPoints, Piece, Role
from .solids import arrow
from .view import View

LONGEST = 0.2  # of the scene's size


def arrow_pieces(at: Places, view: View, size: float) -> tuple[list[Piece], tuple[ArrowScale, ...]]:
    """Arrows that a view asks for, and what their lengths stand for; ``size`` (m) of the scene. Collective."""
    wanted = (
        (view.forces, "applied forces", _applied),
        (view.reactions, "reactions", _reactions),
        (view.contact, "contact forces", _contacts),
    )

    pieces: list[Piece] = []
    scales: list[ArrowScale] = []
    for shade, (asked, kind, forces) in enumerate(wanted):
        found = forces(at) if asked else {}

        # arrows of a kind are measured by its largest force of all instants
        largest = max((float(np.linalg.norm(f, axis=1).max(initial=0.0)) for _, f in found.values()), default=0.0)
        if largest > 0:
            scale = ArrowScale(kind, largest, shade)
            pieces += _scaled(found, scale, size)
            scales.append(scale)

    return pieces, tuple(scales)


def _scaled(found: dict[str, tuple[Array, Array]], scale: ArrowScale, size: float) -> list[Piece]:
    """Arrows from (points, forces) by name, (instants, 3) each; the largest force is the longest arrow."""
    solid, radius = arrow(1.0), 0.006 * size
    pieces = []
    for name, (x, force) in found.items():
        matrix = stretch(x, x + LONGEST * size / scale.largest * force, radius)
        motion = MovingPoints(solid.points, x, matrix)
        pieces.append(Piece(name, Role.ARROW, solid.triangles, solid.edges, motion, shade=scale.shade))
    return pieces


def _applied(at: Places) -> dict[str, tuple[Array, Array]]:
    """Forces prescribed in time, at their points."""
    found: dict[str, tuple[Array, Array]] = {}
    d = at.run.system.motions.dim
    for force in at.run.scene.forces.values():
        if isinstance(force, PointForce):
            a, _ = at.force(force.name)
            values = np.zeros((at.count, 3))
            values[:, :d] = [np.asarray(force.law(s.t), dtype=float)[:d] for s in at.states]
            if force.follower:
                values = np.einsum("tij,tj->ti", at.turns[:, a], values)
            found[force.name] = at.markers[:, a], values
    return found


def _reactions(at: Places) -> dict[str, tuple[Array, Array]]:
    """Forces of the joints on their second bodies."""
    s = at.run.system
    d = s.motions.dim
    found: dict[str, tuple[Array, Array]] = {}
    for joint in at.run.scene.joints.values():
        if joint.coordinates:
            continue
        sensor = reaction_force(joint)
        values = np.zeros((at.count, 3))
        for k, state in enumerate(at.states):
            values[k, :d] = -sensor.read(s.at(state.t, state.q, state.v), state, -1)
        found[f"reaction of {joint.name}"] = at.markers[:, at.joint(joint.name)[1]], values
    return found


def _contacts(at: Places) -> dict[str, tuple[Array, Array]]:
    """Forces on the points that touch at some instant, where they are then."""
    if not at.run.scene.contacts:
        return {}
    d = at.run.system.motions.dim
    instants = []
    for state in at.states:
        touching = forces_of(state)
        on = np.flatnonzero(touching.normal_force > 0)
        instants.append((touching.x[on], touching.force[on]))

    # candidates come and go: arrow number i shows the i-th point that touches
    most = max((len(x) for x, _ in instants), default=0)
    found: dict[str, tuple[Array, Array]] = {}
    for i in range(most):
        x, force = np.zeros((at.count, 3)), np.zeros((at.count, 3))
        for k, (points, forces) in enumerate(instants):
            if i < len(points):
                x[k, :d], force[k, :d] = points[i], forces[i]
        found[f"contact force {i + 1}"] = x, force
    return found
