"""Contacts of a scene as arrays: traces, pairs, massless nodes. Loaded only by scenes that have contacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from ...checks import vector
from ...errors import InputError, named, near
from ...log import log
from ...mechanics.bodies.bodies import ElasticBody, RigidBody, Surface
from ...mechanics.contact.contact import Contact
from ...mechanics.contact.contact_set import ContactSet
from ...mechanics.contact.limits import LimitPair
from ...mechanics.contact.mass import redistribute_mass
from ...mechanics.contact.obstacle_pair import ObstaclePair
from ...mechanics.contact.obstacles import Obstacle
from ...mechanics.contact.pair import Carrier, Side
from ...mechanics.contact.trace import BodyNodes, ContactTrace, FieldTrace, ModalTrace, surface_nodes
from ...mechanics.joints.drives import relative_of
from ...rotations import Array, Motions


def check_contacts(scene: Any) -> None:
    """Every body of a contact, and every joint with a limit, must be in the scene."""
    for limit in scene.limits.values():
        joint = limit.coordinate.joint
        if scene.joints.get(joint.name) is not joint:
            raise InputError(f'{limit!r}: joint "{joint.name}" is not in the scene. {near(joint.name, scene.joints)}')
    for c in scene.contacts.values():
        for side in (c.slave, c.master):
            body = side.on if isinstance(side, Obstacle) else side.body
            if body is not None and scene.bodies.get(body.name) is not body:
                raise InputError(
                    f'Contact "{c.name}" takes body "{body.name}", which is not in the scene. '
                    f"{near(body.name, scene.bodies)}"
                )


def contact_surfaces(scene: Any, body: Any) -> list[str]:
    """Names of the surfaces of a body that take part in contacts, or that a joint with limits holds."""
    sides = [side for contact in scene.contacts.values() for side in (contact.slave, contact.master)]
    if isinstance(body, ElasticBody):  # limits of others act on the core
        joints = [limit.coordinate.joint for limit in scene.limits.values()]
        sides = [side for joint in joints for side in (joint.a, joint.b)] + sides
    return list(dict.fromkeys(side.name for side in sides if isinstance(side, Surface) and side.body is body))


def make_massless(scene: Any, body: Any, field: Any) -> None:
    """Take the inertia off the nodes of a body that may touch as slaves; collective."""
    names = [
        c.slave.name
        for c in map(oriented, scene.contacts.values())
        if isinstance(c.slave, Surface) and c.slave.body is body and c.redistribute_mass
    ]
    if not names:
        return
    redistribute_mass(field, surface_nodes(field, sorted(set(names))))


def build_contacts(
    scene: Any, motions: Motions, frame_of: dict[str, int], parts: list[Any], *, stops: tuple[LimitPair, ...] = ()
) -> ContactSet:
    """The contact set of a scene; ``frame_of`` body -> frame, ``parts`` in the system's order. Collective."""
    start = len(frame_of) * motions.n_twist
    amplitudes: dict[int, slice] = {}
    for k, part in enumerate(parts):
        if not part.distributed:
            amplitudes[k] = slice(start, start + part.n)
            start += part.n

    # one trace for each body, whatever its surfaces
    traces: list[ContactTrace] = []
    number: dict[str, int] = {}
    for k, part in enumerate(parts):
        body = scene.bodies.get(part.name)
        names = [] if body is None else contact_surfaces(scene, body)
        if names:
            number[body.name] = len(traces)
            traces.append(_trace(k, part, body, names, len(frame_of)))

    pairs = tuple(_pair(c, motions, frame_of, (traces, number)) for c in map(oriented, scene.contacts.values()))
    return ContactSet(motions, (*pairs, *stops), tuple(traces), amplitudes, start)


def limit_pairs(scene: Any, motions: Motions, markers: dict[str, tuple[int, int]]) -> tuple[LimitPair, ...]:
    """The stops of all joints with limits; ``markers`` of each joint by its name."""
    found = []
    for limit in scene.limits.values():
        s = limit.coordinate
        relative = relative_of(motions, s.kind, [(s, *markers[s.joint.name])])
        # a bound at infinity is none
        stops = [(bound, sign) for bound, sign in ((limit.lower, 1.0), (limit.upper, -1.0)) if np.isfinite(bound)]
        bounds, signs = np.array(stops).T
        nobody = Side(-1, None, np.zeros(0, dtype=int), np.zeros((0, motions.dim)), 0.0)
        found.append(
            LimitPair(
                limit.name, nobody, None, Carrier(-1, motions.identity, None), 0.0, limit.restitution, None,
                massless=False, bounces=True, relative=relative, bounds=bounds, signs=signs,
            )
        )  # fmt: skip
    return tuple(found)


def _trace(number: int, part: Any, body: Any, surfaces: list[str], n_frames: int) -> ContactTrace:
    """The contact nodes of an elastic body; collective."""
    if body.nodal:
        return FieldTrace(number, part, surfaces, moving=part.frame < n_frames)
    made = body.reduction
    world = made.space.tabulate_dof_coordinates()[: len(made.phi) // body.dim, : body.dim]
    nodes = BodyNodes(made.space, body.source.mesh, body.source.degree, world - made.constants.center, world)
    return ModalTrace(number, part, nodes, made.phi, surfaces)


def _pair(c: Contact, m: Motions, frame_of: dict[str, int], known: tuple[list[ContactTrace], dict[str, int]]) -> Any:
    traces, number = known
    if isinstance(c.slave, Surface):
        i = number[c.slave.body.name]
        side = Side(i, traces[i].surfaces[c.slave.name], np.zeros(0, dtype=int), np.zeros((0, m.dim)), 0.0)
    else:
        frames, points = c.slave.at(frame_of)
        side = Side(-1, None, frames, points, c.slave.radius)

    if isinstance(c.master, Surface):
        return _mortar_pair(c, side, known)
    return ObstaclePair(
        c.name, side, c.master.shape, _carrier(c.name, c.master, m, frame_of), c.friction, c.restitution, c.search,
        c.massless, c.bounces,
    )  # fmt: skip


def _mortar_pair(c: Contact, slave: Side, known: tuple[list[ContactTrace], dict[str, int]]) -> Any:
    from ...fem.traces.traces import trace_of
    from ...mechanics.contact.mortar import MortarPair

    traces, number = known
    i = number[c.master.body.name]
    master = Side(i, traces[i].surfaces[c.master.name], slave.frames, slave.points, 0.0)
    facets = tuple(
        trace_of(traces[s.trace].body_nodes.space, traces[s.trace].body_nodes.mesh, name)
        for s, name in ((slave, c.slave.name), (master, c.master.name))
    )
    return MortarPair(c.name, (slave, master), (facets[0], facets[1]), traces, c)


@lru_cache(maxsize=256)
def oriented(c: Contact) -> Contact:
    """The pair with the finer of two elastic surfaces as slave; collective."""
    if not isinstance(c.master, Surface):
        return c
    h = [_facet_size(s) for s in (c.slave, c.master)]
    if h[0] <= h[1] * (1 + 1e-9):
        return c
    log.info(
        'contact "%s": %r is the slave, its facets are smaller (%.3g m against %.3g m)', c.name, c.master, h[1], h[0]
    )
    return replace(c, slave=c.master, master=c.slave, exchanged=True)


def _facet_size(surface: Surface) -> float:
    """Mean diameter of the facets of a surface, m; collective."""
    mesh = surface.body.solid.mesh
    msh, facet = mesh.dolfinx, mesh.dim - 1
    facets = mesh.facets(surface.name)

    # those of this rank
    own = facets[facets < msh.topology.index_map(facet).size_local]
    diameters = float(msh.h(facet, own).sum()) if len(own) else 0.0

    sums, counts = zip(*msh.comm.allgather((diameters, len(own))), strict=True)
    return float(sum(sums) / max(sum(counts), 1))


def _carrier(name: str, obstacle: Obstacle, m: Motions, frame_of: dict[str, int]) -> Carrier:
    """Where an obstacle sits."""
    if obstacle.motion is not None:
        return Carrier(-1, m.identity, _prescribed(obstacle, m))
    if obstacle.on is None:
        return Carrier(-1, m.identity, None)
    if not isinstance(obstacle.on, RigidBody):
        raise InputError(
            f'Contact "{name}": obstacle "{obstacle.name}" must be carried by a rigid body, found {obstacle.on!r}.'
        )
    if obstacle.on.locked:
        return Carrier(-1, obstacle.on.start_pose(), None)
    return Carrier(frame_of[obstacle.on.name], m.identity, None)


def _prescribed(obstacle: Obstacle, m: Motions) -> Callable[[float], Array]:
    motion = obstacle.motion
    assert motion is not None
    motion = named("The motion of obstacle", obstacle.name, motion)

    # asked for some times a step: what was found is put in words where it is wrong only
    def pose(t: float) -> Array:
        found, what = motion(t), f'Obstacle "{obstacle.name}": motion({t:g})'
        if not (isinstance(found, tuple) and len(found) == 2):
            raise InputError(f"{what} must return (position, rotation), found {found!r}.")
        place = vector(f"{what}: position", found[0], size=m.dim)
        try:
            return m.pose(place, found[1])
        except InputError as error:
            raise InputError(f"{what}: {error}") from None

    return pose
