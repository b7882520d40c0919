"""Parts on the ground for the driver: in frames that rest. Bodies in absolute coordinates are floating fields there, whose frames
rest where the bodies were meshed.

The driver knows fields in moving frames, x = r + R (X + u). With r at the mass centre of the meshed body, R = 1 and no velocities
that is x = X + u, and inertia forces are M (u'' - g). So a system has a twin in which each absolute body has such a frame: poses
and twists (zero) of these stand behind those of the moving frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ....answers import answered_by
from ....mechanics.elastic.absolute import AbsoluteField
from ....mechanics.elastic.field_part import FieldPart
from ....mechanics.joints.trace_rows import TiedSide, TraceRows
from ....mechanics.placements import FrameMotion
from ....rotations import Array
from ...layout import State
from ...system import System
from ..blocks import Block


@answered_by("part", "renewable keeps_tangents foretells begins_anew mean_forces mean_force")
class RestingField(FieldPart):
    """An absolute field in a frame at rest; what is not linear of its forces stays with the field itself."""

    stiffening = None

    def __init__(self, part: AbsoluteField, frame: int) -> None:
        super().__init__(part.field, frame, [], part.conditions)
        field = part.field
        self.part, self.surfaces, self.n_port = part, part.surfaces, part.n_port
        self.traces = part.traces
        self.reference = part.reference.copy()
        per = field.dim * (1 + field.dim)
        for k in range(len(self.surfaces)):
            self.reference[k * per : k * per + field.dim] -= field.center

        self.size = np.inf  # of what displacements may be
        self.moment, self.inertia = np.zeros(field.dim), field.inertia
        self.turns = field.nonlinear  # its tangent turns with the body

    @property
    def began(self) -> Array:
        """Rotation of the body where the tangent was taken, and sum of (M X) X^T, (2, d, d)."""
        X = self.field.X
        return np.stack((self.part.turn_at_tangent, self.field.mass(X).T @ X))

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of the frame, zero, and forces on the nodes."""
        return self.part.force(motion, local)

    def held_force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of the frame, zero, and forces on the nodes without inertia and weight."""
        return np.zeros(self.motions.n_twist), self.part.held_force(motion.t, *local[:2])

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J."""
        return self.part.energies(motion, pose, local)

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin."""
        return self.part.momenta(motion, pose, local)


class RestingPart:
    """A part on the ground whose coordinates are no places, such as a line or wires, in a frame at rest; all else is its own."""

    def __init__(self, part: Any, frame: int) -> None:
        self.part, self.frame = part, frame

    def __getattr__(self, name: str) -> Any:
        return getattr(self.part, name)


class Twin:
    """A system without parts on the ground as its own twin: arrays are what they are."""

    # arrays like q and like v, (.., n), with the frames at rest, and without them
    configurations: Callable[[Array], Array] = staticmethod(np.asarray)
    velocities: Callable[[Array], Array] = staticmethod(np.asarray)
    places: Callable[[Array], Array] = staticmethod(np.asarray)
    forces: Callable[[Array], Array] = staticmethod(np.asarray)

    def __init__(self, system: System) -> None:
        self.original = self.system = system

    @property
    def kinds(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the core and every field end in arrays like v, of which norms take means each, and how much of it moves:
        frames at rest count for nothing.
        """
        ends = [self.system.n_core, *(self.system.slices[1][k].stop for k, _ in self.system.fields)]
        counts = [self.original.n_core, *(part.n for _, part in self.original.fields)]
        return np.array(ends, np.int32), np.array(counts, np.int32)

    def widened(self, block: Block) -> Block:
        """The parts of a block of the system as those of the twin."""
        return block

    def narrowed(self, block: Block) -> Block:
        """And back."""
        return block

    def state(self, state: State) -> State:
        """A state of the twin as one of the system."""
        return state


class RestingTwin(Twin):
    """The twin with a frame for each of the parts ``still``, which are on the ground."""

    def __init__(self, system: System, still: list[tuple[int, Any]]) -> None:
        m, n = system.motions, system.n_frames
        self._in_q, self._in_v = n * m.n_pose, n * m.n_twist

        parts: list[Any] = list(system.parts)
        for i, (k, part) in enumerate(still):
            parts[k] = RestingField(part, n + i) if isinstance(part, AbsoluteField) else RestingPart(part, n + i)
        places = (part.field.center if isinstance(part, AbsoluteField) else np.zeros(m.dim) for _, part in still)
        self._poses: Array = np.concatenate([m.pose(place) for place in places])
        self._twists: Array = np.zeros(len(still) * m.n_twist)
        names = (*system.frame_names, *(part.name for _, part in still))
        markers = replace(system.markers, frame=_frames(system, [k for k, _ in still]))
        ties = tuple((_tie(tie, parts, (n, len(names))), rows) for tie, rows in system.traces)
        made = replace(system, frame_names=names, parts=tuple(parts), markers=markers, traces=ties, cache={})
        super().__init__(made)
        self.original = system

    def configurations(self, q: Array) -> Array:
        """Arrays like q, (.., n_q), with the frames at rest."""
        return _wider(q, self._in_q, self._poses)

    def velocities(self, v: Array) -> Array:
        """Arrays like v, (.., n_v), with the frames at rest: they do not move."""
        return _wider(v, self._in_v, self._twists)

    def forces(self, x: Array) -> Array:
        """Arrays like v, (.., n_v), without the frames at rest."""
        return _narrower(x, self._in_v, len(self._twists))

    def places(self, q: Array) -> Array:
        """Arrays like q, (.., n_q), without the frames at rest."""
        return _narrower(q, self._in_q, len(self._poses))

    def widened(self, block: Block) -> Block:
        """The parts of a block of the system as those of the twin."""
        t, q, *rates, lam = block
        v, a, A = self.velocities(np.stack(rates))
        return t, self.configurations(q), v, a, A, lam

    def narrowed(self, block: Block) -> Block:
        """And back."""
        t, q, *rates, lam = block
        v, a, A = self.forces(np.stack(rates))
        return t, self.places(q), v, a, A, lam

    def state(self, state: State) -> State:
        """A state of the twin as one of the system."""
        v, a = self.forces(np.stack((state.v, state.a)))
        return replace(state, q=self.places(state.q), v=v, a=a)


def twin_of(system: System) -> Twin:
    """The twin of a system that the driver knows: parts on the ground have frames at rest."""
    still = [(k, part) for k, part in enumerate(system.parts) if part.frame == system.n_frames]
    return RestingTwin(system, still) if still else Twin(system)


def _wider(x: Array, at: int, more: Array) -> Array:
    """Arrays (.., n) with ``more`` put in at ``at``."""
    made = np.empty((*x.shape[:-1], x.shape[-1] + len(more)))
    end = at + len(more)
    made[..., :at], made[..., at:end], made[..., end:] = x[..., :at], more, x[..., at:]
    return made


def _narrower(x: Array, at: int, less: int) -> Array:
    """Arrays (.., n) without ``less`` of their entries from ``at`` on."""
    return np.concatenate((x[..., :at], x[..., at + less :]), axis=-1)


def _frames(system: System, still: list[int]) -> np.ndarray:
    """Frames of all markers, (n,): those on surfaces of the parts ``still`` have new ones, and the ground is behind these."""
    markers, n = system.markers, system.n_frames
    frame = np.where(markers.frame == n, n + len(still), markers.frame)
    for i, k in enumerate(still):
        ports = system.port_slice(k)
        on = (markers.port[:, 0] >= ports.start) & (markers.port[:, 0] < ports.stop)
        frame[markers.surface[on]] = n + i
    return frame


def _tie(tie: TraceRows, parts: list[Any], ground: tuple[int, int]) -> TraceRows:
    """A tie on the frames of the twin; ``ground``: the number of its frame before, and now."""

    def moved(side: TiedSide) -> TiedSide:
        part = None if side.part is None else parts[side.part]
        if isinstance(part, RestingField):  # places count from the centre of its frame
            return replace(side, frame=part.frame, s=side.s - side.m[:, None] * part.origin)
        return replace(side, frame=ground[1]) if side.frame == ground[0] else side

    a, b = tie.sides
    return replace(tie, sides=(moved(a), moved(b)))
