"""Many configurations of one small system, evaluated together: the stages of a step, the directions of a difference quotient.

k copies of the system stand side by side with nothing between them, so that frames, markers, joints and springs of all copies
are arrays like those of one, and a call costs little more for fifty copies than for one. Arrays carry the copies in
front: q (k, n_q), v (k, n_v), lambda (k, n_lam), G (k, n_lam, n_v). What has no form in arrays (laws and joints of the user's
own, couplings, reduced bodies) is evaluated copy by copy. Replicated coordinates only: no elastic fields.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import CallbackError
from ..mechanics.frames import Kinematics, Markers
from ..mechanics.joints.constraints import Batch
from ..mechanics.placements import FrameMotion, RigidBlock
from ..rotations import Array
from .jacobian import Pattern
from .system import System


class _Slice:
    """Velocities and biases of the markers of one copy."""

    def __init__(self, kin: Kinematics, at: slice) -> None:
        self.kin, self.at = kin, at

    def twist(self, _: Kinematics) -> Array:
        assert self.kin.twist is not None
        return self.kin.twist[self.at]

    def bias(self) -> Array:
        assert self.kin.bias is not None
        return self.kin.bias[self.at]


class Copies:
    """k copies of a system; :meth:`at` evaluates them."""

    def __init__(self, system: System, k: int) -> None:
        self.system, self.k = system, k
        m, n = system.markers, len(system.markers.frame)
        self.n_markers = n
        copy = np.repeat(np.arange(k), n)
        frame = np.tile(m.frame, k)
        on = np.repeat(np.arange(k), len(m.surface))
        self.markers: Markers = replace(
            m,
            frame=np.where(frame == system.n_frames, k * system.n_frames, frame + copy * system.n_frames),
            position=np.tile(m.position, (k, 1)),
            rotation=np.tile(m.rotation, (k, 1, 1)),
            surface=np.tile(m.surface, k) + on * n,
            port=np.tile(m.port, (k, 1)) + on[:, None] * system.n_port,
            section=None if m.section is None else np.tile(m.section, k),
        )
        self.counted = None if system.counted is None else system.counted.repeated(k, self.markers)
        self.batches = [(b, rows, b.repeated(k, n)) for b, rows in system.batches]
        self.forces = [(f, f.repeated(k, n)) for f in system.forces]
        self.rigid: RigidBlock | None = None
        if system.rigid is not None:
            r = system.rigid
            self.rigid = replace(
                r,
                frame=np.tile(r.frame, k) + np.repeat(np.arange(k), len(r.frame)) * system.n_frames,
                mass=np.tile(r.mass, k),
                inertia=np.tile(r.inertia, (k, 1, 1)),
            )
        self._slots: tuple[Any, ...] | None = None

    def at(self, t: Any, q: Array, v: Array) -> Many:
        """The copies at times t, (k,) or one for all, and states q (k, n_q), v (k, n_v)."""
        return Many(self, t, q, v)

    def slots(self, pattern: Pattern) -> tuple[Any, ...]:
        """Flat places of the entries of G, on frames and on ports, in k matrices one after another."""
        if self._slots is None:
            s, n = self.system, self.system.motions.n_twist
            keep = pattern.keep
            cols = s.markers.frame[pattern.markers[keep], None] * n + np.arange(n)
            key = (pattern.rows[keep, None] * s.n_core + cols).ravel()
            frames = (key + np.arange(self.k)[:, None] * (s.n_lam * s.n_core)).ravel()
            key = (pattern.rows[pattern.on, None] * s.n_port + s.markers.port[pattern.surface]).ravel()
            ports = (key + np.arange(self.k)[:, None] * (s.n_lam * s.n_port)).ravel()
            self._slots = frames, ports
        return self._slots


def copies(system: System, k: int) -> Copies:
    """k copies of a system, kept for the next time."""
    key = ("copies", k)
    if key not in system.cache:
        system.cache[key] = Copies(system, k)
    found: Copies = system.cache[key]
    return found


class Many:
    """What :class:`~.system.Evaluation` is for one configuration, for k of them; the same names, copies in front."""

    def __init__(self, copies: Copies, t: Any, q: Array, v: Array) -> None:
        s, k = copies.system, copies.k
        self.copies, self.system, self.q, self.v = copies, s, q, v
        self.times = np.broadcast_to(np.asarray(t, dtype=float), (k,))
        self.t: Any = float(t) if np.ndim(t) == 0 else self.times
        m, nf = s.motions, s.n_frames
        self.port, self.port_rate = self._ports(q, True), self._ports(v, False)
        self.matrices = {number: p.port_matrix for number, p in enumerate(s.parts)}
        for number, p in s.curved:
            self._bend(number, p)
        self.pose = np.concatenate((q[:, : nf * m.n_pose].reshape(-1, m.n_pose), s.ground))
        self.twist = self._twists(v)
        rates = (self.twist, self.port_rate.ravel())
        self.kin = copies.markers.evaluate(self.pose, self.rotation, self.port.ravel(), rates)
        if copies.counted is not None:
            self.kin.turned = copies.counted.turned(self.pose, self.port.ravel(), q[:, s.counted_angles].ravel())

    def _twists(self, v: Array) -> Array:
        s, n = self.system, self.system.motions.n_twist
        out = np.zeros((self.copies.k * s.n_frames + 1, n))
        if s.n_frames:
            out[:-1] = v[:, : s.n_frames * n].reshape(-1, n)
        return out

    def _bend(self, number: int, part: Any) -> None:
        """Ports of second order: their values, rates and matrices (k, n_port, n)."""
        s = self.system
        u, v, at = self.q[:, s.slices[0][number]], self.v[:, s.slices[1][number]], s.port_slice(number)
        change = -np.einsum("pr,rij,kj->kpi", part.shortening.N, part.shortening.G, u, optimize=True)
        self.port[:, at] += 0.5 * (change @ u[..., None])[..., 0]
        self.port_rate[:, at] += (change @ v[..., None])[..., 0]
        self.matrices[number] = part.port_matrix + change

    def _ports(self, x: Array, position: bool) -> Array:
        """Port values, (k, n_port), of arrays like q (``position``: the reference added) or v."""
        s = self.system
        at = s.slices[0] if position else s.slices[1]
        if len(s.parts) == 1 and s.parts[0].plain:
            return x[:, at[0]]
        out = np.zeros((len(x), s.n_port))
        for p, here, port in zip(s.parts, at, s.slices[2], strict=True):
            plain = p.plain
            out[:, port] = x[:, here] if plain else x[:, here] @ p.port_matrix.T + (p.reference if position else 0.0)
        return out

    @cached_property
    def _single(self) -> list[Kinematics]:
        """Markers copy by copy."""
        n, kin, k = self.copies.n_markers, self.kin, self.copies.k
        ns = len(kin.jac_port) // k
        out = []
        for c in range(k):
            i, j = slice(c * n, (c + 1) * n), slice(c * ns, (c + 1) * ns)
            one = Kinematics(kin.x[i], kin.R[i], kin.jac_frame[i], kin.jac_port[j])
            one.moving = _Slice(kin, i)  # type: ignore[assignment]
            one.turned = None if kin.turned is None else kin.turned[i]
            out.append(one)
        return out

    def _rows(self, made: Callable[[Batch, Kinematics, Any], Array], law: Callable[[Any, slice], Array]) -> Array:
        """Rows of all constraints, (k, n_lam): ``made`` for batches, ``law`` for those on ports."""
        k = self.copies.k
        out = np.zeros((k, self.system.n_lam))
        for batch, rows, many in self.copies.batches:
            if many is not None:
                out[:, rows] = made(many, self.kin, self.t).reshape(k, -1)
            else:
                out[:, rows] = [made(batch, kin, t) for kin, t in zip(self._single, self.times, strict=True)]
        for found, span in self.system.port_constraints:
            out[:, span] += law(found, self.system.port_slice(found.part))
        return out

    def constraint(self) -> Array:
        """g, (k, n_lam)."""
        return self._rows(
            lambda b, kin, t: b.values(kin, t), lambda law, k: law.many("values", self.times, self.port[:, k])
        )

    def constraint_rate(self) -> Array:
        """g_t, (k, n_lam)."""
        return self._rows(
            lambda b, kin, t: b.rate(kin, t), lambda law, k: law.many("rate", self.times, self.port[:, k])
        )

    def gamma(self) -> Array:
        """g'' - G a, (k, n_lam)."""

        def one(batch: Batch, kin: Kinematics, t: Any) -> Array:
            assert kin.bias is not None
            value = batch.gamma(kin, t)
            for number, marker, side in batch.sides(kin, t):
                value += np.bincount(number, (side * kin.bias[marker]).sum(1), len(value))
            return value

        g = self._rows(one, lambda law, k: law.many("gamma", self.times, self.port[:, k], self.port_rate[:, k]))
        for number, p in self.system.curved:
            v = self.v[:, self.system.slices[1][number]]
            bias = -np.einsum("pr,ki,rij,kj->kp", p.shortening.N, v, p.shortening.G, v, optimize=True)
            g = g + (self.jacobian.port[:, :, self.system.port_slice(number)] @ bias[..., None])[..., 0]
        return g

    @cached_property
    def jacobian(self) -> ManyJacobian:
        """G of all copies."""
        return ManyJacobian(self)

    def sides(self) -> Array:
        """Rows of all constraints on their markers, (k, entries, d + n_rot), in the order of the system's pattern."""
        k, width = self.copies.k, self.system.motions.dim + self.system.motions.n_rot
        found: list[Array] = [np.zeros((k, 0, width))]
        for batch, _, many in self.copies.batches:
            if many is not None:
                found += [side.reshape(k, -1, width) for _, _, side in many.sides(self.kin, self.t)]
            else:
                each = [batch.sides(kin, t) for kin, t in zip(self._single, self.times, strict=True)]
                found += [np.array([sides[i][2] for sides in each]) for i in range(len(each[0]))]
        return np.concatenate(found, axis=1)

    # -- balance ----------------------------------------------------------------------------------------------------
    def balance(self, a: Array, lam: Array | None = None) -> Array:
        """M a + h + G^T lambda, (k, n_v)."""
        s, k = self.system, self.copies.k
        core = np.zeros((k * s.n_frames + 1, s.motions.n_twist))
        out = np.empty((k, s.n_v))
        accel = self._twists(a) if s.n_frames else core
        if self.copies.rigid is not None:
            core[self.copies.rigid.frame] += self.copies.rigid.force(self.twist, accel, self._gravity)
        for elements in s.elements:
            stacked = core[:-1].reshape(k, s.n_frames, -1)
            poses, twists = (x[:-1].reshape(k, s.n_frames, -1) for x in (self.pose, self.twist))
            for c in range(k):
                for frames, rows in elements.forces(float(self.times[c]), poses[c], twists[c]):
                    np.add.at(stacked[c], frames, rows)
        for number, p in enumerate(s.parts):
            local = tuple(
                x[:, at[number]] for x, at in zip((self.q, self.v, a), (s.slices[0], *[s.slices[1]] * 2), strict=True)
            )
            together = p.force_many(self.times, local)
            if together is not None:
                out[:, s.slices[1][number]] = together
                continue
            for c in range(k):
                frame = c * s.n_frames + p.frame if p.frame < s.n_frames else k * s.n_frames
                g = s.gravity(float(self.times[c]))
                motion = FrameMotion(float(self.times[c]), self.rotation[frame], self.twist[frame], accel[frame], g)
                sums, rows = p.force(motion, (local[0][c], local[1][c], local[2][c]))
                core[frame] += sums
                out[c, s.slices[1][number]] = rows
        out[:, : s.n_frames * s.motions.n_twist] = core[:-1].reshape(k, -1)
        if s.forces:
            out -= self._applied()
        if lam is not None and s.n_lam:
            out += self.jacobian.transposed(lam)
        if not np.isfinite(out).all():
            bad = float(self.times[~np.isfinite(out).all(axis=1)][0])
            raise CallbackError(
                f"The balance of forces is not finite at t = {bad:g} s; check loads and initial values."
            )
        return out

    @cached_property
    def rotation(self) -> Array:
        """Rotation matrices of the frames of all copies, the ground last."""
        return self.system.motions.matrix(self.pose)

    @cached_property
    def _gravity(self) -> Array:
        """Gravity for each rigid body of each copy, or one for all."""
        s = self.system
        assert s.rigid is not None
        if np.ndim(self.t) == 0:
            return s.gravity(self.t)
        return np.repeat(np.array([s.gravity(float(t)) for t in self.times]), len(s.rigid.frame), axis=0)

    def _applied(self) -> Array:
        """Generalised forces of all applied loads, (k, n_v)."""
        s, k, m = self.system, self.copies.k, self.copies.markers
        wrench = np.zeros(self.kin.jac_frame.shape[:2])
        n = self.copies.n_markers
        for loads, many in self.copies.forces:
            if many is not None:
                for marker, w in zip((many.a, many.b), many.wrenches(self.kin, self.t), strict=True):
                    np.add.at(wrench, marker, w)
                continue
            for c, (kin, t) in enumerate(zip(self._single, self.times, strict=True)):
                for marker, w in zip((loads.a, loads.b), loads.wrenches(kin, float(t)), strict=True):
                    np.add.at(wrench, marker + c * n, w)
        core = np.zeros((k * s.n_frames + 1, s.motions.n_twist))
        np.add.at(core, m.frame, (self.kin.jac_frame.swapaxes(1, 2) @ wrench[..., None])[..., 0])
        out = np.zeros((k, s.n_v))
        out[:, : s.n_frames * s.motions.n_twist] = core[:-1].reshape(k, -1)
        if m.surface.size:
            port = np.zeros(k * s.n_port)
            np.add.at(port, m.port, (self.kin.jac_port.swapaxes(1, 2) @ wrench[m.surface][..., None])[..., 0])
            for number in range(len(s.parts)):
                f = port.reshape(k, -1)[:, s.port_slice(number)]
                out[:, s.slices[1][number]] = (f[:, None] @ self.matrices[number])[:, 0]
        return out


class ManyJacobian:
    """G of all copies: ``core`` (k, n_lam, n_v)."""

    def __init__(self, many: Many) -> None:
        s, copies = many.system, many.copies
        k = copies.k
        self.core: Array = np.zeros((k, s.n_lam, s.n_core))
        if s.batches:
            pattern = _pattern(s, many)
            frames, ports = copies.slots(pattern)
            side = many.sides()
            jac = many.kin.jac_frame.reshape(k, copies.n_markers, *many.kin.jac_frame.shape[1:])
            used = pattern.keep
            entries = (side[:, used, None, :] @ jac[:, pattern.markers[used]])[:, :, 0]
            self.core = np.bincount(frames, entries.ravel(), self.core.size).astype(float).reshape(self.core.shape)
        if not s.parts:
            return
        self.port = port = np.zeros((k, s.n_lam, s.n_port))
        if s.batches and pattern.on.size:
            jac = many.kin.jac_port.reshape(k, -1, *many.kin.jac_port.shape[1:])
            entries = (side[:, pattern.on, None, :] @ jac[:, pattern.surface])[:, :, 0]
            port += np.bincount(ports, entries.ravel(), port.size).reshape(port.shape)
        for law, span in s.port_constraints:
            at = s.port_slice(law.part)
            port[:, span, at] += law.many("jacobian", many.times, many.port[:, at])
        if len(s.parts) == 1 and not s.n_frames and s.parts[0].plain:
            self.core = port
            return
        for number, p in enumerate(s.parts):
            if p.n_port:
                self.core[:, :, s.slices[1][number]] += port[:, :, s.port_slice(number)] @ many.matrices[number]

    def times(self, v: Array) -> Array:
        """G v, (k, n_lam)."""
        return (self.core @ v[..., None])[..., 0]

    def transposed(self, lam: Array) -> Array:
        """G^T lambda, (k, n_v)."""
        return (lam[:, None, :] @ self.core)[:, 0]


def _pattern(system: System, many: Many) -> Pattern:
    """Where the entries of G go; found by an evaluation of one copy where no one has asked before."""
    if "pattern" not in system.cache:
        _ = system.at(float(many.times[0]), many.q[0], many.v[0]).jacobian
    pattern: Pattern = system.cache["pattern"]
    return pattern
