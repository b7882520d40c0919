"""The tangent of applied forces: springs, dampers, tyres and laws of the user's own, as Newton's iteration sees them.

An element between markers has the tangent T = cd D + ck K over their displacements, d = J dq. On frames and on
replicated parts J^T T J goes into the core. A marker on the surface of a distributed field moves with the ports of the field
as well; with the singular values of T = U S V^T the element becomes a compliant row beside the constraints,

    [ A          J^T U S^1/2 ] [ dq ]   [ b ]
    [ S^1/2 V^T J     -1     ] [ y  ] = [ 0 ]                                                              (1)

which is the same system, keeps the factor of the field as it is, and stays well conditioned for any stiffness.

Elements between frames (rods) add their stiffness and damping, and what turns with the frames: a wrench (F, M) in world axes at
the place x of a frame gives it the moment m = x x R^T F + R^T M in body axes, which changes when the frame turns by theta, also
where F and M stay as they are:

    dm = (x~ (R^T F)~ + (R^T M)~) theta                                                                              (2)

Reactions that push hard (:mod:`.reaction_tangent`) add theirs, and the symmetric part of (2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...mechanics.forces.force_elements import ScalarLoads
from ...rotations import Array, hat
from .reaction_tangent import reaction_wrenches, reactions_push

if TYPE_CHECKING:
    from ..evaluation import Evaluation


@dataclass(frozen=True, eq=False)
class ForceTangent:
    """Derivative of the applied forces by the increments of a step, cd D + ck K, in the two pieces that a solver needs.

    ``core`` (n_core, n_core), dense or sparse as G, or None: elements between frames and replicated parts. ``left``, ``right``
    (n_core + n_port, r): elements that touch a surface of a distributed field, whose tangent is left @ right^T on the core
    and the ports; r is the sum of their ranks.
    """

    core: Any
    left: Array
    right: Array


RANK = 1e-13  # singular values of an element's tangent below this share of the largest are roundoff


def force_tangent(ev: Evaluation, cd: float, ck: float) -> ForceTangent | None:
    """cd D + ck K of the applied forces, and of elements between frames; None when there is none. See :class:`ForceTangent`."""
    s = ev.system
    entries = _Entries(ev)
    left, right = [], []
    pushing = reactions_push(ev, ck)
    for markers, T in _between_markers(ev, cd, ck, pushing):
        on_surface = np.any([entries.seen.touches(m) for m in markers], axis=0)
        entries.add_frames(T, markers, ~on_surface)

        for i in np.flatnonzero(on_surface):
            # all markers of an element on a surface, by core and ports
            J = np.concatenate([entries.seen.rows(m[i]) for m in markers])
            if not J[:, s.n_core :].any():
                entries.add_block(J[:, : s.n_core].T @ T[i] @ J[:, : s.n_core])
                continue
            # on ports of fields: as a product of low rank, the border of the solver
            U, sizes, Vt = np.linalg.svd(T[i])
            keep = sizes > RANK * sizes[0]
            root = np.sqrt(sizes[keep])
            left.append(J.T @ (U[:, keep] * root))
            right.append(J.T @ (Vt[keep].T * root))

    for frames, blocks in _on_frames(ev, cd, ck, pushing):
        entries.add_blocks(list(frames.T), blocks)
    core = entries.matrix()
    if core is None and not left:
        return None
    none = np.zeros((s.n_core + s.n_port, 0))
    return ForceTangent(core, np.concatenate([none, *left], axis=1), np.concatenate([none, *right], axis=1))


def _between_markers(
    ev: Evaluation, cd: float, ck: float, pushing: bool
) -> Iterator[tuple[tuple[np.ndarray, ...], Array]]:
    """T of forces, and of reactions where these are ``pushing``, with the markers."""
    s = ev.system
    for loads in s.forces if ev.v is not None else ():
        tangent = loads.tangent(ev.kin, ev.t)
        if tangent is None:
            continue
        T = ck * tangent.K + cd * tangent.D
        if isinstance(loads, ScalarLoads) and loads in ev.foretold:
            T = T + ck * loads.relative.geometric(ev.kin, ev.foretold[loads] - loads.scalar(ev.kin, ev.t)[2])
        yield tangent.markers, T
    for batch, rows in s.batches if pushing else ():
        for markers, curve in batch.curves(ev.kin, ev.t, ev.forces[1][rows]):
            yield markers, ck * curve


class SurfaceMarkers:
    """Displacements of markers as functions of the core and of the ports of distributed fields."""

    def __init__(self, ev: Evaluation) -> None:
        s = self.system = ev.system
        self.ev, m = ev, s.markers
        self.slot = np.full(len(m.frame), -1)
        self.slot[m.surface] = np.arange(len(m.surface))

    def touches(self, markers: np.ndarray) -> np.ndarray:
        """Which of some markers sit on surfaces of elastic bodies."""
        return np.asarray(self.slot[markers] >= 0)

    def rows(self, marker: int) -> Array:
        """Displacement and rotation of a marker, (d + n_rot, n_core + n_port), by core and ports of distributed fields."""
        s = self.system
        kin = self.ev.kin
        n = s.motions.n_twist
        out = np.zeros((kin.jac_frame.shape[1], s.n_core + s.n_port))
        frame = s.markers.frame[marker]
        if frame < s.n_frames:
            out[:, frame * n : (frame + 1) * n] = kin.jac_frame[marker]
        slot = self.slot[marker]
        if slot < 0:
            return out

        # which part the surface belongs to is told by its ports
        ports = s.markers.port[slot]
        jac = kin.jac_port[slot]
        k = next(k for k in range(len(s.parts)) if s.port_slice(k).start <= ports[0] < s.port_slice(k).stop)
        part = s.parts[k]
        if part.distributed:
            out[:, s.n_core + ports] = jac
        else:
            matrix = part.port_matrix + self.ev.bent[k].matrix if k in self.ev.bent else part.port_matrix
            out[:, s.slices[1][k]] += jac @ matrix[ports - s.port_slice(k).start]
        return out


class _Entries:
    """Entries of the core's tangent, collected element by element."""

    def __init__(self, ev: Evaluation) -> None:
        self.ev, self.seen = ev, SurfaceMarkers(ev)
        self.data: list[Array] = []
        self.rows: list[np.ndarray] = []
        self.cols: list[np.ndarray] = []
        self.block: Array | None = None

    def add_block(self, block: Array) -> None:
        """A dense contribution, (n_core, n_core)."""
        self.block = block if self.block is None else self.block + block

    def add_frames(self, T: Array, markers: tuple[np.ndarray, ...], which: np.ndarray) -> None:
        """Elements between markers on frames, of those that ``which`` selects."""
        if not which.any():
            return
        jac = np.stack([self.ev.kin.jac_frame[m[which]] for m in markers], axis=1)
        count, k, size, n = jac.shape
        # J_a^T T_ab J_b of all pairs of sides at once
        half = jac.swapaxes(2, 3) @ T[which].reshape(count, k, size, k * size)
        blocks = half.reshape(count, k, n, k, size).swapaxes(2, 3) @ jac[:, None]
        blocks = blocks.swapaxes(2, 3).reshape(count, k * n, k * n)
        self.add_blocks([self.ev.system.markers.frame[m[which]] for m in markers], blocks)

    def add_blocks(self, frames: Sequence[np.ndarray], blocks: Array) -> None:
        """Blocks (m, k n_twist, k n_twist) on frames, k times (m,)."""
        n = self.ev.system.motions.n_twist
        at = np.stack(frames, axis=1)[:, :, None] * n + np.arange(n)
        at = at.reshape(len(at), len(frames) * n)
        rows, cols = (np.broadcast_to(x, blocks.shape) for x in (at[:, :, None], at[:, None, :]))
        # the ground does not move
        keep = np.maximum(rows, cols) < self.ev.system.n_frames * n
        self.data.append(blocks[keep])
        self.rows.append(rows[keep])
        self.cols.append(cols[keep])

    def matrix(self) -> Any:
        """The sum of all, dense or sparse as G; None without any."""
        s = self.ev.system
        dense = isinstance(self.ev.jacobian.core, np.ndarray)
        if not self.data and self.block is None:
            return None
        if not self.data:
            return self.block if dense else sp.csr_matrix(self.block)

        entries = (np.concatenate(self.data), (np.concatenate(self.rows), np.concatenate(self.cols)))
        matrix = sp.csr_matrix(entries, shape=(s.n_core, s.n_core))
        if self.block is not None:
            matrix = matrix + sp.csr_matrix(self.block)
        return matrix.toarray() if dense else matrix


def _on_frames(ev: Evaluation, cd: float, ck: float, pushing: bool) -> Iterator[tuple[np.ndarray, Array]]:
    """Frames (m, k) and blocks (m, k n_twist, k n_twist) of all elements between frames, and (2) where it counts."""
    s = ev.system
    twist = None if ev.v is None else ev.twist
    for elements in s.elements:
        yield from elements.tangents(ev.t, ev.pose, twist, (cd, ck))
    if s.elements and s.forces and twist is not None:
        yield _turning_wrenches(ev, ev.wrenches(), -ck)
    if pushing:
        frames, block = _turning_wrenches(ev, reaction_wrenches(ev), ck)
        yield frames, 0.5 * (block + block.swapaxes(1, 2))


def _turning_wrenches(ev: Evaluation, wrench: Array, weight: float) -> tuple[np.ndarray, Array]:
    """Frames (m, 1) and blocks (m, n_twist, n_twist) of (2) for wrenches on all markers, times a weight."""
    m, d, n = ev.system.markers, ev.system.motions.dim, ev.system.motions.n_twist
    used = (m.frame < ev.system.n_frames) & np.any(wrench != 0.0, axis=1)
    used[m.surface] = False  # elastic surfaces have ports of their own

    frames, arm = m.frame[used], m.position[used]
    back = np.swapaxes(ev.rotation[frames], 1, 2)
    force = (back @ wrench[used, :d, None])[..., 0]
    block = np.zeros((len(frames), n, n))
    if d == 2:
        block[:, 2, 2] = -weight * (arm * force).sum(axis=1)
    else:
        moment = (back @ wrench[used, 3:, None])[..., 0]
        block[:, 3:, 3:] = weight * (hat(arm) @ hat(force) + hat(moment))
    return frames[:, None], block
