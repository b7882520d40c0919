"""Matrices that are dense or sparse, whichever costs less; what rows leave free."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import scipy.linalg as sl
import scipy.sparse as sp

from .errors import LinearSolveError
from .rotations import Array

RANK = 1e-9  # singular values of rows of one size below this share of the largest are zero
WIDE, FEW = 10_000, 0.05  # size and share of entries of an array whose products are worth a sparse matrix


def dense(A: Any) -> Array:
    """A as an array."""
    return A.toarray() if sp.issparse(A) else np.asarray(A)


def summed(total: Any, blocks: Iterable[tuple[Any, int, int]]) -> Any:
    """A matrix with blocks added, each with its first row and column: in place where it is dense, else in one sum."""
    if isinstance(total, np.ndarray):
        for block, row, column in blocks:
            total[row : row + block.shape[0], column : column + block.shape[1]] += dense(block)
        return total

    found = [(_entries(block), row, column) for block, row, column in blocks]
    if not found:
        return total
    rows, columns = (np.concatenate([x[i] + start[i] for x, *start in found]) for i in (0, 1))
    return total + sp.csr_matrix((np.concatenate([x[2] for x, *_ in found]), (rows, columns)), shape=total.shape)


def _entries(A: Any) -> tuple[Any, Any, Any]:
    """Rows, columns and values of what is not zero."""
    if sp.issparse(A):
        rows, columns, values = sp.find(A)
        return rows, columns, values
    i, j = np.nonzero(A)
    return i, j, A[i, j]


def singular_values(A: Array, *, full: bool = True) -> tuple[Array, Array, Array]:
    """U, s, V^T of A; slower where the fast way does not converge. ``full``: U and V are square."""
    try:
        return tuple(np.linalg.svd(A, full_matrices=full))  # type: ignore[return-value]
    except np.linalg.LinAlgError:
        if not np.isfinite(A).all():
            raise LinearSolveError("A matrix whose singular values are asked for is not finite.") from None
    try:
        return tuple(sl.svd(A, full_matrices=full, lapack_driver="gesvd"))  # type: ignore[return-value]
    except np.linalg.LinAlgError as error:
        raise LinearSolveError(
            f"Singular values of a matrix {A.shape[0]} x {A.shape[1]} were not found: {error}."
        ) from error


def orthonormalising(G: Array, small: float) -> Array:
    """T (n, k) with T^T G T = 1 for a Gram matrix G, but for directions in which it is below a share ``small`` of its largest."""
    squares, vectors = np.linalg.eigh(G)
    keep = squares > small * squares.max()
    return np.asarray(vectors[:, keep] / np.sqrt(squares[keep]))


def left_free(G: Array) -> Array:
    """Orthonormal motions (n - rank, n) that rows G (m, n), of any size, leave: G y = 0."""
    if not len(G):
        return np.eye(G.shape[1])
    sizes = np.linalg.norm(G, axis=1)
    _, stretch, V = np.linalg.svd(G / np.where(sizes > 0, sizes, 1.0)[:, None])
    return np.asarray(V[int((stretch > RANK * stretch[0]).sum()) :])


def thin(A: Array) -> Any:
    """An array with few entries as a sparse matrix, for products with dense ones; others as they are."""
    few = A.size > WIDE and np.count_nonzero(A) < FEW * A.size
    return sp.csr_matrix(A) if few else A
