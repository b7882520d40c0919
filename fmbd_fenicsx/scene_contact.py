"""Contacts of a scene as arrays: traces, pairs, massless nodes. Loaded only by scenes that have contacts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .bodies import RigidBody, Surface
from .contact import Contact, RigidPoints
from .contact_mass import redistribute_mass
from .contact_rows import Carrier, ContactSet, ObstaclePair, Side
from .contact_shapes import Obstacle
from .contact_trace import Trace, surface_nodes
from .errors import InputError, near, require
from .rotations import Array, Motions


def check_contacts(scene: Any) -> None:
    """Every body of a contact must be in the scene."""
    for c in scene.contacts.values():
        for side in (c.slave, c.master):
            body = side.on if isinstance(side, Obstacle) else side.body
            if body is not None and scene.bodies.get(body.name) is not body:
                raise InputError(
                    f'Contact "{c.name}" refers to {side!r}, whose body is not in the scene. {near(body.name, scene.bodies)}'
                )


def contact_surfaces(scene: Any, body: Any) -> list[str]:
    """Names of the surfaces of a body that take part in contacts."""
    found: list[str] = []
    for c in scene.contacts.values():
        for side in (c.slave, c.master):
            if isinstance(side, Surface) and side.body is body and side.name not in found:
                found.append(side.name)
    return found


def make_massless(scene: Any, body: Any, field: Any) -> None:
    """Take the inertia off the nodes of a body that may touch as slaves; collective."""
    names = [
        c.slave.name
        for c in scene.contacts.values()
        if isinstance(c.slave, Surface) and c.slave.body is body and c.redistribute_mass
    ]
    if not names:
        return
    redistribute_mass(field, surface_nodes(field, names))


def build_contacts(scene: Any, motions: Motions, frame_of: dict[str, int], parts: list[Any]) -> ContactSet:
    """The contact set of a scene; ``frame_of`` body -> frame, ``parts`` in the system's order. Collective."""
    n_frames = len(frame_of)
    n_core = n_frames * motions.n_twist + sum(p.n for p in parts if not p.distributed)
    traces: list[Trace] = []
    number: dict[str, int] = {}
    for k, part in enumerate(parts):
        body = scene.bodies.get(part.name)
        names = [] if body is None else contact_surfaces(scene, body)
        if names:
            number[body.name] = len(traces)
            traces.append(Trace(k, part, names, part.frame < n_frames))
    pairs = tuple(_pair(c, motions, frame_of, (traces, number)) for c in scene.contacts.values())
    return ContactSet(motions, pairs, tuple(traces), n_core)


def _pair(c: Contact, m: Motions, frame_of: dict[str, int], known: tuple[list[Trace], dict[str, int]]) -> Any:
    traces, number = known
    if isinstance(c.slave, RigidPoints):
        require(not c.slave.body.locked, f'Contact "{c.name}": the slave body "{c.slave.body.name}" is locked; it cannot move.')
        side = Side(-1, None, frame_of[c.slave.body.name], c.slave.points, c.slave.radius)
    else:
        i = number[c.slave.body.name]
        side = Side(i, traces[i].surfaces[c.slave.name], traces[i].frame, np.zeros((0, m.dim)), 0.0)
    assert isinstance(c.master, Obstacle)
    return ObstaclePair(
        c.name, side, c.master.shape, _carrier(c.name, c.master, m, frame_of), c.friction, c.restitution, c.search,
        c.redistribute_mass,
    )  # fmt: skip


def _carrier(name: str, obstacle: Obstacle, m: Motions, frame_of: dict[str, int]) -> Carrier:
    """Where an obstacle sits."""
    if obstacle.motion is not None:
        return Carrier(-1, m.identity, _prescribed(obstacle, m))
    if obstacle.on is None:
        return Carrier(-1, m.identity, None)
    if not isinstance(obstacle.on, RigidBody):
        raise InputError(f'Contact "{name}": obstacle "{obstacle.name}" must be carried by a rigid body, found {obstacle.on!r}.')
    if obstacle.on.locked:
        return Carrier(-1, obstacle.on.start_pose(), None)
    return Carrier(frame_of[obstacle.on.name], m.identity, None)


def _prescribed(obstacle: Obstacle, m: Motions) -> Callable[[float], Array]:
    motion = obstacle.motion
    assert motion is not None

    def pose(t: float) -> Array:
        found = motion(t)
        require(
            isinstance(found, tuple) and len(found) == 2,
            f'Obstacle "{obstacle.name}": motion(t) must return (position, rotation), found {found!r}.',
        )
        q = m.pose(np.asarray(found[0], dtype=float)[: m.dim], found[1])
        require(bool(np.isfinite(q).all()), f'Obstacle "{obstacle.name}": motion({t:g}) is not finite.')
        return q

    return pose
