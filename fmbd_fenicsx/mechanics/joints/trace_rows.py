"""Rows of ties of whole surfaces, equation (1) of :mod:`.surface_ties`. Every side is linear in its ports,

    y_j = m_j r + R (s_j + p_j),     m_j = int mu_j,  s_j = int mu_j X,  p_j = int mu_j u     (2)

with the pose (r, R) of its frame (the ground for absolute bodies), so that one kind of row serves all of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...agreement import OneAnswer
from ...errors import CallbackError, InputError, named, require
from ...fem.traces.mortar import mortar
from ...fem.traces.multipliers import Multipliers, default_space, null_vectors
from ...fem.traces.traces import Trace, trace_of
from ...log import log
from ...rotations import Array, motions
from ..bodies.bodies import Surface
from ..rods.rods import node_name
from .constraints import Motion, standstill
from .joints import ground
from .surface_ties import SurfaceTie, is_section

LOOK_LIMIT = 1500  # multiplier functions up to which a tie looks for combinations that see nothing


@dataclass(frozen=True, eq=False)
class TiedSide:
    """One side (2): its frame, its part (None: rigid or ground) with the ports p, and the constants m (n,), s (n, d).

    ``trace`` and ``coupling`` (functions, nodes of the trace) of an elastic side: p = coupling u on the trace.
    """

    frame: int
    part: int | None
    ports: slice
    m: Array
    s: Array
    trace: Trace | None = None
    coupling: sp.csr_matrix | None = None


@dataclass(frozen=True, eq=False)
class TraceRows:
    """Rows (1) of one tie: sides a and b, imposed data D_j = int mu_j d (n, d), motion, and the normal of a sliding tie."""

    name: str
    multipliers: Multipliers
    sides: tuple[TiedSide, TiedSide]
    data: Array
    motion: Motion
    normal: Array | None  # (d,), in the axes of b's frame

    @property
    def rows(self) -> int:
        """Constraint rows."""
        n, d = self.data.shape
        return n if self.normal is not None else n * d

    def left_free(self) -> list[str]:
        """Rigid motions of the first surface against the other side that no multiplier sees, at the start, in words."""
        A = self.multipliers.coupling()
        t = self.multipliers.trace
        # what the functions see of constants, and of places about the middle, over its size
        total = np.asarray(A.sum(axis=1)).ravel()
        center = t.points.mean(axis=0)
        size = float(np.abs(t.points - center).max())
        arms = (np.asarray(A @ t.points) - total[:, None] * center) / size

        d = t.dim
        along = np.eye(t.dim)
        shifts = [total[:, None] * along[k] for k in range(d)]
        if d == 2:
            turns = [np.stack((-arms[:, 1], arms[:, 0]), axis=1)]
        else:
            turns = [np.cross(along[k], arms) for k in range(3)]

        if self.normal is not None:
            rows = np.stack([x @ t.mean_normal for x in (*shifts, *turns)], axis=1)
        else:
            rows = np.stack([x.ravel() for x in (*shifts, *turns)], axis=1)

        return [_motion_in_words(z, d) for z in null_vectors(rows)]

    def _arms(self, ev: Any, rate: bool = False) -> list[Array]:
        """s + p of both sides (or p'), (n, d), axes of their frames."""
        out = []
        for side in self.sides:
            p = np.zeros_like(side.s)
            if side.part is not None:
                source = ev.port_rate if rate else ev.port
                p = source[ev.system.port_slice(side.part)][side.ports].reshape(side.s.shape)
            out.append(p if rate else side.s + p)
        return out

    def _difference(self, ev: Any) -> Array:
        """y_b - y_a of (2) with what is imposed, (n, d), world axes."""
        d = self.data.shape[1]
        y = [
            side.m[:, None] * ev.pose[side.frame, :d] + arm @ ev.rotation[side.frame].T
            for side, arm in zip(self.sides, self._arms(ev), strict=True)
        ]
        return np.asarray(y[1] - y[0] + self.motion(ev.t)[0] * self.data)

    def values(self, ev: Any) -> Array:
        """g, (rows,)."""
        return self._held(ev, self._difference(ev))

    def rate(self, ev: Any) -> Array:
        """dg/dt at rest, (rows,)."""
        return self._held(ev, self.motion(ev.t)[1] * self.data)

    def _held(self, ev: Any, g: Array) -> Array:
        """All components of vectors (n, d) one after the other, of a sliding tie those along the normal; (rows,)."""
        return g.ravel() if self.normal is None else np.asarray(g @ (ev.rotation[self.sides[1].frame] @ self.normal))

    def jacobian(self, ev: Any) -> list[tuple[str, int, Any]]:
        """Blocks ("frame", number of the frame, (rows, n_twist)) and ("port", number of the side, sparse (rows, ports))."""
        m, (n, d) = ev.system.motions, self.data.shape
        blocks: list[tuple[str, int, Any]] = []
        nu = None if self.normal is None else ev.rotation[self.sides[1].frame] @ self.normal

        # both sides, along the normal alone where they slide
        for number, (side, z, sign) in enumerate(zip(self.sides, self._arms(ev), (-1.0, 1.0), strict=True)):
            R = ev.rotation[side.frame]
            if side.frame < ev.system.n_frames:
                G = np.zeros((n, d, m.n_twist))
                G[:, :, :d] = side.m[:, None, None] * np.eye(d)
                G[:, :, d:] = R @ m.lever(z)
                if nu is not None:
                    G = np.einsum("i,nij->nj", nu, G)[:, None]
                blocks.append(("frame", side.frame, sign * G.reshape(-1, m.n_twist)))
            if side.part is not None:
                row = R if nu is None else (nu @ R)[None]
                blocks.append(("port", number, _repeated(sign * row, n)))

        # the normal turns with its frame
        if nu is not None and self.normal is not None and self.sides[1].frame < ev.system.n_frames:
            R = ev.rotation[self.sides[1].frame]
            turned = np.zeros((n, m.n_twist))
            turned[:, d:] = self._difference(ev) @ (R @ m.lever(self.normal[None])[0])
            blocks.append(("frame", self.sides[1].frame, turned))
        return blocks

    def gamma(self, ev: Any) -> Array:
        """g'' without the accelerations, (rows,)."""
        m = ev.system.motions
        d = self.data.shape[1]

        total = np.zeros_like(self.data)
        speed = self.motion(ev.t)[1] * self.data
        for side, z, zd, sign in zip(self.sides, self._arms(ev), self._arms(ev, rate=True), (-1.0, 1.0), strict=True):
            R, twist = ev.rotation[side.frame], ev.twist[side.frame]
            # w x (w x z) + 2 w x z' of the arm z
            w = np.broadcast_to(twist[None, d:], (len(z), m.n_rot))
            total += sign * (m.spin(w, m.spin(w, z) + 2.0 * zd) @ R.T)
            speed += sign * (side.m[:, None] * twist[:d] + (m.spin(w, z) + zd) @ R.T)

        total += self.motion(ev.t)[2] * self.data
        if self.normal is None:
            return total.ravel()

        # the normal n0 in its frame, its rate n1 and second rate n2
        frame = self.sides[1].frame
        R = ev.rotation[frame]
        w = ev.twist[frame][None, d:]
        n0 = self.normal[None]
        n1 = m.spin(w, n0)
        n2 = m.spin(w, n1)
        return np.asarray(total @ (R @ n0[0]) + 2 * speed @ (R @ n1[0]) + self._difference(ev) @ (R @ n2[0]))


def _repeated(block: Array, n: int) -> sp.csr_matrix:
    """The block-diagonal matrix of n equal blocks."""
    rows, columns = block.shape
    indices = columns * np.arange(n)[:, None, None] + np.arange(columns)
    indices = np.broadcast_to(indices, (n, rows, columns)).ravel()
    starts = columns * np.arange(n * rows + 1)
    return sp.csr_matrix((np.tile(block.ravel(), n), indices, starts), shape=(n * rows, n * columns))


def _motion_in_words(motion: Array, d: int) -> str:
    """A rigid motion (d displacements, then rotations) by what is largest in it."""
    shift, turn = motion[:d], motion[d:]
    if np.linalg.norm(turn) < 1e-6:
        return "displacement along " + _direction(shift)
    return "rotation" if d == 2 else "rotation about " + _direction(turn)


def _direction(x: Array) -> str:
    """A direction, its largest component positive."""
    unit = x / np.linalg.norm(x) * np.sign(x[np.argmax(np.abs(x))])
    return "(" + ", ".join(f"{v:.3g}" for v in np.where(np.abs(unit) < 5e-4, 0.0, unit)) + ")"


def build_surface_ties(
    ties: dict[str, SurfaceTie], parts: list[Any], part_of: dict[str, int], frame_of: dict[str, int]
) -> list[TraceRows]:
    """Rows of all ties of a scene; collective."""

    def place(body: Any) -> tuple[int, Array, Array]:
        """Frame, position and rotation at the start of a rigid body, a section of a rod, or the ground."""
        if is_section(body):
            rod = body.body
            node = rod.node_of(body.name)
            return frame_of[node_name(rod.name, node)], rod.poses[node, :3], rod.poses_matrix[node]
        if body is ground or body.locked:
            d = next(iter(ties.values())).a.dim
            return len(frame_of), np.zeros(d), np.eye(d)
        pose = body.start_pose()
        m = motions(body.dim)
        return frame_of[body.name], pose[: body.dim], m.matrix(pose)

    return [build_trace_rows(t, parts, part_of, place) for t in ties.values()]


def build_trace_rows(
    tie: SurfaceTie, parts: list[Any], part_of: dict[str, int], place: Callable[[Any], Any]
) -> TraceRows:
    """Rows of a tie; adds the ports that they need to the parts. ``place(rigid body)``: (frame, position, rotation).
    Collective.
    """
    part = parts[part_of[tie.a.body.name]]
    trace = _trace(part, tie.a)
    space = tie.space or default_space(trace.degree)

    # two elastic sides meet on a mortar; ground and rigid sides follow as a whole
    other: Any = None
    if isinstance(tie.b, Surface) and not is_section(tie.b):
        other = parts[part_of[tie.b.body.name]]
        other_trace = _trace(other, tie.b)
        coupling = mortar(trace, other_trace, space)
        mu, A, B = coupling.multipliers, coupling.slave, coupling.master
    else:
        mu = space.on(trace)
        A = mu.coupling()

    _refuse_unseen(tie.name, mu, A)

    a, start = _elastic_side(part, part_of[tie.a.body.name], tie.a.name, trace, A)
    if other is not None:
        b, end = _elastic_side(other, part_of[tie.b.body.name], tie.b.name, other_trace, B)
        b = replace(b, s=b.s + (start - end))  # gaps of curved or distant meshes stay as they are
    else:
        frame, r, R = place(tie.b)
        b = TiedSide(frame, None, slice(0, 0), a.m, (start - a.m[:, None] * r) @ R)

    # a sliding tie holds the normal direction alone, that of the side whose frame is rigid
    normal = None
    if tie.sliding:
        require(trace.flat, f'Tie "{tie.name}": {trace.label} is curved; a sliding tie needs a flat surface.')
        normal = trace.mean_normal
        if other is None and tie.b is not ground:
            normal = place(tie.b)[2].T @ normal

    rows = TraceRows(tie.name, mu, (a, b), _imposed(tie, mu), tie.motion or standstill, normal)
    free = [] if tie.sliding else rows.left_free()
    if free:
        log.warning(
            'tie "%s" is no clamp: its multipliers (%s) leave free the %s of %r. Leave out space=, or take a larger one',
            tie.name, mu.name, ", ".join(free), tie.a,
        )  # fmt: skip
    return rows


def _refuse_unseen(name: str, mu: Multipliers, A: sp.csr_matrix) -> None:
    """Raise when combinations of multipliers see no displacement of the surface: the inf-sup constant is zero."""
    if mu.n > LOOK_LIMIT:
        return

    # combinations that see nothing: null vectors of the Gram matrix of the rows, each of size one
    gram = (A @ A.T).toarray()
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    unseen = int((np.linalg.eigvalsh(gram / np.outer(size, size)) < 1e-12 * mu.n).sum())

    if unseen:
        raise InputError(
            f'Tie "{name}": {unseen} of {mu.n} multiplier functions ({mu.name}, each for every component) see no displacement of '
            f"{mu.trace.label} (degree {mu.trace.degree}): they fail the inf-sup condition, and the traction is not unique. Use "
            "the default space, or see infsup(tie)."
        )


def _trace(part: Any, surface: Surface) -> Trace:
    return trace_of(part.field.space, surface.body.mesh, surface.name)


def _elastic_side(part: Any, number: int, surface: str, trace: Trace, A: sp.csr_matrix) -> tuple[TiedSide, Array]:
    """Side with the ports p = A u (rows d) of a part, and int mu X in world axes at the start."""
    ports = part.add_trace(sp.kron(trace.columns(A), sp.identity(trace.dim), format="csr"), surface)
    m = np.asarray(A.sum(axis=1)).ravel()
    start = np.asarray(A @ trace.points)
    return TiedSide(part.frame, number, ports, m, start - m[:, None] * part.origin, trace, A), start


def _imposed(tie: SurfaceTie, mu: Multipliers) -> Array:
    """D_j = int mu_j d(X), (n, d); collective."""
    t = mu.trace
    if tie.shape is None:
        return np.zeros((mu.n, t.dim))
    shape = named("The shape of tie", tie.name, tie.shape, time=None)

    def checked(x: Array) -> Array:
        """Values (n, d) of the shape at points, finite."""
        with OneAnswer(t.comm):
            found = np.asarray(shape(x.T), dtype=float)
        if found.shape != x.T.shape or not np.isfinite(found).all():
            raise CallbackError(
                f'Tie "{tie.name}": shape(X) returned {found.shape}, expected {x.T.shape} finite numbers.'
            )
        return found.T

    return mu.integrals(checked)
