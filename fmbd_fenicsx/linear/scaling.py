"""Scales of the saddle point of a step, of rows and columns alike, so that units, masses and step sizes do not count.

    [ A  G^T ]        D = diag(A)^-1/2  for A,   the norms of the rows of G D  for G                                    (1)
    [ G   0  ]

With (1) masses, lengths and step sizes of any size give the same condition number (the step's own h-scaling is in A, see
:mod:`fmbd_fenicsx.schemes`). A body of hardly any mass between others makes the rows of its joints the same then, to roundoff:
even scales leave all that joints move alike at one size. They need the whole matrix, dense.

Source: Ruiz, A scaling algorithm to equilibrate both rows and columns norms in matrices, RAL-TR-2001-034.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from ..rotations import Array

MOST_SCALINGS = 8  # of a matrix whose rows are of different size
SMALL_ROW = 0.1  # largest entry of a row, scaled, above which it is large enough


def both_sides(K: Array, scale: Array) -> Array:
    """Rows and columns of a matrix scaled alike."""
    return K * scale * scale[:, None]


def scales(A: Any, G: Any) -> Array:
    """(1) for A (n, n) and G (m, n), both dense or both sparse, (n + m,)."""
    diagonal = np.asarray(A.diagonal())
    largest = max(float(np.abs(diagonal).max(initial=0.0)), 1e-300)
    D = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, largest))

    if sp.issparse(G):
        norms = np.sqrt(np.asarray(G.multiply(D).power(2).sum(1)).ravel())
    else:
        norms = np.sqrt(((G * D) ** 2).sum(1))
    return np.concatenate((D, 1.0 / np.where(norms > 0, norms, 1.0)))


def even_scales(K: Array, n: int) -> Array:
    """Scales of the whole matrix K, with A (n, n), that bring what joints move alike to one size in G, whatever it weighs; of
    bodies that joints connect the heaviest has a mass of one.
    """
    part = connected_components(K, directed=False)[1]
    weight = np.sqrt(np.abs(K.diagonal()[:n]))

    def heaviest_one(scale: Array) -> Array:
        top = np.zeros(len(part))
        np.maximum.at(top, part[:n], weight * scale[:n])
        top = np.where(top > 0, top, 1.0)[part]
        return np.concatenate((scale[:n] / top[:n], scale[n:] * top[n:]))

    scale = heaviest_one(np.ones(len(part)))
    return heaviest_one(scale * even_rows(both_sides(K, scale)))


def even_rows(K: Array) -> Array:
    """Scales of any matrix: square roots of the row maxima, again while that leaves rows with small entries only."""
    rows = np.abs(K)
    scale = 1.0 / np.sqrt(_tops(rows))
    for _ in range(MOST_SCALINGS):
        top = _tops(both_sides(rows, scale))
        if top.min(initial=1.0) > SMALL_ROW:
            break
        scale = scale / np.sqrt(top)
    return scale


def _tops(rows: Array) -> Array:
    """Largest entry of each row and column, 1 for those of zeros."""
    top = np.maximum(rows.max(axis=0), rows.max(axis=1))
    return np.where(top > 0, top, 1.0)
