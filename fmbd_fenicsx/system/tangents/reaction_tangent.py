"""Reactions in the tangent of a step: what constraints push changes where their rows turn, at constant multipliers,

    d(G^T lambda)/dq                                                                                              (1)

the geometric stiffness of the reactions. With c_k of it in the matrix it counts beside the inertia of a body that a force F moves
by more than a share of its radius of gyration within a step,

    c_k F > HARD sqrt(J m)                                                                                        (2)

what is heavy on what is light. The driver does the same, ``compiled/driver/evaluation/matrix.c``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...rotations import Array
from ..compiled.declarations import constants, enumeration

if TYPE_CHECKING:
    from ..evaluation import Evaluation

NO_PUSH, HARD_PUSH, EVERY_PUSH = enumeration(
    "NO_PUSH", "parts.h"
).values()  # reactions that are in the tangent of a step
(HARD,) = constants("evaluation/matrix.c", "HARD")


def reactions_push(ev: Evaluation, ck: float) -> bool:
    """Whether (1) is in a tangent with this weight of stiffness; all or nothing, as ``ev.reactions`` asks."""
    rigid, lam = ev.system.rigid, ev.forces[1]
    if ev.reactions != HARD_PUSH or rigid is None or not len(lam):
        return bool(ev.reactions == EVERY_PUSH and len(lam))

    m = ev.system.motions
    pushed = np.asarray(abs(ev.jacobian.core).T @ np.abs(lam))[: ev.system.n_frames * m.n_twist].reshape(-1, m.n_twist)
    force = pushed[rigid.frame, : m.dim].max(axis=1)
    R = ev.rotation[rigid.frame]
    about_axes = rigid.inertia[:, 0] if m.dim == 2 else np.einsum("nij,njk,nik->ni", R, rigid.inertia, R)
    return bool((ck * force > HARD * np.sqrt(about_axes.min(axis=1) * rigid.mass)).any())


def reaction_wrenches(ev: Evaluation) -> Array:
    """What the rows push on all markers, G^T lambda in world axes, (n_markers, d + n_rot)."""
    out: Array = np.zeros(ev.kin.jac_frame.shape[:2])
    for (_, rows), sides in zip(ev.system.batches, ev.sides, strict=True):
        for number, marker, side in sides:
            np.add.at(out, marker, ev.forces[1][rows[number], None] * side)
    return out
