"""How a scene becomes a :class:`~fmbd_fenicsx.system.system.System`: frames, parts, markers, constraints, forces, start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ...checks import vector
from ...errors import InputError, near
from ...mechanics.bodies.bodies import ElasticBody, FloatingBody, RigidBody, Surface
from ...mechanics.bodies.coordinates import CoordinateBody, own_constraint
from ...mechanics.bodies.port_constraint import PortConstraint
from ...mechanics.body import Placed, Site
from ...mechanics.forces.forces import Force
from ...mechanics.frames import Markers
from ...mechanics.joints.constraints import Batch
from ...mechanics.joints.joints import Joint, ground
from ...mechanics.rods.rods import Rod
from ...rotations import Array, Motions, motions
from ..configurations import count
from ..gravity import gravity_of
from ..layout import RowBlock, State
from ..sensors.sensor import Sensor
from ..system import System
from .break_points import tell_break_points
from .force_batches import build_loads
from .going_on import Closing, go_on
from .joints import JointRows, counted_angles
from .model_length import model_length
from .point_masses import at_its_place, attitude_of, refuse_angles, refuse_turning
from .rods import RodNodes
from .wires import slider_rows

NARROW = 1e-3  # of a body, a surface on which it turns as on a hinge

if TYPE_CHECKING:
    from .scene import Scene


class MarkerPlace(NamedTuple):
    """A marker with the axes of the world at the start, on a frame that starts at a pose (n_pose,): at a ``point`` (d,) of the
    world; ``surface`` of an elastic body, or None; ``body``: a rigid one that moves.
    """

    frame: int
    pose: Array
    point: Array
    surface: Surface | None = None
    body: RigidBody | None = None


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
        self.m: Motions = motions(scene.dim)
        self.frame_of: dict[str, int] = {}
        self.poses: list[Array] = []
        self.twists: list[Array] = []
        self.part_of: dict[str, int] = {}
        self.fields: list[Any] = []
        self.joint_markers: dict[str, tuple[int, int]] = {}
        self.closing: list[Closing] = []  # joints that close on what they find
        self.starts: list[tuple[Array, Array]] = []
        self.nodes = RodNodes()
        self.places: list[MarkerPlace] = []
        self.here = self.m.identity  # the pose of the ground

    def build(self) -> tuple[System, State, dict[str, int]]:
        """The system, its state as given, and the marker of each sensor; collective."""
        scene = self.scene
        self._check()
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
        self._add_frames(moving)
        self._add_parts(moving, self._surfaces_in_use())

        # what acts between them, and who looks at them
        rows = self._constraints(self._surface_ties())
        forces = build_loads(self)
        if points:
            refuse_turning([p.body for p in self.places], rows.batches, rows.blocks, forces)

        self._check_sensors({b.name for b in rows.blocks})
        sensor_markers = {n: self.sensor_marker(s) for n, s in scene.sensors.items()}
        markers = self._markers()
        counted = self._counted(markers)

        system = System(
            motions=self.m,
            frame_names=tuple(self.frame_of),
            rigid=self.nodes.rigid_block(self.m, rigid, self.frame_of),
            parts=tuple(self.fields),
            markers=markers,
            batches=rows.batches,
            port_constraints=rows.port_constraints,
            forces=forces,
            gravity=gravity_of(scene.name, scene.gravity, scene.gravity_ramp, self.m.dim, scene.begins),
            blocks=rows.blocks,
            length=self.length(),
            mass=self._mass(rigid),
            ground=self.m.identity[None],
            contacts=self._contacts(),
            traces=rows.traces,
            counted=counted,
            elements=tuple(self.nodes.elements),
            sensed=tuple((s, sensor_markers[n]) for n, s in scene.sensors.items()),
        )

        given = self._state(system)
        if scene.origin is not None:
            system, given = go_on(scene.origin, system, given, self.closing)
        return system, given, sensor_markers

    def _add_frames(self, moving: list[Any]) -> None:
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

    def _add_parts(self, moving: list[Any], used: dict[str, list[str]]) -> None:
        """The parts of all bodies with local coordinates: those in the core first, then those distributed over ranks."""
        ground_frame = len(self.poses)
        for body in sorted(moving, key=lambda b: b.stage):
            frame = self.frame_of[body.name] if body.framed else ground_frame
            # parts stand in the order of their stages: replicated ones before fields
            slides = [(s.wire, s.path) for s in self.scene.sliders.values() if s.wires is body]
            placed = body.placed(Site(frame, ground_frame, used[body.name], slides, self._field))
            if placed is not None:
                self._put_part(placed)

    def _put_part(self, placed: Placed) -> None:
        """Add a part with its local coordinates and rates at the start, and the start of its frame."""
        part = placed.part
        self.part_of[part.name] = len(self.fields)
        self.fields.append(part)
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

    def _contacts(self) -> Any:
        """The contact set, None for a scene without contact."""
        if not self.scene.unilateral:
            return None
        from .contact import build_contacts, limit_pairs

        stops = limit_pairs(self.scene, self.m, self.joint_markers)
        return build_contacts(self.scene, self.m, self.frame_of, self.fields, stops=stops)

    def _surface_ties(self) -> list[Any]:
        """Rows of the ties by field multipliers."""
        if not self.scene.ties:
            return []
        from ...mechanics.joints.trace_rows import build_surface_ties

        return build_surface_ties(self.scene.ties, self.fields, self.part_of, self.frame_of)

    # -- checks -------------------------------------------------------------------------------------------------
    def _check(self) -> None:
        scene = self.scene
        if scene.unilateral:
            from .contact import check_contacts

            check_contacts(scene)
        for joint in scene.joints.values():
            for side in (joint.a, joint.b):
                self._known(side, f'Joint "{joint.name}"')
        for tie in scene.ties.values():
            for side in (tie.a, tie.b):
                self._known(side, f'Tie "{tie.name}"')
        for force in scene.forces.values():
            for side in force.sides:
                if side is not None:
                    self._known(side, f'Force "{force.name}"')
        for body in scene.bodies.values():
            if isinstance(body, FloatingBody) and body.frame is None:
                raise InputError(
                    f'Body "{body.name}" has no frame: its rigid motion is not determined. Use frame=MeanAxis() or Attached(...).'
                )

    def _known(self, side: Any, what: str) -> None:
        if side is ground:
            return
        body = side.body
        if self.scene.bodies.get(body.name) is not body:
            known = near(body.name, self.scene.bodies)
            raise InputError(f'{what} refers to body "{body.name}", which is not in the scene. {known}')

        if side is body and body.by_surface:
            raise InputError(
                f'{what}: attach to a surface of the elastic body "{body.name}", say {body.name}.surface("...").'
            )

    def _check_sensors(self, rows: set[str]) -> None:
        """Refuse a sensor of a joint, body or contact that is not in the scene; one of the same name is another one."""
        scene = self.scene
        joints = {**dict.fromkeys(rows), **scene.joints}
        there: dict[str, Mapping[str, Any]] = {
            "joint": joints, "body": scene.bodies, "force": scene.forces, "contact": scene.contacts, "joint limit": scene.limits,
        }  # fmt: skip

        for name, sensor in scene.sensors.items():
            for what, wanted in sensor.wanted:
                known = there[what]
                here = known.get(wanted)
                another = here is not None and getattr(wanted, "part", here) is not here  # ties have rows alone
                if wanted not in known or another:
                    raise InputError(
                        f'Sensor "{name}": there is no {what} "{wanted}" in the scene. {near(wanted, known)} '
                        f'Add it, or take the sensor out: del scene.sensors["{name}"].'
                    )

    def _surfaces_in_use(self) -> dict[str, list[str]]:
        used: dict[str, list[str]] = {n: [] for n in self.scene.bodies}
        sides = [s for j in self.scene.joints.values() for s in (j.a, j.b)]
        sides += [s for f in self.scene.forces.values() for s in f.sides]
        sides += [s.on for s in self.scene.sensors.values()]
        for side in sides:
            if isinstance(side, Surface) and side.name not in used[side.body.name]:
                used[side.body.name].append(side.name)
        return used

    # -- bodies -------------------------------------------------------------------------------------------------
    def _center(self, side: Surface) -> Array:
        """Where a surface lies at the start."""
        if isinstance(side.body, Rod):
            return self.nodes.section(side)[1][: self.m.dim]
        center: Array = self.fields[self.part_of[side.body.name]].surface_center(side.name)
        return center

    def _narrow(self, side: Surface) -> float:
        """Size (m) of a surface that is hardly anything of its elastic body: it turns there as on a hinge; 0 elsewhere."""
        part = self.fields[self.part_of[side.body.name]] if side.body.meshed else None
        width = part.field.moments(side.name).length if part is not None and part.distributed else np.inf
        return width if part is not None and width < NARROW * part.size else 0.0

    def _mass(self, rigid: list[RigidBody]) -> float:
        return self.nodes.mass + sum(b.mass for b in rigid) + sum(p.mass_total for p in self.fields)

    def length(self) -> float:
        """The characteristic length of the model, m."""
        return model_length(self.scene, [q[: self.m.dim] for q in self.poses], [p.size for p in self.fields])

    # -- markers ------------------------------------------------------------------------------------------------
    def _marker(self, side: Any, point: Array | None) -> int:
        """Number of a new marker on an attachment at a world point (None: centroid or origin); world axes at the start."""
        self.places.append(self._place(side, None if point is None else np.asarray(point)[: self.m.dim]))
        return len(self.places) - 1

    def _place(self, side: Any, point: Array | None) -> MarkerPlace:
        d, here = self.m.dim, self.here
        if isinstance(side, Surface) and isinstance(side.body, Rod):
            frame, pose = self.nodes.section(side)
            return MarkerPlace(frame, pose, pose[:d] if point is None else point)
        if isinstance(side, Surface):
            # on a surface: by its centroid, and the lever of the point in the surface's own axes
            part = self.fields[self.part_of[side.body.name]]
            lever = np.zeros(d) if point is None else point - part.surface_center(side.name)
            return MarkerPlace(part.frame, here, lever, side)

        # on the ground, on a body locked to it, or on a moving one
        ground_frame = len(self.poses)
        if side is ground:
            return MarkerPlace(ground_frame, here, here[:d] if point is None else point)
        if point is not None and not side.turns:
            point = at_its_place(side, point, self.length())
        if side.locked:
            return MarkerPlace(ground_frame, here, side.start_pose()[:d] if point is None else point)

        frame = self.frame_of[side.name]
        pose = self.poses[frame]
        return MarkerPlace(frame, pose, pose[:d] if point is None else point, body=side)

    def _default_point(self, joint: Joint | Force) -> Array | None:
        """Where a joint or bushing without a center sits: the centroid of a surface, else the origin of its moving body."""
        for side in (joint.a, joint.b):
            if isinstance(side, Surface):
                return self._center(side)
        for side in (joint.b, joint.a):
            if isinstance(side, RigidBody):
                return side.start_pose()[: self.m.dim]
        return None

    def _markers(self) -> Markers:
        d = self.m.dim
        n, per = len(self.places), d * (1 + d)  # ports of a surface
        used = self._surfaces_in_use()
        on_surfaces, ports, is_section = [], [], []
        for i, side in enumerate(place.surface for place in self.places):
            if side is None:
                continue
            # ports of all parts stand in one array: those of the part's frame come first, then its surfaces
            k = self.part_of[side.body.name]
            first = sum(f.n_port for f in self.fields[:k]) + self.fields[k].n_frame_rows
            first += used[side.body.name].index(side.name) * per

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

    def force_markers(self, f: Force) -> tuple[int, int]:
        """Numbers of new markers for a force between two points."""
        if f.joined and f.point_a is None:
            point = self._default_point(f)
            return self._marker(f.a, point), self._marker(f.b, point)
        a = self._marker(f.a, None if f.point_a is None else np.asarray(f.point_a, dtype=float))
        b = a if f.b is None else self._marker(f.b, None if f.point_b is None else np.asarray(f.point_b, dtype=float))
        return a, b

    def sensor_marker(self, s: Sensor) -> int:
        """Number of a new marker for a sensor, -1 for one that has none."""
        if s.on is None:
            return -1
        self._known(s.on, "A sensor")
        return self._marker(s.on, None if s.point is None else vector("A sensor's point", s.point, size=self.m.dim))

    # -- constraints ----------------------------------------------------------------------------------------------
    def _constraints(self, ties: list[Any]) -> Constraints:
        """All rows in their order: of joints, of own equations, sliding contacts, surface ties and frame conditions."""
        rows = JointRows(self.m, self.length)
        self._add_joints(rows)
        self.joint_markers = rows.markers

        own = self._own_equations(rows)
        sliding = slider_rows(self.scene, self.fields, self.part_of, rows.row)
        for law, _ in sliding[::2]:  # both sides share a row
            rows.take(law.name, 1, "sliding contact")
        traces = tuple((tie, rows.take(tie.name, tie.rows, "surface tie")) for tie in ties)
        for part in self.fields:
            if part.n_frame_rows:
                rows.take(f"frame of {part.name}", part.n_frame_rows, "frame")
        return Constraints(tuple(rows.batches()), (*own, *sliding), traces, tuple(rows.blocks))

    def _add_joints(self, rows: JointRows) -> None:
        """Rows of joints, and of what keeps bodies from turning that know no angles."""
        origin = self.scene.origin
        for joint in self.scene.joints.values():
            somewhere = joint.center_a is not None and joint.center_b is not None
            default = self._default_point(joint) if joint.joined and not somewhere else None
            a = self._marker(joint.a, default if joint.center_a is None else joint.center_a)
            new = Closing(joint, a, len(self.places)) if origin is not None and origin.closes(joint) else None
            point = default if joint.center_b is None else joint.center_b
            b = self._marker(joint.b, None if new is not None and new.caught else point)
            narrow = [x for side in (joint.a, joint.b) if isinstance(side, Surface) and (x := self._narrow(side))]
            rows.add(joint, (a, b), min(narrow, default=0.0))
            if new is not None:
                self.closing.append(new)
        for body in self.scene.bodies.values():
            if not (body.turns or body.locked):
                rows.add(attitude_of(body), (self._marker(ground, None), self._marker(body, None)))

    def _own_equations(self, rows: JointRows) -> list[tuple[PortConstraint, slice]]:
        """Constraints of the user's own on coordinates of his own."""
        found = []
        for k, part in enumerate(self.fields):
            body = part.body
            if isinstance(body, CoordinateBody) and body.constraint is not None:
                law = own_constraint(body, k)
                count = len(law.values(np.asarray(body.start), 0.0))
                found.append((law, rows.take(body.name, count, "constraint")))
        return found

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
        return counted_angles(self.m, markers, angles, np.array([*self.poses, self.m.identity]))

    def _state(self, system: System) -> State:
        theta = np.zeros(0 if system.counted is None else system.counted.count)
        v = [*self.twists, *(ud for _, ud in self.starts)]
        # q in the order of the system: poses, counted angles, local coordinates
        start = np.concatenate([*self.poses, theta, *(u for u, _ in self.starts)])
        count(system, start)
        return State(0.0, start, np.concatenate(v), np.zeros(system.n_v), np.zeros(system.n_lam))
