"""The tangent of the equations of an implicit step: as dense or sparse matrices, or as data of sparse patterns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...rotations import Array
from ..sparsity import Pattern

CROWDED = 3  # rows over coordinates of a body, above which its moves U mu take less as unknowns than what they couple


@dataclass(frozen=True)
class StepTangent:
    """Coefficients of (1) in :mod:`~fmbd_fenicsx.linear.implicit.pencil`, with m rows of joints, k levels, p ties: J, M (n, n);
    G (m, n); U (n, m); derivatives of the lower rows by xi, v, a, (n + k m + p, n) each; R (p, n). Of laws that compiled
    code has formulas of, dN/ds and dN/ds' where it was taken, (laws, 2). Or sparse ones, or data of patterns.
    """

    J: Array
    M: Array
    G: Array
    U: Array
    by_q: Array
    by_v: Array
    by_a: Array
    R: Array
    slopes: Array


def crowded(G: Pattern, M: Pattern) -> np.ndarray:
    """Which coordinates are those of bodies where many joints meet, (n,)."""
    return np.asarray(np.bincount(G.columns, minlength=G.shape[1]) > CROWDED * np.diff(M.start))
