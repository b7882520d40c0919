"""The bodies of a scene with their frames and parts, where these stand and how they begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.bodies.bodies import ElasticBody, RigidBody, Surface
from ...mechanics.body import Placed, Site
from ...mechanics.joints.joints import ground
from ...mechanics.placements import RigidBlock
from ...mechanics.rods.elements import RodElements
from ...mechanics.rods.rods import Rod, node_name
from ...rotations import Array, Motions, motions
from ..configurations import count
from ..layout import State
from ..system import System
from .references import surfaces_in_use

if TYPE_CHECKING:
    from .scene import Scene

NARROW = 1e-3  # of a body, a surface on which it turns as on a hinge


@dataclass
class RodNodes:
    """Rods with the frames of their first nodes, in the order in which they were added."""

    rods: list[tuple[Rod, int]] = field(default_factory=list)
    elements: list[RodElements] = field(default_factory=list)

    def add(self, rod: Rod, first: int) -> dict[str, int]:
        """Take a rod whose nodes are the frames from ``first`` on; returns names of nodes -> frames."""
        self.rods.append((rod, first))
        self.elements.append(rod.elements_on(first))
        return {node_name(rod.name, i): first + i for i in range(len(rod.nodes))}

    def section(self, side: Surface) -> tuple[int, Array]:
        """Frame and pose at the start of a section."""
        first = next(first for rod, first in self.rods if rod is side.body)
        node = side.body.node_of(side.name)
        return first + node, side.body.poses[node]

    @property
    def mass(self) -> float:
        """Mass of all rods, kg."""
        return sum(float(rod.inertia[0].sum()) for rod, _ in self.rods)

    def rigid_block(self, motions: Motions, rigid: list[RigidBody], frame_of: dict[str, int]) -> RigidBlock | None:
        """Rigid bodies and the nodes of the rods, whose lumped mass moves as theirs; None without any."""
        if not rigid and not self.rods:
            return None
        frames = [frame_of[b.name] for b in rigid]
        masses = [float(b.mass) for b in rigid]
        inertias = [b.inertia_matrix for b in rigid]

        for rod, first in self.rods:
            mass, inertia = rod.inertia
            frames.extend(range(first, first + len(mass)))
            masses.extend(mass)
            inertias.extend(inertia)
        return RigidBlock(motions, np.array(frames), np.array(masses), np.array(inertias))


class PlacedBodies:
    """Frames of all moving bodies, with poses and twists at the start; parts with local coordinates, and what these begin with.

    ``used``: names of the surfaces of each body that something is attached to, which have ports.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.m: Motions = motions(scene.dim)
        self.frame_of: dict[str, int] = {}
        self._length: float | None = None
        self.poses: list[Array] = []
        self.twists: list[Array] = []
        self.part_of: dict[str, int] = {}
        self.parts: list[Any] = []
        self.starts: list[tuple[Array, Array]] = []
        self.nodes = RodNodes()
        self.used: dict[str, list[str]] = {}

    @property
    def ground_frame(self) -> int:
        """The number of the ground, behind all frames that move."""
        return len(self.poses)

    def part(self, side: Surface) -> Any:
        """The part of the elastic body that a surface is of."""
        return self.parts[self.part_of[side.body.name]]

    def add_frames(self, moving: list[Any]) -> None:
        """Poses and twists of all moving frames; those of elastic bodies follow with their parts."""
        for body in moving:
            if not body.framed:
                continue
            self.frame_of[body.name] = len(self.poses)
            self.poses.append(body.start_pose())
            self.twists.append(body.start_twist())

        for body in moving:
            # a rod has a frame for every node, behind those of the bodies
            if isinstance(body, Rod):
                self.frame_of |= self.nodes.add(body, len(self.poses))
                self.poses.extend(body.poses)
                self.twists.extend(body.start_twists())

    def add_parts(self, moving: list[Any]) -> None:
        """The parts of all bodies with local coordinates: those in the core first, then those distributed over ranks."""
        self.used, ground = surfaces_in_use(self.scene), self.ground_frame
        kinds: dict[Any, None] = dict.fromkeys(map(type, moving))
        for kind in kinds:
            kind.prepare([body for body in moving if type(body) is kind])
        for body in sorted(moving, key=lambda b: b.stage):
            frame = self.frame_of[body.name] if body.framed else ground
            # parts stand in the order of their stages: replicated ones before fields
            slides = [(s.wire, s.motion) for s in self.scene.sliders.values() if s.wires is body]
            placed = body.placed(Site(frame, ground, self.used[body.name], slides, self._field))
            if placed is not None:
                self._put_part(placed)

    def _put_part(self, placed: Placed) -> None:
        """Add a part with its local coordinates and rates at the start, and the start of its frame."""
        part = placed.part
        self.part_of[part.name] = len(self.parts)
        self.parts.append(part)
        self.starts.append((placed.q, placed.v))
        if placed.pose is not None:
            self.poses[part.frame] = placed.pose
        if placed.twist is not None:
            self.twists[part.frame] = placed.twist

    def _field(self, body: ElasticBody) -> Any:
        """The elastic field of a body, without inertia at the nodes that may touch; collective."""
        from ...fem.mixed import make_field

        made = make_field(body.name, body.mesh, body.forms())
        if self.scene.contacts:
            from .contact import make_massless

            make_massless(self.scene, body, made)
        return made

    def center(self, side: Surface) -> Array:
        """Where a surface lies at the start."""
        if isinstance(side.body, Rod):
            return self.nodes.section(side)[1][: self.m.dim]
        center: Array = self.part(side).surface_center(side.name)
        return center

    def narrow(self, side: Surface) -> float:
        """Size (m) of a surface that is hardly anything of its elastic body: it turns there as on a hinge; 0 elsewhere."""
        part = self.part(side) if side.body.meshed else None
        width = part.field.moments(side.name).length if part is not None and part.distributed else np.inf
        return width if part is not None and width < NARROW * part.size else 0.0

    def mass(self, rigid: list[RigidBody]) -> float:
        """Of all bodies, kg; ``rigid``: those that are no parts."""
        return self.nodes.mass + sum(b.mass for b in rigid) + sum(p.mass_total for p in self.parts)

    def length(self) -> float:
        """The characteristic length of the model, m, once all bodies are placed."""
        if self._length is None:
            sizes = [p.size for p in self.parts]
            self._length = model_length(self.scene, [q[: self.m.dim] for q in self.poses], sizes)
        return self._length

    def state(self, system: System) -> State:
        """The state of a system of them as given."""
        theta = np.zeros(0 if system.counted is None else system.counted.count)
        v = [*self.twists, *(ud for _, ud in self.starts)]
        # q in the order of the system: poses, counted angles, local coordinates
        start = np.concatenate([*self.poses, theta, *(u for u, _ in self.starts)])
        count(system, start)
        return State(0.0, start, np.concatenate(v), np.zeros(system.n_v), np.zeros(system.n_lam))


def model_length(scene: Scene, places: Sequence[Array], sizes: Sequence[float]) -> float:
    """How far a model spreads, m: by the ``places`` (d,) of its bodies and its joints, and the ``sizes`` of parts (m); that of
    bodies in one place otherwise.
    """
    points = list(places)
    for joint in scene.joints.values():
        points += [x for x in (joint.center_a, joint.center_b) if x is not None]
    if not points:
        points = [np.zeros(scene.dim)]

    spread = float(np.linalg.norm(np.ptp(np.array(points), axis=0)))
    return max([spread, *sizes]) or _length_about(scene, points[0])


def _length_about(scene: Scene, place: Array) -> float:
    """That of bodies in one place: how far away forces act or contact points spread, or else a radius of gyration."""
    from ...mechanics.contact.contact import RigidPoints

    d, sizes = len(place), [0.0]
    for force in scene.forces.values():
        given = (force.a, force.point_a), (force.b, force.point_b)
        ends = [np.asarray(x, dtype=float) for _, x in given if x is not None]
        between = not force.joined and force.coordinate is None
        if between and any(side is ground and x is None for side, x in given):
            ends.append(np.zeros(d))  # the ground's own, where no point of it is given
        sizes += [float(np.linalg.norm(x[:d] - place)) for x in ends]

    for c in scene.contacts.values():
        if isinstance(c.slave, RigidPoints):
            spread = np.ptp(c.slave.points, axis=0)
            sizes.append(float(np.linalg.norm(spread)) + 2 * c.slave.radius)

    radii = [0.0]
    for body in scene.bodies.values():
        if isinstance(body, RigidBody) and body.turns and body.mass > 0.0:
            radii.append(float(np.sqrt(np.abs(body.inertia).max() / body.mass)))
    return max(sizes) or max(radii) or 1.0  # 1 m where nothing has a size
