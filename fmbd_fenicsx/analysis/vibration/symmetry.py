"""Whether small motions are those of a symmetric problem: neither dampers nor circulatory forces change them.

In the coordinates of the symmetric problem, of mass 1 and frequencies omega_i, entries are seen beside the frequencies of the two
motions that they couple, as a stiff or a heavy part elsewhere says nothing of a soft one:

    |C_ij| <= e sqrt(omega_i omega_j),      |K_ij - K_ji| / 2 <= e omega_i omega_j                                    (1)

but for roundoff. That of the stiffness, which is made of differences of forces, is not known beforehand: what lacks of symmetry
is real where differences over another way tell the same.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...rotations import Array
from ..small_motions.basis import ProjectedSystem
from ..small_motions.perturbation import Perturbation

SMALL = 1e-7  # e of (1)
ROUNDOFF = 1e-12  # of products with a matrix, over its size
OTHER = 0.3  # of the way of differences
ALIKE = 0.1  # share of what lacks of symmetry by which it may differ over another way


def is_symmetric(small: ProjectedSystem, squares: Array, Y: Array, about: Perturbation) -> bool:
    """Whether (1) holds for motions ``Y`` of the symmetric problem, on a basis, with omega^2 ``squares``; collective.

    ``about``: the operators.
    """
    if not len(squares):
        return True
    omega, lengths = np.sqrt(np.abs(squares)), np.linalg.norm(Y, axis=0)
    each = np.outer(omega, omega)
    rough = ROUNDOFF * np.linalg.norm(small.K, 2) * np.outer(lengths, lengths)

    damped = np.abs(Y.T @ small.C @ Y)
    far = np.abs(small.K - small.K.T).max() > SMALL * np.abs(small.K).max()  # above all roundoff
    if far or (damped > SMALL * np.sqrt(each) + np.sqrt(ROUNDOFF * rough)).any():
        return False

    lacks = _lacks(Y.T @ small.K @ Y)
    i, j = np.unravel_index(np.argmax(np.abs(lacks) / (SMALL * each + rough + 1e-300)), lacks.shape)
    if abs(lacks[i, j]) <= SMALL * each[i, j] + rough[i, j]:
        return True

    other, pair = replace(about, way=OTHER * about.way), Y[:, [i, j]].T @ small.vectors
    again = _lacks(
        np.array([[about.system.dot(x, image) for image in (other.stiffness(z) for z in pair)] for x in pair])
    )
    return bool(abs(again[0, 1] - lacks[i, j]) > ALIKE * abs(lacks[i, j]))


def _lacks(K: Array) -> Array:
    """What a matrix lacks of symmetry."""
    return np.asarray(0.5 * (K - K.T))
