"""Natural frequencies of a body of modes alone: free, or with some of its surfaces held."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg as sl

from ...checks import whole
from ...errors import require
from ...matrices import left_free
from ...rotations import Array
from ..placements import FrameMotion

if TYPE_CHECKING:
    from .reduced import ReducedPart


def modal_frequencies(part: ReducedPart, count: int) -> Array:
    """The first ``count`` natural frequencies (Hz) of a reduced body without load, ascending: of all motions of its frame and
    modes in which its surfaces in use stand still on average.

    Raises:
        InputError: more frequencies than such motions.
    """
    whole("frequencies: n", count, least=1)
    held, m, d = len(part.surfaces), part.motions, part.dim
    rest = FrameMotion(0.0, np.eye(d), np.zeros(m.n_twist), None, np.zeros(d))
    of_frame, across, of_modes = part.mass_blocks(rest, np.zeros(part.n))
    M = np.block([[of_frame, across.T], [across, of_modes]])
    K = sl.block_diag(np.zeros((m.n_twist, m.n_twist)), part.constants.K)

    # what rigid motions and modes do to the held surfaces: mean displacements, and rotations as joints see them
    reference = part.reference.reshape(held, 1 + d, d)
    rigid = np.concatenate((np.zeros((*reference.shape, d)), m.lever(reference)), axis=-1)
    rigid[:, 0, range(d), range(d)] = 1.0
    moved = np.concatenate((rigid, part.port_matrix.reshape(*reference.shape, part.n)), axis=-1)
    moved = np.moveaxis(moved, -1, 1)
    turned = m.moment(np.eye(d), moved[:, :, 1:]).sum(axis=2)
    rows = np.concatenate((moved[:, :, 0], turned), axis=2).swapaxes(1, 2).reshape(held * m.n_twist, len(M))

    V = left_free(rows)
    freely = left_free(rows[:, : m.n_twist]).shape[0]
    require(
        count <= len(V) - freely,
        f'Body "{part.name}": {count} natural frequencies asked for; its {part.n} modes have {len(V) - freely}.',
    )
    squares = sl.eigvalsh(V @ K @ V.T, V @ M @ V.T)[freely : freely + count]
    return np.asarray(np.sqrt(squares) / (2.0 * np.pi))
