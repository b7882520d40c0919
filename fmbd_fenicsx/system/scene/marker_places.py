"""The markers of a system: where joints, forces and sensors of a scene are attached."""

from __future__ import annotations

from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from ...checks import vector
from ...mechanics.bodies.bodies import RigidBody, Surface
from ...mechanics.forces.forces import Force
from ...mechanics.frames import Markers
from ...mechanics.joints.joints import Joint, ground
from ...mechanics.rods.rods import Rod
from ...rotations import Array
from ..sensors.sensor import Sensor
from .placed_bodies import PlacedBodies
from .point_masses import at_its_place
from .references import check_side


class MarkerPlace(NamedTuple):
    """A marker with the axes of the world at the start, on a frame that starts at a pose (n_pose,): at a ``point`` (d,) of the
    world; ``surface`` of an elastic body, or None; ``body``: a rigid one that moves.
    """

    frame: int
    pose: Array
    point: Array
    surface: Surface | None = None
    body: RigidBody | None = None


class MarkerPlaces:
    """Those of ``bodies`` so far."""

    def __init__(self, bodies: PlacedBodies) -> None:
        self.bodies, self.m = bodies, bodies.m
        self.here = self.m.identity  # the pose of the ground
        self.places: list[MarkerPlace] = []

    def add(self, side: Any, point: Array | None) -> int:
        """Number of a new marker on an attachment at a world point (None: centroid or origin); world axes at the start."""
        self.places.append(self._place(side, None if point is None else np.asarray(point)[: self.m.dim]))
        return len(self.places) - 1

    def _place(self, side: Any, point: Array | None) -> MarkerPlace:
        d, here = self.m.dim, self.here
        if isinstance(side, Surface) and isinstance(side.body, Rod):
            frame, pose = self.bodies.nodes.section(side)
            return MarkerPlace(frame, pose, pose[:d] if point is None else point)
        if isinstance(side, Surface):
            # on a surface: by its centroid, and the lever of the point in the surface's own axes
            part = self.bodies.part(side)
            lever = np.zeros(d) if point is None else point - part.surface_center(side.name)
            return MarkerPlace(part.frame, here, lever, side)

        # on the ground, on a body locked to it, or on a moving one
        if side is ground:
            return MarkerPlace(self.bodies.ground_frame, here, here[:d] if point is None else point)
        if point is not None and not side.turns:
            point = at_its_place(side, point, self.bodies.length())
        if side.locked:
            return MarkerPlace(self.bodies.ground_frame, here, side.start_pose()[:d] if point is None else point)

        frame = self.bodies.frame_of[side.name]
        pose = self.bodies.poses[frame]
        return MarkerPlace(frame, pose, pose[:d] if point is None else point, body=side)

    def default_point(self, joint: Joint | Force) -> Array | None:
        """Where a joint or bushing without a center sits: the centroid of a surface, else a mass at a point, which nothing takes
        hold of elsewhere, else the origin of its moving body.
        """
        for side in (joint.a, joint.b):
            if isinstance(side, Surface):
                return self.bodies.center(side)
        bodies = [side for side in (joint.b, joint.a) if isinstance(side, RigidBody)]
        if not bodies:
            return None
        return min(bodies, key=lambda body: body.turns).start_pose()[: self.m.dim]

    def made(self) -> Markers:
        """All of them."""
        d = self.m.dim
        n, per = len(self.places), d * (1 + d)  # ports of a surface
        parts = self.bodies.parts
        begins = [0, *accumulate(part.n_port for part in parts)]
        on_surfaces, ports, is_section = [], [], []
        for i, side in enumerate(place.surface for place in self.places):
            if side is None:
                continue
            # ports of all parts stand in one array: those of the part's frame come first, then its surfaces
            k = self.bodies.part_of[side.body.name]
            first = begins[k] + parts[k].n_frame_rows
            first += self.bodies.used[side.body.name].index(side.name) * per

            on_surfaces.append(i)
            ports.append(np.arange(first, first + per))
            is_section.append(side.body.by_section)

        # a point of the world, and its axes, in the axes of the frames: R^T (x - r), R^T
        poses = np.array([p.pose for p in self.places]).reshape(n, self.m.n_pose)
        levers = np.array([p.point for p in self.places]).reshape(n, d) - poses[:, :d]
        back = np.swapaxes(self.m.matrix(poses), 1, 2)

        return Markers(
            self.m,
            np.array([p.frame for p in self.places], dtype=int),
            (back @ levers[..., None])[..., 0],
            np.ascontiguousarray(back),
            np.array(on_surfaces, dtype=int),
            np.array(ports, dtype=int).reshape(len(on_surfaces), per),
            np.array(is_section, dtype=bool) if any(is_section) else None,
        )

    def of_force(self, f: Force) -> tuple[int, int]:
        """Numbers of new markers for a force between two points."""
        if f.joined and f.point_a is None:
            point = self.default_point(f)
            return self.add(f.a, point), self.add(f.b, point)
        a = self.add(f.a, None if f.point_a is None else np.asarray(f.point_a, dtype=float))
        b = a if f.b is None else self.add(f.b, None if f.point_b is None else np.asarray(f.point_b, dtype=float))
        return a, b

    def of_sensor(self, s: Sensor) -> int:
        """Number of a new marker for a sensor, -1 for one that has none."""
        if s.on is None:
            return -1
        check_side(self.bodies.scene, s.on, "A sensor")
        return self.add(s.on, None if s.point is None else vector("A sensor's point", s.point, size=self.m.dim))
