"""The system: blocks of unknowns side by side, balance of forces, constraints. The only home of offsets.

    balance      M(q) a + h(q, v, t) + G(q, t)^T lambda = 0                                     (1)
    constraints  g(q, t) = 0,    G v + g_t = 0,    G a + gamma(q, v, t) = 0                     (2)

A state is four flat arrays: configuration q, velocity v, acceleration a, multipliers lambda. v and a hold the twists of all
frames (replicated on every rank), then the local coordinates of each elastic field (this rank's nodes); q holds poses
instead of twists. lambda holds the rows of the joints, then the frame conditions of the elastic bodies; it is replicated.
Velocities are quasi-velocities: angular velocities in body axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from .constraints import Batch
from .errors import CallbackError
from .forces import Force
from .frames import Kinematics, Markers
from .placements import FloatingField, RigidBlock
from .rotations import Array, Motions

DENSE_LIMIT = 20_000  # entries of G up to which it is kept dense


@dataclass(frozen=True)
class State:
    """One instant: time t (s), configuration q, velocity v, acceleration a, multipliers lam (see the module)."""

    t: float
    q: Array
    v: Array
    a: Array
    lam: Array


@dataclass(frozen=True)
class RowBlock:
    """Names a block of constraint rows: the joint (or body frame) it comes from."""

    name: str
    rows: slice
    kind: str


@dataclass(frozen=True, eq=False)
class System:
    """All bodies, constraints and forces of a scene as arrays; see the module for the equations.

    ``rows`` holds, for each batch of elementary constraints, the numbers of its rows in lambda.
    """

    motions: Motions
    frame_names: tuple[str, ...]
    rigid: RigidBlock | None
    fields: tuple[FloatingField, ...]
    markers: Markers
    batches: tuple[tuple[Batch, np.ndarray], ...]
    forces: tuple[tuple[Force, int, int], ...]
    gravity: Callable[[float], Array]
    blocks: tuple[RowBlock, ...]
    length: float  # characteristic length of the model, m
    mass: float  # total mass, kg
    ground: Array = field(repr=False, default=None)  # type: ignore[assignment]  # (1, n_pose)

    # -- sizes --------------------------------------------------------------------------------------------------
    @property
    def n_frames(self) -> int:
        """Moving frames."""
        return len(self.frame_names)

    @cached_property
    def n_core(self) -> int:
        """Replicated velocity components."""
        return self.n_frames * self.motions.n_twist

    @cached_property
    def _field_slices(self) -> tuple[list[slice], list[slice], list[slice]]:
        """Slices of each field in q, in v, and in the ports."""
        q, v, p = self.n_frames * self.motions.n_pose, self.n_core, 0
        in_q, in_v, in_p = [], [], []
        for f in self.fields:
            in_q.append(slice(q, q + f.n))
            in_v.append(slice(v, v + f.n))
            in_p.append(slice(p, p + f.n_port))
            q, v, p = q + f.n, v + f.n, p + f.n_port
        return in_q, in_v, in_p

    @cached_property
    def n_q(self) -> int:
        """Length of q on this rank."""
        return self.n_frames * self.motions.n_pose + sum(f.n for f in self.fields)

    @cached_property
    def n_v(self) -> int:
        """Length of v and a on this rank."""
        return self.n_core + sum(f.n for f in self.fields)

    @cached_property
    def n_port(self) -> int:
        """Ports of all fields."""
        return sum(f.n_port for f in self.fields)

    @cached_property
    def n_rows(self) -> int:
        """Rows of joints."""
        return sum(len(r) for _, r in self.batches)

    @cached_property
    def n_lam(self) -> int:
        """Multipliers: joint rows and frame conditions."""
        return self.n_rows + sum(f.n_frame_rows for f in self.fields)

    @cached_property
    def frame_rows(self) -> list[slice]:
        """Rows of the frame conditions of each field."""
        out, k = [], self.n_rows
        for f in self.fields:
            out.append(slice(k, k + f.n_frame_rows))
            k += f.n_frame_rows
        return out

    @cached_property
    def comm(self) -> Any:
        """Communicator of the elastic fields, None when there are none."""
        return self.fields[0].field.comm if self.fields else None

    # -- parts of the arrays --------------------------------------------------------------------------------------
    def poses(self, q: Array) -> Array:
        """Poses of all frames, the ground last, (n_frames + 1, n_pose)."""
        n = self.n_frames * self.motions.n_pose
        return np.concatenate((q[:n].reshape(-1, self.motions.n_pose), self.ground))

    def twists(self, v: Array) -> Array:
        """Twists (or their rates) of all frames, the ground last, (n_frames + 1, n_twist)."""
        out = np.zeros((self.n_frames + 1, self.motions.n_twist))
        out[:-1] = v[: self.n_core].reshape(-1, self.motions.n_twist)
        return out

    def local_q(self, q: Array, k: int) -> Array:
        """Local coordinates of field k in q."""
        return q[self._field_slices[0][k]]

    def local_v(self, v: Array, k: int) -> Array:
        """Local coordinates of field k in v or a."""
        return v[self._field_slices[1][k]]

    def ports(self, x: Array, slices: list[slice], reference: bool) -> Array:
        """Port values of all fields for an array like q (reference added) or v; collective."""
        out = np.zeros(self.n_port)
        for f, s, p in zip(self.fields, slices, self._field_slices[2], strict=True):
            out[p] = f.ports_of(x[s])
            if reference:
                out[p] += f.reference
        return out

    def port_slice(self, k: int) -> slice:
        """Ports of field k."""
        return self._field_slices[2][k]

    # -- geometry of the configuration space ---------------------------------------------------------------------
    def compose(self, q: Array, xi: Array) -> Array:
        """Configuration after the increment xi (as v: body-axes rotation increments), q o exp(xi)."""
        n = self.n_frames * self.motions.n_pose
        frames = self.motions.compose(
            q[:n].reshape(-1, self.motions.n_pose), xi[: self.n_core].reshape(-1, self.motions.n_twist)
        )
        return np.concatenate((frames.ravel(), q[n:] + xi[self.n_core :]))

    def difference(self, q0: Array, q1: Array) -> Array:
        """The increment xi with compose(q0, xi) = q1."""
        n, p = self.n_frames * self.motions.n_pose, self.motions.n_pose
        frames = self.motions.difference(q0[:n].reshape(-1, p), q1[:n].reshape(-1, p))
        return np.concatenate((frames.ravel(), q1[n:] - q0[n:]))

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of local coordinates q o exp(xi) for the velocity v."""
        n = self.motions.n_twist
        frames = self.motions.rate(xi[: self.n_core].reshape(-1, n), v[: self.n_core].reshape(-1, n))
        return np.concatenate((frames.ravel(), v[self.n_core :]))

    # -- inner products over all ranks -----------------------------------------------------------------------------
    def dot(self, x: Array, y: Array) -> float:
        """x . y for arrays like v; collective."""
        core = float(x[: self.n_core] @ y[: self.n_core])
        if not self.fields:
            return core
        return core + float(self.fields[0].field.total(np.array(x[self.n_core :] @ y[self.n_core :])))

    def max_abs(self, x: Array) -> float:
        """Largest absolute entry of an array like v; collective."""
        local = float(np.abs(x).max(initial=0.0))
        return local if not self.fields else float(np.max(self.comm.allgather(local)))

    def at(self, t: float, q: Array, v: Array | None = None) -> Evaluation:
        """The system in one configuration (and velocity); collective."""
        return Evaluation(self, t, q, v)


class Evaluation:
    """Everything that (1) and (2) need at (t, q, v), each computed at most once. Methods are collective."""

    def __init__(self, system: System, t: float, q: Array, v: Array | None) -> None:
        self.system, self.t, self.q, self.v = system, t, q, v
        self.pose = system.poses(q)
        in_q, in_v, _ = system._field_slices
        port = system.ports(q, in_q, True)
        self.port = port
        if v is None:
            self.kin = system.markers.evaluate(self.pose, None, port, None)
        else:
            self.twist = system.twists(v)
            self.port_rate = system.ports(v, in_v, False)
            self.kin = system.markers.evaluate(self.pose, self.twist, port, self.port_rate)

    @cached_property
    def rotation(self) -> Array:
        """Rotation matrices of the frames, (n_frames + 1, d, d)."""
        return self.system.motions.matrix(self.pose)

    # -- constraints ------------------------------------------------------------------------------------------------
    def constraint(self) -> Array:
        """g(q, t), (n_lam,)."""
        s = self.system
        g = np.zeros(s.n_lam)
        for batch, rows in s.batches:
            g[rows] = batch.values(self.kin, self.t)
        for k, rows in enumerate(s.frame_rows):
            g[rows] = self.port[s.port_slice(k)][: s.fields[k].n_frame_rows]
        return g

    @cached_property
    def jacobian(self) -> Jacobian:
        """G = dg/dv."""
        return Jacobian(self)

    def constraint_rate(self) -> Array:
        """g_t, the part of dg/dt that does not come from v, (n_lam,)."""
        g = np.zeros(self.system.n_lam)
        for batch, rows in self.system.batches:
            g[rows] = batch.rate(self.kin, self.t)
        return g

    def gamma(self) -> Array:
        """g'' - G a, (n_lam,)."""
        assert self.v is not None and self.kin.bias is not None
        g = np.zeros(self.system.n_lam)
        for batch, rows in self.system.batches:
            ra, rb = batch.rows(self.kin, self.t)
            bias = self.kin.bias
            g[rows] = batch.gamma(self.kin, self.t) + (ra * bias[batch.a] + rb * bias[batch.b]).sum(1)
        return g

    # -- balance ----------------------------------------------------------------------------------------------------
    def wrenches(self) -> Array:
        """Applied wrenches on all markers in world axes, (n_markers, d + n_rot)."""
        s = self.system
        out = np.zeros(self.kin.jac_frame.shape[:2])
        for force, a, b in s.forces:
            wa, wb = force.wrench(self.kin, a, b, self.t)
            out[a] += wa
            out[b] += wb
        return out

    def spread(self, wrench: Array) -> Array:
        """Generalised forces of wrenches on the markers: the transpose of the marker Jacobians, like v."""
        s, m = self.system, self.system.markers
        core = np.zeros((s.n_frames + 1, s.motions.n_twist))
        np.add.at(core, m.frame, (self.kin.jac_frame.swapaxes(1, 2) @ wrench[..., None])[..., 0])
        port = np.zeros(s.n_port)
        if m.surface.size:
            np.add.at(port, m.port, (self.kin.jac_port.swapaxes(1, 2) @ wrench[m.surface][..., None])[..., 0])
        return self.gather(core[:-1].ravel(), port)

    def gather(self, core: Array, port: Array) -> Array:
        """An array like v from its replicated part and from forces on the ports."""
        s = self.system
        parts = [core]
        for k, f in enumerate(s.fields):
            parts.append(f.port_force(port[s.port_slice(k)]))
        return np.concatenate(parts) if s.fields else core

    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda (lambda left out when None), like v."""
        s, n = self.system, self.system.motions.n_twist
        assert self.v is not None
        accel, g = s.twists(a), s.gravity(self.t)
        core = np.zeros((s.n_frames + 1, n))
        if s.rigid is not None:
            core[s.rigid.frame] += s.rigid.force(self.twist, accel, g)
        fields = []
        for k, f in enumerate(s.fields):
            local = (s.local_q(self.q, k), s.local_v(self.v, k), s.local_v(a, k))
            sums, rows = f.force(self.rotation[f.frame], self.twist[f.frame], accel[f.frame], local, g)
            core[f.frame] += sums
            fields.append(rows)
        out = np.concatenate((core[:-1].ravel(), *fields))
        if s.forces:
            out -= self.spread(self.wrenches())
        if lam is not None and s.n_lam:
            out += self.jacobian.transposed(lam)
        if not np.isfinite(out[: s.n_core]).all():
            raise CallbackError(f"The balance of forces is not finite at t = {self.t:g} s; check loads and initial values.")
        return out

    # -- invariants -------------------------------------------------------------------------------------------------
    def energies(self) -> dict[str, float]:
        """Energies in J: kinetic, elastic, weight, springs."""
        s = self.system
        assert self.v is not None
        g = s.gravity(np.inf)
        kinetic, elastic, weight = 0.0, 0.0, 0.0
        if s.rigid is not None:
            kinetic, weight = s.rigid.energies(self.pose, self.twist, g)
        for k, f in enumerate(s.fields):
            T, E, W = f.energies(
                self.rotation[f.frame],
                self.pose[f.frame],
                self.twist[f.frame],
                (s.local_q(self.q, k), s.local_v(self.v, k)),
                g,
            )
            kinetic, elastic, weight = kinetic + T, elastic + E, weight + W
        springs = sum(f.energy(self.kin, a, b, self.t) for f, a, b in s.forces)
        return {"kinetic": kinetic, "elastic": elastic, "weight": weight, "springs": springs}

    def momenta(self) -> tuple[Array, Array]:
        """Linear and angular momentum about the origin, world axes."""
        s = self.system
        assert self.v is not None
        p, L = np.zeros(s.motions.dim), np.zeros(s.motions.n_rot)
        if s.rigid is not None:
            dp, dL = s.rigid.momenta(self.pose, self.twist)
            p, L = p + dp, L + dL
        for k, f in enumerate(s.fields):
            dp, dL = f.momenta(
                self.rotation[f.frame],
                self.pose[f.frame],
                self.twist[f.frame],
                (s.local_q(self.q, k), s.local_v(self.v, k)),
            )
            p, L = p + dp, L + dL
        return p, L


class Jacobian:
    """G in two pieces: ``core`` (n_lam, n_core) on the frames, ``port`` (n_lam, n_port) on the ports of the fields."""

    def __init__(self, ev: Evaluation) -> None:
        s, kin, m = ev.system, ev.kin, ev.system.markers
        self.ev = ev
        n = s.motions.n_twist
        slot = np.full(len(m.frame), -1)
        slot[m.surface] = np.arange(len(m.surface))
        rows_, cols_, data_ = [], [], []
        self.port = np.zeros((s.n_lam, s.n_port))
        for batch, rows in s.batches:
            for marker, side in zip((batch.a, batch.b), batch.rows(kin, ev.t), strict=True):
                block = (side[:, None, :] @ kin.jac_frame[marker])[:, 0]
                frame = m.frame[marker]
                keep = frame < s.n_frames
                rows_.append(np.repeat(rows[keep], n))
                cols_.append((frame[keep, None] * n + np.arange(n)).ravel())
                data_.append(block[keep].ravel())
                on = np.flatnonzero(slot[marker] >= 0)
                if on.size:
                    k = slot[marker[on]]
                    self.port[rows[on, None], m.port[k]] += (side[on, None, :] @ kin.jac_port[k])[:, 0]
        for k, r in enumerate(s.frame_rows):
            start = s.port_slice(k).start
            self.port[r, start : start + s.fields[k].n_frame_rows] = np.eye(s.fields[k].n_frame_rows)
        shape = (s.n_lam, s.n_core)
        if rows_:
            entries = (np.concatenate(data_), (np.concatenate(rows_), np.concatenate(cols_)))
            core = sp.csr_matrix(entries, shape=shape)
        else:
            core = sp.csr_matrix(shape)
        self.core: Any = core.toarray() if shape[0] * shape[1] <= DENSE_LIMIT else core

    def times(self, v: Array) -> Array:
        """G v, (n_lam,); collective."""
        s = self.ev.system
        out = np.asarray(self.core @ v[: s.n_core])
        if s.n_port:
            out = out + self.port @ s.ports(v, s._field_slices[1], False)
        return out

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, like v."""
        return self.ev.gather(np.asarray(self.core.T @ lam), self.port.T @ lam)
