"""The tangent of systems with elements between frames (rods): stiffness and damping of the elements, and what turns with frames.

A wrench (F, M) in world axes at the place x of a frame gives it the moment m = x x R^T F + R^T M in body axes, which changes
when the frame turns by theta, also where F and M stay as they are:

    dm = (x~ (R^T F)~ + (R^T M)~) theta                                                                              (1)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ...rotations import Array, hat

if TYPE_CHECKING:
    from ..evaluation import Evaluation


def with_elements(ev: Evaluation, applied: Any, cd: float, ck: float) -> Any:
    """The tangent ``applied`` of forces (None without) and that of the elements, dense or sparse as G."""
    elastic = element_tangent(ev, cd, ck)
    if isinstance(ev.jacobian.core, np.ndarray):
        elastic = elastic.toarray()
    return elastic if applied is None else elastic + applied


def element_tangent(ev: Evaluation, cd: float, ck: float) -> Any:
    """cd D + ck K of all elements, and (1) of the applied forces, sparse (n_core, n_core); rows of core parts stay empty."""
    s = ev.system
    n = s.motions.n_twist
    twist = None if ev.v is None else ev.twist
    blocks = [pair for elements in s.elements for pair in elements.tangents(ev.t, ev.pose, twist, (cd, ck))]
    if s.forces and twist is not None:
        blocks.append(_turning_wrenches(ev, ck))

    data, rows, columns = [], [], []
    for frames, block in blocks:
        at = (frames[:, :, None] * n + np.arange(n)).reshape(len(frames), frames.shape[1] * n)
        data.append(block.ravel())
        rows.append(np.broadcast_to(at[:, :, None], block.shape).ravel())
        columns.append(np.broadcast_to(at[:, None, :], block.shape).ravel())
    entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_matrix(entries, shape=(s.n_core, s.n_core))


def _turning_wrenches(ev: Evaluation, ck: float) -> tuple[np.ndarray, Array]:
    """Frames (m, 1) and blocks (m, n_twist, n_twist) of (1), as they stand in the tangent of the balance."""
    m = ev.system.markers
    wrench = ev.wrenches()
    used = (m.frame < ev.system.n_frames) & np.any(wrench != 0.0, axis=1)
    used[m.surface] = False  # elastic surfaces have ports of their own

    frames = m.frame[used]
    back = np.swapaxes(ev.rotation[frames], 1, 2)
    force, moment = ((back @ wrench[used, part, None])[..., 0] for part in (slice(0, 3), slice(3, 6)))
    block = np.zeros((len(frames), 6, 6))
    block[:, 3:, 3:] = -ck * (hat(m.position[used]) @ hat(force) + hat(moment))
    return frames[:, None], block
