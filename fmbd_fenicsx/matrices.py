"""Matrices that are dense or sparse, whichever costs less."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from .rotations import Array

WIDE, FEW = 10_000, 0.05  # size and share of entries of an array whose products are worth a sparse matrix


def dense(A: Any) -> Array:
    """A as an array."""
    return A.toarray() if sp.issparse(A) else np.asarray(A)


def thin(A: Array) -> Any:
    """An array with few entries as a sparse matrix, for products with dense ones; others as they are."""
    few = A.size > WIDE and np.count_nonzero(A) < FEW * A.size
    return sp.csr_matrix(A) if few else A
