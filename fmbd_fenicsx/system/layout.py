"""Where everything of a scene stands in the arrays of a state. The only home of offsets.

A state is four flat arrays: configuration q, velocity v, acceleration a, multipliers lambda. v and a hold the *core*, equal on
every rank (the twists of all frames, then the coordinates of small parts such as reduced bodies), then the local
coordinates of each elastic field (this rank's nodes); q holds poses instead of twists, and after them the counted angles
(:mod:`..mechanics.joints.counted`), which have no increments of their own. lambda holds the rows of the joints,
then the frame conditions of the elastic bodies; it is replicated. Velocities are quasi-velocities: angular velocities in
body axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import InputError, near
from ..mechanics.bodies.port_constraint import PortConstraint
from ..mechanics.forces.force_elements import Loads
from ..mechanics.frames import Markers
from ..mechanics.joints.constraints import Batch
from ..mechanics.joints.counted import CountedAngles
from ..mechanics.placements import DistributedPart, FrameElements, Part, RigidBlock, is_distributed
from ..ranks import rank_sums
from ..rotations import Array, Motions
from .gravity import Gravity


@dataclass(frozen=True)
class State:
    """One instant: time t (s), configuration q, velocity v, acceleration a, multipliers lam (see the module)."""

    t: float
    q: Array
    v: Array
    a: Array
    lam: Array


@dataclass(frozen=True)
class States:
    """Many of them, with the instant as the first axis: t (k, 1), q (k, n_q), .."""

    t: Array
    q: Array
    v: Array
    a: Array
    lam: Array

    def __len__(self) -> int:
        return len(self.t)

    @classmethod
    def of(cls, states: Sequence[State]) -> States:
        """These together."""
        rows = {name: np.array([getattr(s, name) for s in states]) for name in ("q", "v", "a", "lam")}
        return cls(np.array([[s.t] for s in states]), **rows)

    @property
    def times(self) -> list[float]:
        """When, s."""
        return [float(t) for t in self.t[:, 0]]

    def state(self, i: int) -> State:
        """One of them."""
        return State(float(self.t[i, 0]), self.q[i], self.v[i], self.a[i], self.lam[i])

    def each(self) -> list[State]:
        """All of them, one by one."""
        return [self.state(i) for i in range(len(self))]

    def chosen(self, which: np.ndarray) -> States:
        """Some of them."""
        return States(self.t[which], self.q[which], self.v[which], self.a[which], self.lam[which])

    def put(self, which: np.ndarray, others: States) -> None:
        """Write others in the place of some."""
        for name in ("t", "q", "v", "a", "lam"):
            getattr(self, name)[which] = getattr(others, name)


ATTITUDE = "attitude"  # the kind of rows that hold the attitude of a body without any


@dataclass(frozen=True)
class RowBlock:
    """Names a block of constraint rows: the joint (or body frame) it comes from, and the joint's two markers; ``narrow``: size
    (m) of its surface, where that is hardly anything of the body.
    """

    name: str
    rows: slice
    kind: str
    a: int = -1
    b: int = -1
    narrow: float = 0.0

    @property
    def told(self) -> str:
        """The joint or frame in messages."""
        if self.kind == "frame":
            return self.name
        on = f", on a surface of {self.narrow:.1e} m" if self.narrow else ""
        return f'joint "{self.name}" ({self.kind}{on})'


NOBODY = RowBlock("a constraint", slice(0, 0), "frame")


@dataclass(frozen=True, eq=False)
class Layout:
    """All bodies, constraints and forces of a scene, and where each stands in the arrays; see the module."""

    motions: Motions
    frame_names: tuple[str, ...]
    rigid: RigidBlock | None
    parts: tuple[Part, ...]  # those in the core first, then the distributed ones
    markers: Markers
    batches: tuple[tuple[Batch, np.ndarray], ...]  # with the numbers of their rows in lambda
    port_constraints: tuple[tuple[PortConstraint, slice], ...]
    forces: tuple[Loads, ...]
    gravity: Gravity
    blocks: tuple[RowBlock, ...]
    length: float  # characteristic length of the model, m
    mass: float  # total mass, kg
    ground: Array = field(repr=False, default_factory=lambda: np.zeros((1, 0)))  # pose of the ground, (1, n_pose)
    contacts: Any = None  # ContactSet of a scene with contact
    traces: tuple[tuple[Any, slice], ...] = ()  # ties by field multipliers (TraceRows) and their rows
    counted: CountedAngles | None = None  # None where nothing depends on an angle beyond a turn
    elements: tuple[FrameElements, ...] = ()  # between moving frames: rods
    sensed: tuple[tuple[Any, int], ...] = ()  # sensors of the scene with their markers
    remembered: tuple[Any, ...] = ()  # what keepers remember at the start, None of those that begin anew; empty: all do
    cache: dict[Any, Any] = field(repr=False, default_factory=dict)  # patterns found at first use

    def block(self, name: str) -> RowBlock:
        """The rows of the named joint."""
        for block in self.blocks:
            if block.name == name:
                return block
        raise InputError(f'No joint "{name}". {near(name, [b.name for b in self.blocks])}')

    def part(self, name: str) -> tuple[int, Any]:
        """Number and part of the named body."""
        for k, part in enumerate(self.parts):
            if part.name == name:
                return k, part
        raise InputError(f'Body "{name}" has no part in this system. {near(name, [p.name for p in self.parts])}')

    # -- sizes --------------------------------------------------------------------------------------------------
    @cached_property
    def n_frames(self) -> int:
        """Moving frames."""
        return len(self.frame_names)

    @cached_property
    def keepers(self) -> tuple[Any, ...]:
        """Force elements and elements between frames with a memory, see :mod:`.element_memory`."""
        return (*[f for f in self.forces if f.kept is not None], *[e for e in self.elements if e.kept is not None])

    @cached_property
    def prescribes(self) -> bool:
        """Whether what joints, ties or equations of the user's own prescribe may depend on time."""
        return bool(any(batch.driven for batch, _ in self.batches) or self.traces or self.port_constraints)

    @cached_property
    def pushes_in_time(self) -> bool:
        """Whether the balance of a state that is held may depend on time: by loads, laws, gravity, or rows that turn."""
        told = self.forces or self.elements or self.traces or self.port_constraints or not self.gravity.steady
        return bool(told) or any(x.of_time for x in self.parts) or any(batch.of_time for batch, _ in self.batches)

    @cached_property
    def fields(self) -> tuple[tuple[int, DistributedPart], ...]:
        """Distributed parts with their numbers."""
        return tuple((k, p) for k, p in enumerate(self.parts) if is_distributed(p))

    def field_number(self, k: int) -> int:
        """Which of the fields the part with this number is."""
        return next(i for i, (part, _) in enumerate(self.fields) if part == k)

    @cached_property
    def core_parts(self) -> tuple[tuple[int, Part], ...]:
        """Replicated parts with their numbers."""
        return tuple((k, p) for k, p in enumerate(self.parts) if not p.distributed)

    @cached_property
    def curved(self) -> tuple[tuple[int, Any], ...]:
        """Parts whose ports are of second order, with their numbers (:mod:`..mechanics.elastic.foreshortening`)."""
        return tuple((k, p) for k, p in enumerate(self.parts) if p.shortening is not None)

    @cached_property
    def leaves_out(self) -> bool:
        """Whether Newton's matrix lacks terms of the motion of a part."""
        return any(p.leaves_out for p in self.parts)

    @cached_property
    def n_core(self) -> int:
        """Replicated velocity components: frames and replicated parts."""
        return self.n_frames * self.motions.n_twist + sum(p.n for _, p in self.core_parts)

    @cached_property
    def slices(self) -> tuple[list[slice], list[slice], list[slice]]:
        """Slices of each part in q, in v, and in the ports."""
        q = self.counted_angles.stop
        v = self.n_frames * self.motions.n_twist
        p = 0
        in_q, in_v, in_p = [], [], []
        for part in self.parts:
            in_q.append(slice(q, q + part.n))
            in_v.append(slice(v, v + part.n))
            in_p.append(slice(p, p + part.n_port))
            q, v, p = q + part.n, v + part.n, p + part.n_port
        return in_q, in_v, in_p

    def block_of(self, row: int) -> RowBlock:
        """The joint or frame that a constraint row belongs to."""
        return next((b for b in self.blocks if b.rows.start <= row < b.rows.stop), NOBODY)

    def body_of(self, k: int) -> str:
        """The name of the body that a component of v belongs to."""
        frame = k // self.motions.n_twist
        if frame < self.n_frames:
            return self.frame_names[frame]
        return next(p.name for p, own in zip(self.parts, self.slices[1], strict=True) if own.start <= k < own.stop)

    @cached_property
    def n_q(self) -> int:
        """Length of q on this rank."""
        return self.counted_angles.stop + sum(p.n for p in self.parts)

    @cached_property
    def counted_angles(self) -> slice:
        """Slice of the counted angles in q."""
        poses = self.n_frames * self.motions.n_pose
        return slice(poses, poses + (0 if self.counted is None else self.counted.count))

    @cached_property
    def n_v(self) -> int:
        """Length of v and a on this rank."""
        return self.n_frames * self.motions.n_twist + sum(p.n for p in self.parts)

    @cached_property
    def n_port(self) -> int:
        """Ports of all parts."""
        return sum(p.n_port for p in self.parts)

    @cached_property
    def n_rows(self) -> int:
        """Rows of joints."""
        shared = {(r.start, r.stop) for _, r in (*self.port_constraints, *self.traces)}  # two laws may share a row
        return sum(len(r) for _, r in self.batches) + sum(stop - start for start, stop in shared)

    @cached_property
    def n_lam(self) -> int:
        """Multipliers: joint rows and frame conditions."""
        return self.n_rows + sum(p.n_frame_rows for p in self.parts)

    @cached_property
    def frame_rows(self) -> list[slice]:
        """Rows of the frame conditions of each part."""
        out, k = [], self.n_rows
        for f in self.parts:
            out.append(slice(k, k + f.n_frame_rows))
            k += f.n_frame_rows
        return out

    @cached_property
    def comm(self) -> Any:
        """Communicator of the elastic fields, None when there are none."""
        return self.fields[0][1].comm if self.fields else None

    # -- parts of the arrays --------------------------------------------------------------------------------------
    def poses(self, q: Array) -> Array:
        """Poses of all frames, the ground last, (n_frames + 1, n_pose)."""
        n = self.n_frames * self.motions.n_pose
        return np.concatenate((q[:n].reshape(-1, self.motions.n_pose), self.ground))

    def frame_poses(self, q: Array) -> Array:
        """Poses of the moving frames in arrays q (.., n_q): (.., n_frames, n_pose)."""
        n = self.motions.n_pose
        return q[..., : self.n_frames * n].reshape(*q.shape[:-1], self.n_frames, n)

    def twists(self, v: Array) -> Array:
        """Twists (or their rates) of all frames, the ground last, (n_frames + 1, n_twist)."""
        out = np.zeros((self.n_frames + 1, self.motions.n_twist))
        out[:-1] = v[: self.n_frames * self.motions.n_twist].reshape(-1, self.motions.n_twist)
        return out

    def turning(self, v: Array) -> Array:
        """Angular speeds of all frames, the ground last, (n_frames + 1,), rad/s."""
        spins = self.twists(v)[:, self.motions.dim :]
        return np.asarray(np.sqrt(np.add.reduce(spins * spins, axis=1)))

    def pose_of(self, q: Array, k: int) -> Array:
        """Pose of frame k, or of the ground behind the last, in arrays q (.., n_q): (.., n_pose)."""
        n = self.motions.n_pose
        if k < self.n_frames:
            return q[..., n * k : n * (k + 1)]
        return np.broadcast_to(self.ground[0], (*q.shape[:-1], n))

    def twist_of(self, v: Array, k: int) -> Array:
        """Twist of the same frame in arrays v (.., n_v), or its rate: (.., n_twist)."""
        n = self.motions.n_twist
        return v[..., n * k : n * (k + 1)] if k < self.n_frames else np.zeros((*v.shape[:-1], n))

    def local_q(self, q: Array, k: int) -> Array:
        """Local coordinates of part k in q, (.., n)."""
        return q[..., self.slices[0][k]]

    def local_v(self, v: Array, k: int) -> Array:
        """Local coordinates of part k in v or a, (.., n)."""
        return v[..., self.slices[1][k]]

    def ports(self, x: Array, t: float, *, rates: bool = False) -> Array:
        """Ports of all parts at time t (s) for an array like q, or their ``rates`` for one like v; collective."""
        out = np.zeros(self.n_port)
        in_q, in_v, in_p = self.slices
        local = [x[s] for s in (in_v if rates else in_q)]
        for k, f in self.core_parts:
            out[in_p[k]] = f.ports_of(local[k], t)
        if self.fields:
            ports = self.field_ports([local[k] for k, _ in self.fields], t)
            for (k, _), own in zip(self.fields, ports, strict=True):
                out[in_p[k]] = own
        if not rates:
            for f, p in zip(self.parts, in_p, strict=True):
                out[p] += f.reference
        return out

    def field_ports(self, local: Sequence[Array], t: float) -> list[Array]:
        """Ports without their reference part for local vectors of all fields, in one sum over the ranks; collective."""
        return self.field_sums([p.port_shares(w, t) for (_, p), w in zip(self.fields, local, strict=True)])

    def field_sums(self, shares: Sequence[Array | None]) -> list[Any]:
        """Sums over the ranks of what their nodes of each field have, in one message, None of those without; of a field that each
        rank holds whole, as wires are, it is all there is. Collective.
        """
        sums = list(shares)
        apart = [i for i, (_, p) in enumerate(self.fields) if p.comm.size > 1 and shares[i] is not None]
        for i, total in zip(apart, rank_sums(self.comm, [shares[i] for i in apart]), strict=True):
            sums[i] = total
        return sums

    def port_slice(self, k: int) -> slice:
        """Ports of part k."""
        return self.slices[2][k]

    # -- inner products over all ranks -----------------------------------------------------------------------------
    def dot(self, x: Array, y: Array) -> Any:
        """x . y for arrays like v, a number; of rows x (.., n_v), one for each of them. Collective."""
        shares = [np.array(self.local_v(x, k) @ self.local_v(y, k)) for k, _ in self.fields]
        return x[..., : self.n_core] @ y[: self.n_core] + sum(self.field_sums(shares))

    def finite(self, *given: Array) -> bool:
        """Whether all numbers of some arrays are finite; collective."""
        local = all(map(np.logical_and.reduce, map(np.isfinite, given)))
        return local if not self.fields or self.comm.size == 1 else all(self.comm.allgather(local))
