"""Scenes that go on where a run of another one has ended: with joints released, closed or locked, parts let go or taken up.

Bodies of the same names are where they were, as fast as they were; others begin as they are given. A joint that was not there
closes on what it finds: its point and its axes are those of its first body, its second body is taken where it is,

    x_b = x_a,   R_b = R_a        of the markers of the joint in the state that the scene goes on from.             (1)

A mass at a point has one place: caught by a joint it takes hold of the first body where it is.

Velocities that contradict it go as in an impact without rebound: those nearest in the metric of the masses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import require
from ...log import log
from ...mechanics.bodies.bodies import RigidBody
from ...mechanics.forces.force_elements import Loads
from ...mechanics.joints.drives import Coupling
from ...mechanics.joints.joints import Joint
from ...rotations import Array
from ..configurations import count
from ..layout import State
from ..system import System
from .point_masses import NEAR

if TYPE_CHECKING:
    from .scene import Scene


@dataclass(frozen=True, eq=False)
class Origin:
    """What a scene goes on from: the scene that was run, its system, its last state, and what its elements remember then."""

    scene: Scene
    system: System
    state: State
    kept: tuple[Any, ...]

    def closes(self, joint: Joint) -> bool:
        """Whether a joint closes on what it finds: a new one between two bodies that meet."""
        known = self.scene.joints.get(joint.name) is joint
        return not known and joint.joined and not isinstance(joint, Coupling)

    def closed(self, joint: Joint) -> Origin | None:
        """The origin in whose state a joint of the scene closed on what it found, this or one before; None of all others."""
        if self.closes(joint):
            return self
        before = self.scene.origin
        return None if before is None else before.closed(joint)


@dataclass(frozen=True, eq=False)
class Closing:
    """A joint that closes in the state of an ``origin``: its second marker is seated where the first is, of a caught mass the
    first where that is.
    """

    joint: Joint
    a: int
    b: int
    origin: Origin

    @property
    def caught(self) -> bool:
        """Whether its second body is a mass at a point, which takes hold of the first one where it is."""
        side = self.joint.b
        return isinstance(side, RigidBody) and not side.turns


def go_on(origin: Origin, system: System, given: State, closing: Sequence[Closing]) -> tuple[System, State]:
    """A system as its scene gives it, and its state, in that of the origin; ``closing``: joints that have closed since the first
    scene. Collective.
    """
    for past in dict.fromkeys(x.origin for x in closing):
        system = _seated(system, _found(past, system, given), [x for x in closing if x.origin is past])
    state = _found(origin, system, given)
    count(system, state.q)
    system = replace(system, remembered=tuple(_memory(origin, keeper) for keeper in system.keepers), cache={})
    return system, state


def _found(origin: Origin, system: System, given: State) -> State:
    """The state of a system whose bodies are as an origin has left them."""
    q, v = given.q.copy(), given.v.copy()
    _take_bodies(origin, system, q, v)
    count(system, q)
    _take_angles(origin, system, q)
    return State(origin.state.t, q, v, given.a, given.lam)


def _take_bodies(origin: Origin, system: System, q: Array, v: Array) -> None:
    """Places and velocities of the bodies that were there, in q and v."""
    was, s = origin.system, origin.state
    n, m = system.motions.n_pose, system.motions.n_twist
    frames = {name: i for i, name in enumerate(was.frame_names)}
    for i, name in enumerate(system.frame_names):
        if name in frames:
            q[n * i : n * (i + 1)] = was.pose_of(s.q, frames[name])
            v[m * i : m * (i + 1)] = was.twist_of(s.v, frames[name])

    parts = {part.name: k for k, part in enumerate(was.parts)}
    for k, part in enumerate(system.parts):
        before = parts.get(part.name)
        if before is None:
            continue
        have = was.parts[before].n
        require(
            part.n == have,
            f'Body "{part.name}" has {part.n} coordinates here and {have} in the run that the scene goes on from. Go on with the '
            "body of that run.",
        )
        q[system.slices[0][k]] = was.local_q(s.q, before)
        v[system.slices[1][k]] = was.local_v(s.v, before)


def _take_angles(origin: Origin, system: System, q: Array) -> None:
    """Turns that joints have counted, in q."""
    before, now = _counted(origin.system), _counted(system)
    for name in before.keys() & now.keys():
        q[system.counted_angles.start + now[name]] = origin.state.q[origin.system.counted_angles.start + before[name]]


def _counted(system: System) -> dict[str, int]:
    """Which angle in q is counted for which joint."""
    if system.counted is None:
        return {}
    turn = system.counted.turn
    pairs = {(int(a), int(b)): i for i, (a, b) in enumerate(zip(turn.a, turn.b, strict=True))}
    return {x.name: pairs[x.a, x.b] for x in system.blocks if (x.a, x.b) in pairs}


def _seated(system: System, state: State, closing: Sequence[Closing]) -> System:
    """The system with the second markers of new joints where (1) wants them, of caught masses the first ones; collective."""
    kin, markers = system.at(state.t, state.q, state.v).kin, system.markers
    a, b = np.array([(x.a, x.b) for x in closing]).T
    caught: np.ndarray = np.array([x.caught for x in closing])
    _refuse_away(system, closing, kin.x[a] - kin.x[b])
    rotation, position = markers.rotation.copy(), markers.position.copy()
    back = markers.rotation @ kin.R.swapaxes(1, 2)  # to the axes of what carries a marker
    rotation[b] = back[b] @ kin.R[a]
    moved, other = np.where(caught, a, b), np.where(caught, b, a)
    position[moved] += (back[moved] @ (kin.x[other] - kin.x[moved])[..., None])[..., 0]
    markers = replace(markers, rotation=rotation, position=position)

    counted = system.counted
    if counted is not None:
        start = counted.start.copy()
        if kin.turned is not None and system.motions.dim == 2:
            start[b] += kin.turned[b] - kin.turned[a]
        counted = replace(counted, markers=markers, start=start)
    return replace(system, markers=markers, counted=counted, cache={})


def _refuse_away(system: System, closing: Sequence[Closing], gaps: Array) -> None:
    """Refuse a joint whose point was given for its first body, and is not where the mass that it catches is."""
    for new, gap in zip(closing, gaps, strict=True):
        off = float(np.linalg.norm(gap))
        require(
            not new.caught or new.joint.center_a is None or off <= NEAR * system.length,
            f'Joint "{new.joint.name}" catches mass "{new.joint.b.name}" {off:.3g} m away from where the mass is: center is a '
            "point of the first body, as that was placed at first. Leave it out, and the joint takes hold where the mass is.",
        )


def _memory(origin: Origin, keeper: Any) -> Any:
    """What elements remember that were there, all of their kind; None of others, which begin anew."""
    owners = _owners(keeper)
    before: set[Any] = set()
    for one, kept in zip(origin.system.keepers, origin.kept, strict=False):
        if type(one) is type(keeper):
            if _owners(one) == owners:
                return kept
            before.update(_owners(one))

    if forgotten := before.intersection(owners):
        log.warning(
            'the memory of "%s" begins anew: those elements of its kind that are in the scene are not those of the run that it '
            "goes on from", '", "'.join(sorted(map(str, forgotten))),
        )  # fmt: skip
    return None


def _owners(keeper: Any) -> tuple[Any, ...]:
    """Whose memory it is: names of forces, or the frames between which elements are."""
    return tuple(f.name for f in keeper.forces) if isinstance(keeper, Loads) else (keeper.name, keeper.frames.shape)
