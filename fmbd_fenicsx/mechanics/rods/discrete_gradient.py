"""Forces of a rod over a step that do as much work as its energy changes, and no more momentum than they must.

With means of the old and the new nodal places, quaternions and rotations A = (R_0 + R_1) / 2, a node moves by h x', and turns by
h w in space axes, w = A^-T w_b for the mean twist w_b of its section. Strains of the mean configuration do not change under
h (w x mean x, w (x) mean p / 2), a turn of all nodes by the same w, so forces

    f = sum_q weight (E Z)^T S*,        S* = (S_0 + S_1) / 2 + alpha C d,        d = h E Z (x', w)                         (1)

along E Z at the mean give the nodes no linear and no angular momentum. One number alpha for the whole rod makes their work
sum weight S* . d the change of energy W_1 - W_0 to roundoff; it is of second order in the step.

Sources: Gonzalez, doi:10.1007/s003329900016; Romero and Armero, doi:10.1002/nme.486 (rods).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...rotations import Array, quaternion_matrix, quaternion_product
from .strains import strain_jacobian, strains

if TYPE_CHECKING:
    from .elements import RodElements


def mean_forces(rod: RodElements, poses: tuple[Array, Array], twist: Array, h: float) -> Array:
    """Rows (m, k, 6) of the nodes for the old and new poses of all frames, their mean twist and the step h (s); (1)."""
    (z0, p0), (z1, p1) = (rod.interpolated(pose) for pose in poses)
    p1 = p1 * np.where((p0[:, :1] * p1[:, :1]).sum(-1, keepdims=True) < 0, -1.0, 1.0)  # of one sign over the step
    p = 0.5 * (p0 + p1)

    # strains by the motion of the nodes in the mean configuration, places and turns in space axes
    _, E = strain_jacobian(0.5 * (z0[0] + z1[0]), rod.shape.N @ p, rod.slopes @ p)
    B = E @ _directions(rod, p)

    # d of (1)
    A = 0.5 * sum(quaternion_matrix(pose[rod.frames, 3:]) for pose in poses)
    nodal = twist[rod.frames].copy()
    nodal[..., 3:] = np.linalg.solve(np.swapaxes(A, -1, -2), nodal[..., 3:, None])[..., 0]
    change = h * (B @ nodal.reshape(len(nodal), 1, -1, 1))[..., 0]

    stress = _stress(rod, (strains(*z0) - rod.natural, strains(*z1) - rod.natural), change, h)
    rows: Array = ((rod.weights[..., None] * stress)[..., None, :] @ B).sum((1, 2)).reshape(*rod.frames.shape, 6)
    rows[..., 3:] = np.linalg.solve(A, rows[..., 3:, None])[..., 0]
    return rows


def _stress(rod: RodElements, ends: tuple[Array, Array], change: Array, h: float) -> Array:
    """S* of (1) between the strains at both ends of a step, with what damps; ``change``: d."""
    before, after = ends
    middle = 0.5 * (before + after)
    stress = mean = 0.5 * (rod.law.stress(before) + rod.law.stress(after))
    along = (rod.law.tangent(middle) @ change[..., None])[..., 0]
    if rod.beta:
        stress = stress + (rod.beta / h) * along
    if rod.arms is not None:
        stress = stress + rod.arms.stress(rod.kept, rod.kept.t + 0.5 * h, middle)

    # alpha: what the energy gains beyond the work of the mean stress
    gained = rod.law.energy(after) - rod.law.energy(before) - (mean * change).sum(-1)
    square = float((rod.weights[..., None] * change * along).sum())
    if square > 0.0:
        stress = stress + float((rod.weights * gained).sum()) / square * along
    return stress


def _directions(rod: RodElements, p: Array) -> Array:
    """dz by places and turns in space axes: w (x) p / 2, (m, q, 11, 6 k)."""
    return rod.directions((p @ _TURNS).reshape(*p.shape, 3))


def _turns() -> Array:
    """Constants (4, 12) that turn p into the columns w (x) p / 2 for the three unit w."""
    half = 0.5 * np.eye(4)
    return np.stack([quaternion_product(np.tile(w, (4, 1)), np.eye(4)) for w in half[:3]], axis=-1).reshape(4, 12)


_TURNS = _turns()
