"""How a scene becomes a :class:`~fmbd_fenicsx.system.system.System`: frames, parts, markers, constraints, forces, start."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...errors import InputError, require
from ...mechanics.bodies.bodies import RigidBody, Surface
from ...mechanics.bodies.coordinates import CoordinateBody, own_constraint
from ...mechanics.bodies.port_constraint import PortConstraint
from ...mechanics.catenary.sliding import place
from ...mechanics.forces.effort_laws import Feedback
from ...mechanics.forces.forces import CoordinateForce
from ...mechanics.frames import Markers
from ...mechanics.joints.constraints import Batch
from ...mechanics.joints.couplings import SmoothMotion
from ...mechanics.joints.drives import Coupling
from ...mechanics.joints.joints import ground
from ..gravity import gravity_of
from ..layout import RowBlock, State
from ..system import System
from .force_batches import build_loads
from .going_on import Closing, go_on
from .joints import JointRows, counted_angles
from .marker_places import MarkerPlaces
from .placed_bodies import PlacedBodies
from .point_masses import attitude_of, refuse_angles, refuse_turning
from .references import check_references, check_sensors

if TYPE_CHECKING:
    from .scene import Scene


class Constraints(NamedTuple):
    """All constraints of a system, as :class:`~fmbd_fenicsx.system.system.System` takes them, and whose rows are whose."""

    batches: tuple[tuple[Batch, np.ndarray], ...]
    port_constraints: tuple[tuple[PortConstraint, slice], ...]
    traces: tuple[tuple[Any, slice], ...]
    blocks: tuple[RowBlock, ...]


class Builder:
    """Turns a scene into arrays; lives only during :meth:`Scene.build`."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.bodies = PlacedBodies(scene)
        self.m = self.bodies.m
        self.markers = MarkerPlaces(self.bodies)
        self.joint_markers: dict[str, tuple[int, int]] = {}
        self.closing: list[Closing] = []  # joints that close on what they find

    def build(self) -> tuple[System, State, dict[str, int]]:
        """The system, its state as given, and the marker of each sensor; collective."""
        scene = self.scene
        check_references(scene)
        if scene.breakpoints:
            tell_break_points(scene)

        # bodies
        points = [b for b in scene.bodies.values() if not b.turns]
        if points:
            refuse_angles(scene)
        moving = [b for b in scene.bodies.values() if not b.locked]
        if not moving:
            raise InputError(f'Scene "{scene.name}": all bodies are locked, so nothing can move.')
        rigid = [b for b in moving if isinstance(b, RigidBody)]
        bodies = self.bodies
        bodies.add_frames(moving)
        bodies.add_parts(moving)

        # what acts between them, and who looks at them
        rows = self._constraints(self._surface_ties())
        forces = build_loads(self)
        if points:
            refuse_turning([p.body for p in self.markers.places], rows.batches, rows.blocks, forces)

        check_sensors(scene, {b.name for b in rows.blocks})
        sensor_markers = {n: self.markers.of_sensor(s) for n, s in scene.sensors.items()}
        markers = self.markers.made()
        counted = self._counted(markers)

        system = System(
            motions=self.m,
            frame_names=tuple(bodies.frame_of),
            rigid=bodies.nodes.rigid_block(self.m, rigid, bodies.frame_of),
            parts=tuple(bodies.parts),
            markers=markers,
            batches=rows.batches,
            port_constraints=rows.port_constraints,
            forces=forces,
            gravity=gravity_of(scene.name, scene.gravity, scene.gravity_ramp, self.m.dim, scene.begins),
            blocks=rows.blocks,
            length=bodies.length(),
            mass=bodies.mass(rigid),
            ground=self.m.identity[None],
            contacts=self._contacts(),
            traces=rows.traces,
            counted=counted,
            elements=tuple(bodies.nodes.elements),
            sensed=tuple((s, sensor_markers[n]) for n, s in scene.sensors.items()),
        )

        given = bodies.state(system)
        if scene.origin is not None:
            system, given = go_on(scene.origin, system, given, self.closing)
        return system, given, sensor_markers

    def _contacts(self) -> Any:
        """The contact set, None for a scene without contact."""
        if not self.scene.unilateral:
            return None
        from .contact import build_contacts, limit_pairs

        stops = limit_pairs(self.scene, self.m, self.joint_markers)
        return build_contacts(self.scene, self.m, self.bodies.frame_of, self.bodies.parts, stops=stops)

    def _surface_ties(self) -> list[Any]:
        """Rows of the ties by field multipliers."""
        if not self.scene.ties:
            return []
        from ...mechanics.joints.trace_rows import build_surface_ties

        return build_surface_ties(self.scene.ties, self.bodies.parts, self.bodies.part_of, self.bodies.frame_of)

    # -- constraints ----------------------------------------------------------------------------------------------
    def _constraints(self, ties: list[Any]) -> Constraints:
        """All rows in their order: of joints, of own equations, sliding contacts, surface ties and frame conditions."""
        rows = JointRows(self.m, self.bodies.length)
        self._add_joints(rows)
        self.joint_markers = rows.markers

        own = self._own_equations(rows)
        sliding = self._sliding_contacts(rows)
        traces = tuple((tie, rows.take(tie.name, tie.rows, "surface tie")) for tie in ties)
        for part in self.bodies.parts:
            if part.n_frame_rows:
                rows.take(f"frame of {part.name}", part.n_frame_rows, "frame")
        return Constraints(tuple(rows.batches()), (*own, *sliding), traces, tuple(rows.blocks))

    def _add_joints(self, rows: JointRows) -> None:
        """Rows of joints, and of what keeps bodies from turning that know no angles."""
        origin = self.scene.origin
        for joint in self.scene.joints.values():
            somewhere = joint.center_a is not None and joint.center_b is not None
            default = self.markers.default_point(joint) if joint.joined and not somewhere else None
            a = self.markers.add(joint.a, default if joint.center_a is None else joint.center_a)

            # a joint that a going-on scene closes catches its second side where that is
            point = default if joint.center_b is None else joint.center_b
            past = None if origin is None else origin.closed(joint)
            if past is not None:
                closing = Closing(joint, a, len(self.markers.places), past)
                self.closing.append(closing)
                point = None if closing.caught else point
            b = self.markers.add(joint.b, point)

            surfaces = [side for side in (joint.a, joint.b) if isinstance(side, Surface)]
            narrow = [width for side in surfaces if (width := self.bodies.narrow(side))]
            rows.add(joint, (a, b), min(narrow, default=0.0))

        for body in self.scene.bodies.values():
            if not (body.turns or body.locked):
                rows.add(attitude_of(body), (self.markers.add(ground, None), self.markers.add(body, None)))

    def _own_equations(self, rows: JointRows) -> list[tuple[PortConstraint, slice]]:
        """Constraints of the user's own on coordinates of his own."""
        found = []
        for k, part in enumerate(self.bodies.parts):
            body = part.body
            if isinstance(body, CoordinateBody) and body.constraint is not None:
                law = own_constraint(body, k)
                count = len(law.values(np.asarray(body.start), 0.0))
                found.append((law, rows.take(body.name, count, "constraint")))
        return found

    def _sliding_contacts(self, rows: JointRows) -> list[tuple[Any, slice]]:
        """Both sides of every contact that slides along wires, which share a row."""
        out: list[tuple[Any, slice]] = []
        slots: dict[str, int] = {}
        for s in self.scene.sliders.values():
            for b in (s.wires, s.body):
                known = self.scene.bodies.get(b.name) is b
                require(known, f'Contact "{s.name}" refers to body "{b.name}", which is not in the scene.')

            slot = slots[s.wires.name] = slots.get(s.wires.name, -1) + 1
            numbers = (self.bodies.part_of[s.wires.name], self.bodies.part_of[s.body.name])
            wire, head = place(s, numbers, slot, rows.row)
            self.bodies.parts[numbers[0]].statuses.append(wire.status)
            span = rows.take(wire.name, 1, "sliding contact")
            out += [(wire, span), (head, span)]
        return out

    # -- start ----------------------------------------------------------------------------------------------------
    def _counted(self, markers: Markers) -> Any:
        """The angles beyond a turn that constraints, forces and sensors of the scene use; None without any."""
        scene = self.scene
        parts: list[Any] = [*scene.joints.values(), *scene.forces.values(), *scene.sensors.values()]
        used = [s for part in parts for s in part.coordinates]
        used += [limit.coordinate for limit in scene.limits.values()]
        known = self.joint_markers  # a sensor of another joint is refused where it is read
        # one angle for each pair of markers, however many ask for it
        angles = {known[s.joint.name]: s for s in used if s.kind.angular and s.joint.name in known}
        if not angles:
            return None
        return counted_angles(self.m, markers, angles, np.array([*self.bodies.poses, self.m.identity]))


def tell_break_points(scene: Scene) -> None:
    """Every prescribed motion and every target of a motor is smooth between the break points of its scene only."""
    for motion in _given(scene):
        if isinstance(motion, SmoothMotion):
            motion.smooth.break_at(scene.breakpoints)


def _given(scene: Scene) -> Iterator[Any]:
    """All functions of time that have rates."""
    for joint in scene.joints.values():
        yield from (row.motion for row in joint.rows)
        if isinstance(joint, Coupling):
            yield joint.motion
    yield from (tie.motion for tie in scene.ties.values())
    for force in scene.forces.values():
        if isinstance(force, CoordinateForce) and isinstance(force.law, Feedback):
            yield force.law.target
