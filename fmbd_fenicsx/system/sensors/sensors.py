"""Sensors: named quantities recorded in every run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...checks import shown, typed, vector
from ...errors import InputError, near, require
from ...mechanics.bodies.bodies import RigidBody, Surface
from ...mechanics.joints.drives import JointCoordinate, coordinates_of
from ...mechanics.joints.joints import Ground, ground, refuse_no_attachment
from ...mechanics.joints.relative import RelativeCoordinates, nearest
from ...mechanics.joints.sums import Coordinate, NamedCoordinate
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State
from ..tangents.foreshortened_ports import port_acceleration
from .named import OfNamed
from .sensor import OfStates, Sensor, named_part


class _Vector(Sensor):
    @property
    def labels(self) -> Sequence[str]:
        return "xyz"


class _Motion(_Vector):
    """Of a marker."""

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The marker."""
        return Look(marker)


class Position(_Motion):
    """World position of a point or of a surface's mean, (d,)."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """x, m."""
        return ev.kin.x[marker].copy()

    def series(self, seen: Recorded, marker: int) -> Array:
        """x, m."""
        return seen.place(marker)


class Velocity(_Motion):
    """World velocity of a point or of a surface's mean, (d,)."""

    derivative = 1

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """x', m/s."""
        assert ev.kin.twist is not None
        return ev.kin.twist[marker, : ev.kin.x.shape[1]].copy()

    def series(self, seen: Recorded, marker: int) -> Array:
        """x', m/s."""
        return seen.twist(marker)[:, : seen.system.motions.dim]


class AngularVelocity(_Motion):
    """World angular velocity of a body or of a surface's mean, (n_rot,)."""

    derivative = 1

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """w, rad/s."""
        assert ev.kin.twist is not None
        return ev.kin.twist[marker, ev.kin.x.shape[1] :].copy()

    def series(self, seen: Recorded, marker: int) -> Array:
        """w, rad/s."""
        return seen.twist(marker)[:, seen.system.motions.dim :]


class Acceleration(_Vector):
    """World acceleration of a point or of a surface's mean, (d,)."""

    derivative = 2

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """x'', m/s^2, from the recorded accelerations."""
        s = ev.system
        m = s.markers
        kin = ev.kin
        assert kin.bias is not None
        out = kin.bias[marker] + kin.jac_frame[marker] @ s.twists(state.a)[m.frame[marker]]
        # on a surface: with the second rates of its ports
        on = np.flatnonzero(m.surface == marker)
        if on.size:
            out = out + kin.jac_port[on[0]] @ port_acceleration(ev, state.a)[m.port[on[0]]]
        return np.asarray(out[: kin.x.shape[1]])

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The marker."""
        return Look(marker, accelerated=True)

    def series(self, seen: Recorded, marker: int) -> Array:
        """x'', m/s^2."""
        return seen.acceleration(marker)


class Rotation(Sensor):
    """Rotation since the start: the angle (plane) or the matrix row by row (space)."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Angle (rad) in the plane, the rotation matrix row by row in space."""
        R = ev.kin.R[marker]
        if R.shape[0] == 3:
            return np.asarray(R.ravel().copy())
        assert ev.kin.angle is not None
        return nearest(np.arctan2(R[1, 0], R[0, 0]), ev.kin.angle[[marker]])

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The marker."""
        return Look(marker, angled=True)

    def series(self, seen: Recorded, marker: int) -> Array:
        """Angle or rotation matrix."""
        return seen.angle(marker) if seen.dim == 2 else seen.rotation(marker)


@dataclass(frozen=True, eq=False)
class Reaction(Sensor):
    """Multipliers of a joint: force (and torque) components on the first body, one a row of the joint."""

    joint: str = ""
    units: tuple[str, ...] = ()  # of the rows, once the joint is known
    derivative = 2

    @property
    def reads(self) -> dict[str, str]:
        """A joint, or another part with constraint rows."""
        return {"joint": self.joint}

    def in_scene(self, name: str, scene: Any) -> Sensor:
        """With the units of the joint's rows: forces, and moments where a row holds a rotation."""
        joints = scene.joints
        units = joints[self.joint].reaction_units if self.joint in joints else ()
        return replace(self, units=units, unit=", ".join(sorted(set(units))) or self.unit)

    def unit_of(self, component: int) -> str:
        """N or N m."""
        return self.units[component] if component < len(self.units) else self.unit

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The multipliers of the joint."""
        for block in ev.system.blocks:
            if block.name == self.joint:
                return state.lam[block.rows].copy()
        raise InputError(f'No reaction of "{self.joint}". {near(self.joint, (b.name for b in ev.system.blocks))}')

    def looks_at(self, system: Layout, marker: int) -> Look:
        """All multipliers."""
        return Look(rows=True)

    def series(self, seen: Recorded, marker: int) -> Array:
        """The multipliers of the joint."""
        return seen.lam[:, seen.system.block(self.joint).rows]


@dataclass(frozen=True, eq=False)
class ReactionWrench(_Vector):
    """Force (N) or torque (N m) of a joint on its first body, world axes, at the joint's point of that body."""

    joint: str = ""
    torque: bool = False
    derivative = 2

    @property
    def reads(self) -> dict[str, str]:
        """A joint."""
        return {"joint": self.joint}

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Force and moment of the joint on its first body."""
        block = ev.system.block(self.joint)
        d = ev.system.motions.dim
        wrench = np.zeros(d + ev.system.motions.n_rot)
        known = block.rows.start == block.rows.stop

        for batch, rows in ev.system.batches:
            inside = (rows >= block.rows.start) & (rows < block.rows.stop)
            if not inside.any():
                continue
            known = True
            for number, markers, side in batch.sides(ev.kin, ev.t):
                # what the joint's rows exert on its first body
                at = inside[number] & (markers == block.a)
                wrench -= state.lam[rows[number[at]]] @ side[at]
        # zeros would be taken for an answer
        require(
            known,
            f'Force and torque of "{self.joint}" cannot be read as those of a joint between two points: they are spread over a '
            "surface or act on coordinates. fmbd.reaction gives its multipliers.",
        )
        return wrench[d:] if self.torque else wrench[:d]

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The joint."""
        return Look(joint=self.joint)

    def series(self, seen: Recorded, marker: int) -> Array:
        """Force or moment of the joint on its first body."""
        wrench = seen.wrench(self.joint)
        d = seen.system.motions.dim
        return wrench[:, d:] if self.torque else wrench[:, :d]


@dataclass(frozen=True, eq=False)
class JointReading(Sensor):
    """A joint coordinate (derivative 0) or its rate (1), see :func:`fmbd_fenicsx.angle` and ``displacement``."""

    coordinate: Coordinate = None  # type: ignore[assignment]
    derivative: int = 0

    @property
    def coordinates(self) -> tuple[JointCoordinate, ...]:
        """The one, or those that it is the sum of."""
        return self.coordinate.coordinates

    @property
    def reads(self) -> dict[str, str]:
        """The joint of the first of them."""
        return {"joint": named_part("joint", self.coordinate.joint)}

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Value and rate of the joint coordinate."""
        relative = self._relative(ev.system)
        return relative.rates(ev.kin) if self.derivative else relative.values(ev.kin)

    def _relative(self, s: Layout) -> RelativeCoordinates:
        """The coordinate in a system."""
        key = f"reading {id(self)}"
        if key not in s.cache:
            # made once a system: sensors read it at every record
            blocks = [s.block(one.joint.name) for one in self.coordinates]
            s.cache[key] = coordinates_of(s.motions, [self.coordinate], {b.name: (b.a, b.b) for b in blocks})
        found: RelativeCoordinates = s.cache[key]
        return found

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The coordinate."""
        return Look(relative=self._relative(system))

    def series(self, seen: Recorded, marker: int) -> Array:
        """Value or rate of the joint coordinate."""
        return seen.reading(id(self))[:, :, 1 if self.derivative else 0]


@dataclass(frozen=True, eq=False)
class Coordinates(OfStates):
    """Coordinates of a :class:`~fmbd_fenicsx.CoordinateBody` (derivative 0), their rates (1) or second rates (2)."""

    body: str = ""
    derivative: int = 0
    names: Sequence[str] = ()

    @property
    def reads(self) -> dict[str, str]:
        """A body."""
        return {"body": self.body}

    @property
    def labels(self) -> Sequence[str]:
        """The names that were given."""
        return self.names

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """The coordinates of the body, or their rates, (.., n)."""
        for k, part in enumerate(system.parts):
            if part.name == self.body:
                found = system.local_v((v, a)[self.derivative - 1], k) if self.derivative else system.local_q(q, k)
                return found.copy()
        own = near(self.body, (p.name for p in system.parts))
        raise InputError(
            f'Body "{self.body}" has no coordinates beside its place and rotation: fmbd.coordinates reads those of reduced '
            f"bodies, lines and bodies by own equations. {own} Take fmbd.position and fmbd.rotation of rigid bodies."
        )


@typed
def coordinates(body: Any, *, level: int = 0, unit: str = "-", names: Sequence[str] = ()) -> Sensor:
    """Coordinates of a body with equations of its own or nodal values of a line, or their first or second rates, (n,).

    ``unit`` and ``names`` of these numbers, for figures.
    """
    require(level in (0, 1, 2), f"coordinates: level {shown(level)} must be 0, 1 or 2: values, first or second rates.")
    return Coordinates(None, unit, None, named_part("coordinates: body", body), level, tuple(names))


@typed
def joint_rate(coordinate: Coordinate | NamedCoordinate) -> Sensor:
    """Rate of a joint coordinate (rad/s or m/s), (1,); the coordinate itself is a sensor too."""
    return joint_reading(coordinate, 1)


def joint_reading(coordinate: Coordinate | NamedCoordinate, derivative: int = 0) -> Sensor:
    """The sensor of a coordinate, or of its rate."""
    if isinstance(coordinate, NamedCoordinate):
        named = coordinate
        return OfNamed(
            None, "", make=lambda joint: joint_reading(named.of(joint), derivative), parts="joints", name=named.name
        )
    return JointReading(None, coordinate.unit + "/s" * derivative, coordinate=coordinate, derivative=derivative)


def reaction_force(joint: Any) -> Sensor:
    """Force (N) that a joint exerts on its first body, world axes, (d,)."""
    return ReactionWrench(None, "N", None, named_part("reaction_force: joint", joint))


def reaction_torque(joint: Any) -> Sensor:
    """Torque (N m) that a joint exerts on its first body about the joint's point of that body, world axes, (n_rot,)."""
    return ReactionWrench(None, "N m", None, named_part("reaction_torque: joint", joint), True)


def _motion(what: str, kind: type[Sensor], on: Any, unit: str, point: Sequence[float] | None = None) -> Sensor:
    """The sensor of a kind on what bears a marker, a body also by its name; of a material point where ``on`` is an elastic body
    itself, with a point.
    """
    if isinstance(on, str):
        return OfNamed(
            None, unit, make=lambda body: _motion(what, kind, body(on), unit, point), parts="bodies", name=on
        )
    if point is not None and not isinstance(on, Surface | RigidBody | Ground):
        from .points import is_elastic, point_motion

        if is_elastic(on):
            return point_motion(what, on, point, kind.derivative)

    refuse_no_attachment(on, what)
    if point is not None:
        vector(f"{what}: point", point, size=None if on is ground else on.dim)
    return kind(on, unit, point)


def position(on: Any, *, point: Sequence[float] | None = None) -> Sensor:
    """World position (m): of a point of a rigid body (world coordinates at the start), of a surface's mean, or of a material
    point of an elastic body (``on`` the body itself, ``point`` in its mesh as it was placed). A body may be given by its name.
    """
    return _motion("position", Position, on, "m", point)


def velocity(on: Any, *, point: Sequence[float] | None = None) -> Sensor:
    """World velocity (m/s), as :func:`position`."""
    return _motion("velocity", Velocity, on, "m/s", point)


def acceleration(on: Any, *, point: Sequence[float] | None = None) -> Sensor:
    """World acceleration (m/s^2), as :func:`position`; of the state that the scheme ends the step with."""
    return _motion("acceleration", Acceleration, on, "m/s^2", point)


def rotation(on: Any | Surface) -> Sensor:
    """Rotation of a body or surface since the start: in the plane the angle (rad), counted over revolutions but for surfaces of
    bodies without a frame, in space the matrix (9 numbers).
    """
    return _motion("rotation", Rotation, on, "rad")


def angular_velocity(on: Any | Surface) -> Sensor:
    """Angular velocity (rad/s) of a body or of a surface's mean, world axes: one number in the plane, three in space."""
    return _motion("angular_velocity", AngularVelocity, on, "rad/s")


def reaction(joint: Any) -> Sensor:
    """Multipliers of a joint, (rows,): the force by the joint on its first body in the rows' directions (N, N m)."""
    return Reaction(None, "N", None, named_part("reaction: joint", joint))
