"""A mechanism from a URDF file (needs yourdfpy): links as rigid bodies, any of them made elastic by one call.

    robot = fmbd.read_urdf("arm.urdf", start={"elbow": 0.5})
    robot.make_elastic("forearm", forearm, surfaces={"elbow": "root", "wrist": "tip"})
    scene = robot.scene("arm", gravity=(0, 0, -9.81))
    phi = robot.coordinate("elbow")  # 0.5 at the start

The root link stands still. Links without mass go with the link that a fixed joint ties them to. Damping and friction of a joint
become force elements, a mimic joint a gear. Limits are kept as data, ``robot.joints["elbow"].limits``; a start outside of them is
told of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ...checks import instance, number
from ...errors import InputError, near, require
from ...log import log
from ...mechanics.bodies.bodies import FloatingBody, RigidBody
from ...mechanics.forces.forces import joint_spring
from ...mechanics.forces.joint_elements import joint_friction
from ...mechanics.joints.drives import JointCoordinate, angle, displacement, gear
from ...mechanics.joints.joints import Joint, fixed, ground, planar, prismatic, revolute
from ...mechanics.joints.sums import Coordinate
from ...rotations import Array
from .scene import Scene

KINDS = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")
COORDINATES = ("revolute", "continuous", "prismatic")  # kinds with one angle or displacement
ON_LIMIT = 1e-6  # rad or m by which a start may miss a limit that is written with few digits
FRICTION_SPEED = 1e-2  # rad/s or m/s at which the friction of a joint is that of sliding


@dataclass(frozen=True)
class RobotJoint:
    """A joint of the file: names of its links, its ``frame`` (4, 4) in the world at the start, ``axis`` there, ``limits`` of its
    angle or displacement, and which of these it has at the ``start`` (rad or m).
    """

    name: str
    kind: str
    parent: str
    child: str
    frame: Array = field(repr=False)
    axis: Array = field(repr=False)
    limits: tuple[float, float]
    damping: float
    friction: float
    mimic: tuple[str, float] | None
    start: float


@dataclass(repr=False)
class Robot:
    """The links and joints of a URDF file, ready to become a scene.

    Attributes: ``frames`` link -> (4, 4) in the world at the start; ``bodies`` link -> body; ``carrier`` link -> the link whose
    body carries it (itself, or across fixed joints without mass); ``root`` the link that stands still.
    """

    name: str
    root: str
    frames: dict[str, Array]
    joints: dict[str, RobotJoint]
    bodies: dict[str, Any]
    carrier: dict[str, str]
    surfaces: dict[tuple[str, str], str] = field(default_factory=dict)
    _made: dict[str, Joint] = field(default_factory=dict)

    def __repr__(self) -> str:
        joints = [f"\n  {j.name}: {j.kind}, {j.parent} - {j.child}" for j in self.joints.values()]
        return f'<Robot "{self.name}" on {self.root}: bodies {", ".join(self.bodies)}; joints{"".join(joints)}>'

    def make_elastic(
        self, link: str, body: FloatingBody, *, surfaces: Mapping[str, str], modes: int | None = None
    ) -> Any:
        """Replace the rigid body of a link by an elastic one; returns the body as it stands in the scene.

        Args:
            body: its mesh in the axes of the link, as the file gives them.
            surfaces: joint -> surface of the body that it holds, for each joint of the link.
            modes: number of modes of a reduced body; None keeps the whole field.
        """
        require(not self._made, "make_elastic comes before scene().")
        if link not in self.bodies:
            raise InputError(f'make_elastic: no link "{link}" with mass. {near(link, self.bodies)}')

        # joints that hold the link need a surface, unless both sides are one body
        mine = [j.name for j in self.joints.values() if link in (self.carrier[j.parent], self.carrier[j.child])]
        missing = [j for j in mine if j not in surfaces and self.joints[j].kind != "floating"]
        missing = [j for j in missing if self.carrier[self.joints[j].parent] != self.carrier[self.joints[j].child]]
        require(not missing, f'make_elastic: link "{link}" is held by joints {missing}: give a surface for each.')

        frame = self.frames[link]
        placed = body.with_(name=link, mesh=body.mesh.placed(frame[:3, 3], frame[:3, :3]))
        made = placed if modes is None else placed.reduced(modes=modes)

        for joint, surface in surfaces.items():
            require(joint in mine, f'make_elastic: joint "{joint}" does not hold link "{link}". {near(joint, mine)}')
            made.surface(surface)
            self.surfaces[link, joint] = surface
        self.bodies[link] = made
        return made

    def side(self, link: str, joint: str) -> Any:
        """What a joint holds of a link: the ground, a rigid body, or a surface."""
        carrier = self.carrier[link]
        if carrier == self.root:
            return ground
        body = self.bodies[carrier]
        return body.surface(self.surfaces[carrier, joint]) if (carrier, joint) in self.surfaces else body

    def coordinate(self, joint: str) -> Coordinate:
        """Angle or displacement of a joint as the file counts it: that of the start, and what it has moved since."""
        moved = self._moved(joint)
        start = self.joints[joint].start
        return moved + start if start else moved

    def _moved(self, joint: str) -> JointCoordinate:
        """Angle or displacement of a joint, from its start."""
        if joint not in self._made:
            known = self._made or self.joints
            raise InputError(f'No joint "{joint}" that moves in the scene; call scene() first. {near(joint, known)}')
        made = self._made[joint]
        return displacement(made) if made.kind == "prismatic" else angle(made)

    def scene(self, name: str | None = None, **settings: Any) -> Scene:
        """The scene with all links and joints; ``settings`` as for :class:`Scene`, say ``gravity=(0, 0, -9.81)``."""
        scene = Scene(name or self.name, **settings)
        scene.add(*self.bodies.values())
        for j in self.joints.values():
            # links without mass are part of the body that carries them
            if self.carrier[j.parent] == self.carrier[j.child] or j.kind == "floating":
                continue
            a = self.side(j.parent, j.name)
            b = self.side(j.child, j.name)
            self._made[j.name] = _joint(j, a, b)
            scene.add(self._made[j.name])
        for j in self.joints.values():
            self._add_elements(scene, j)
        return scene

    def _add_elements(self, scene: Scene, j: RobotJoint) -> None:
        """Damping, friction and mimic of a joint."""
        if j.kind not in COORDINATES:
            return
        if j.damping:
            scene.add(joint_spring(f"{j.name} damping", self._moved(j.name), damping=j.damping))
        if j.friction:
            on = self._moved(j.name)
            scene.add(joint_friction(f"{j.name} friction", on, coulomb=j.friction, speed=FRICTION_SPEED))
        if j.mimic is not None:
            leader, ratio = j.mimic
            scene.add(gear(f"{j.name} mimic", self._moved(leader), self._moved(j.name), ratio=ratio))


def _joint(j: RobotJoint, a: Any, b: Any) -> Joint:
    """The joint between two attachments at its place in the world."""
    center = [float(x) for x in j.frame[:3, 3]]
    axis = [float(x) for x in j.axis]
    if j.kind in ("revolute", "continuous"):
        return revolute(j.name, a, b, center=center, axis=axis)
    if j.kind == "prismatic":
        return prismatic(j.name, a, b, center=center, axis=axis)
    if j.kind == "planar":
        return planar(j.name, a, b, center=center, normal=axis)
    return fixed(j.name, a, b, center=center)


def read_urdf(file: str | Path, *, start: Mapping[str, float] | None = None) -> Robot:
    """Read a URDF file; ``start``: joint -> angle (rad) or displacement (m) in which the mechanism begins, 0 by default; joints
    that mimic another begin where multiplier and offset put them.

    Raises:
        InputError: no such file, no XML, joints of an unknown kind or without a tree, links that move without mass, a start
            that a mimic contradicts; all named.
    """
    path = Path(instance("read_urdf: file", file, (str, Path)))
    start = {} if start is None else instance("read_urdf: start", start, Mapping)
    start = {joint: number(f'read_urdf: start of "{joint}"', x) for joint, x in start.items()}
    model = _parsed(path)
    _check_names(path, model)
    _check_start(model.joints, start)
    root = _root(path, model)

    starts = _with_mimics(path, model, start)
    frames, joints = _placed(model, root, starts)
    _tell(path, joints, starts)
    bodies, carrier = _bodies(path, model, (root, frames, joints))
    return Robot(model.name or path.stem, root, frames, joints, bodies, carrier)


def _parsed(path: Path) -> Any:
    """What yourdfpy reads in a file: ``name``, ``links``, ``joints``."""
    try:
        from yourdfpy import URDF
    except ImportError:
        raise InputError("read_urdf needs yourdfpy: ./with-dolfinx pip install yourdfpy.") from None
    require(path.is_file(), f"read_urdf: there is no file {path} (looked in {Path.cwd()}).")

    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        raise InputError(f"read_urdf: {path} is no complete XML file: {error}.") from None
    try:
        # pictures are not read: only what moves
        return URDF.load(str(path), load_meshes=False, build_scene_graph=False).robot
    except Exception as error:  # its parser raises whatever an attribute or number that is missing or wrong leads to
        raise InputError(f"read_urdf: {path} is no URDF file: {type(error).__name__}: {error}.") from error


def _check_names(path: Path, model: Any) -> None:
    """Refuse names that stand for two, and joints of unknown kinds."""
    for what in ("link", "joint"):
        names = [x.name for x in getattr(model, f"{what}s")]
        twice = sorted({name for name in names if names.count(name) > 1})
        require(not twice, f"{path}: names of {what}s must be unique, found more than once: {twice}.")
    for j in model.joints:
        if j.type not in KINDS:
            raise InputError(
                f'{path}: joint "{j.name}" is of kind "{j.type}", which is not known. Known: {", ".join(KINDS)}.'
            )


def _check_start(joints: Sequence[Any], start: Mapping[str, float]) -> None:
    """Refuse starts of joints that are not there, or have no coordinate."""
    kinds = {j.name: j.type for j in joints}
    for joint in start:
        require(joint in kinds, f'read_urdf: no joint "{joint}" to start with. {near(joint, kinds)}')
        require(
            kinds[joint] in COORDINATES,
            f'read_urdf: joint "{joint}" of kind "{kinds[joint]}" has no angle or displacement to start with. Place its child by '
            "the <origin> of the joint.",
        )


def _root(path: Path, model: Any) -> str:
    """The link that no joint places; all others have one that does."""
    children = [j.child for j in model.joints]
    for child in children:
        held = [j.name for j in model.joints if j.child == child]
        require(
            len(held) == 1,
            f'{path}: link "{child}" is the child of joints {held}, each with its own place for it. Leave one, and close the '
            "loop in the scene: scene.add(fmbd.revolute(...)).",
        )
    roots = [link.name for link in model.links if link.name not in children]
    require(len(roots) == 1, f"{path}: expected one root link, found {roots}.")
    return str(roots[0])


def _tell(path: Path, joints: Mapping[str, RobotJoint], starts: Mapping[str, float]) -> None:
    """Warn of starts outside of limits, and of dynamics that joints without a coordinate have no element for."""
    outside, lost = [], []
    for joint in joints.values():
        start, (lower, upper) = starts[joint.name], joint.limits
        if lower < upper and not lower - ON_LIMIT <= start <= upper + ON_LIMIT:
            outside.append(f'"{joint.name}" at {start:g}, limits {lower:g} to {upper:g}')
        if joint.kind not in COORDINATES and (joint.damping or joint.friction):
            lost.append(f'"{joint.name}" ({joint.kind})')

    if outside:
        log.warning(
            "%s: joints begin outside of their limits: %s. Give read_urdf(start=...) others; a stop added at a limit would throw "
            "them back", path, "; ".join(outside),
        )  # fmt: skip
    if lost:
        log.warning(
            "%s: damping and friction are left out of joints without one angle or displacement: %s. Add a fmbd.bushing or a "
            "fmbd.force_element", path, ", ".join(lost),
        )  # fmt: skip


def _with_mimics(path: Path, model: Any, start: dict[str, float]) -> dict[str, float]:
    """Starts of all joints: one that mimics another is at multiplier * leader + offset."""
    mimics = {j.name: j.mimic for j in model.joints if j.mimic is not None}
    for joint, mimic in mimics.items():
        known = [j.name for j in model.joints]
        require(
            mimic.joint in known,
            f'{path}: joint "{joint}" mimics "{mimic.joint}", which is no joint. {near(mimic.joint, known)}',
        )

    def value(joint: str, behind: tuple[str, ...] = ()) -> float:
        if joint not in mimics:
            return start.get(joint, 0.0)
        require(joint not in behind, f"{path}: joints {sorted({*behind, joint})} mimic each other in a circle.")
        mimic = mimics[joint]
        # URDF leaves out what is 1 or 0
        factor = 1.0 if mimic.multiplier is None else float(mimic.multiplier)
        found = factor * value(mimic.joint, (*behind, joint)) + float(mimic.offset or 0.0)
        given = start.get(joint, found)
        require(
            abs(given - found) <= 1e-9 * max(1.0, abs(found)),
            f'read_urdf: joint "{joint}" mimics "{mimic.joint}", which puts it at {found:g}, not at the start {given:g}: leave '
            "that out.",
        )
        return found

    return {j.name: value(j.name) for j in model.joints}


def _placed(model: Any, root: str, start: dict[str, float]) -> tuple[dict[str, Array], dict[str, RobotJoint]]:
    """Frames of all links and the joints in the world, along the tree from its root."""
    frames: dict[str, Array] = {root: np.eye(4)}
    joints: dict[str, RobotJoint] = {}

    # from the root outwards
    waiting = list(model.joints)
    while waiting:
        ready = [j for j in waiting if j.parent in frames]
        if not ready:
            raise InputError(f"Joints {[j.name for j in waiting]} hang on no link of the tree.")
        for j in ready:
            waiting.remove(j)
            frame = frames[j.parent] @ (np.eye(4) if j.origin is None else j.origin)
            axis = np.array([1.0, 0.0, 0.0]) if j.axis is None else np.asarray(j.axis, dtype=float)
            frames[j.child] = frame @ _moved(j.type, axis, start.get(j.name, 0.0))

            limits = (-np.inf, np.inf)
            if j.limit is not None and j.type in ("revolute", "prismatic"):
                limits = (float(j.limit.lower or 0.0), float(j.limit.upper or 0.0))
            friction = 0.0 if j.dynamics is None else float(j.dynamics.friction or 0.0)
            damping = 0.0 if j.dynamics is None else float(j.dynamics.damping or 0.0)
            mimic = (
                None if j.mimic is None else (j.mimic.joint, 1.0 if j.mimic.multiplier is None else j.mimic.multiplier)
            )

            joints[j.name] = RobotJoint(
                j.name,
                j.type,
                j.parent,
                j.child,
                frame,
                frame[:3, :3] @ axis,
                limits,
                damping,
                friction,
                mimic,
                start.get(j.name, 0.0),
            )
    return frames, joints


def _moved(kind: str, axis: Array, value: float) -> Array:
    """The motion (4, 4) of a joint by an angle or displacement."""
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    unit = axis / (np.linalg.norm(axis) or 1.0)
    if kind == "prismatic":
        out[:3, 3] = value * unit
    elif kind in ("revolute", "continuous"):
        out[:3, :3] = Rotation.from_rotvec(value * unit).as_matrix()
    return out


def _bodies(path: Path, model: Any, tree: tuple[str, dict[str, Array], dict[str, RobotJoint]]) -> tuple[Any, Any]:
    """Rigid bodies of the links with mass, and the link that carries each link."""
    root, frames, joints = tree
    held = {j.child: j for j in joints.values()}
    bodies: dict[str, Any] = {}
    carrier = {root: root}
    of = {link.name: link for link in model.links}

    for name in frames:  # parents come before children
        if name == root:
            continue
        inertial, joint = of[name].inertial, held[name]
        if inertial is None or not inertial.mass:
            if joint.kind != "fixed":
                raise InputError(
                    f'{path}: link "{name}" has no mass but moves by joint "{joint.name}" ({joint.kind}). Give it an inertial.'
                )
            carrier[name] = carrier[joint.parent]
            continue

        require(inertial.inertia is not None, f'{path}: link "{name}" has a mass without <inertia>. Give it one.')
        place = frames[name] @ (np.eye(4) if inertial.origin is None else inertial.origin)
        bodies[name] = RigidBody(
            name, float(inertial.mass), np.asarray(inertial.inertia), position=place[:3, 3], rotation=place[:3, :3]
        )
        carrier[name] = name
    return bodies, carrier
