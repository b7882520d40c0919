"""Where sparse matrices of one structure have their entries: data are arrays of numbers in the order of a pattern.

Products of two matrices whose patterns are known have a pattern too, found once; their data are sums over known pairs of entries.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ..rotations import Array


@dataclass(frozen=True, eq=False)
class Pattern:
    """Entries (rows, columns) of a matrix of this shape, row by row."""

    shape: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray

    @staticmethod
    def of(shape: tuple[int, int], rows: np.ndarray, columns: np.ndarray) -> Pattern:
        """Of entries in any order, some of them more than once."""
        keys = np.unique(np.asarray(rows, np.int64) * shape[1] + columns)
        return Pattern(shape, keys // max(shape[1], 1), keys % max(shape[1], 1))

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def keys(self) -> np.ndarray:
        """A number for each entry, ascending."""
        return np.asarray(self.rows * self.shape[1] + self.columns)

    @cached_property
    def start(self) -> np.ndarray:
        """Where each row begins, and the end, as C's int."""
        return np.searchsorted(self.rows, np.arange(self.shape[0] + 1)).astype(np.int32)

    @cached_property
    def on(self) -> np.ndarray:
        """The columns as C's int."""
        return self.columns.astype(np.int32)

    def places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Numbers of entries, which are all there."""
        keys = np.asarray(rows, np.int64) * self.shape[1] + columns
        at = np.searchsorted(self.keys, keys)
        assert np.array_equal(self.keys[at], keys), "an entry outside of the pattern"
        return np.asarray(at)

    def taken(self, A: Any) -> Array:
        """The data of a matrix, dense or sparse, all of whose entries lie in the pattern."""
        if isinstance(A, np.ndarray):
            return np.asarray(A[self.rows, self.columns])
        entries = A.tocoo()
        data = np.zeros(len(self))
        np.add.at(data, self.places(entries.row, entries.col), entries.data)
        return data

    def matrix(self, data: Array) -> Any:
        """A matrix of SciPy with these data."""
        return sp.csr_matrix((data, self.on, self.start), shape=self.shape, copy=False)

    def times(self, data: Array, x: Array) -> Array:
        """Products with vectors (k, columns), (k, rows)."""
        return np.array([np.bincount(self.rows, data * one[self.columns], self.shape[0]) for one in x])

    def repeated(self, count: int) -> Pattern:
        """Of so many such matrices on the diagonal."""
        block, (rows, columns) = np.arange(count)[:, None], self.shape
        at = (self.rows + rows * block).ravel(), (self.columns + columns * block).ravel()
        return Pattern((count * rows, count * columns), *at)

    def transposed(self) -> tuple[Pattern, np.ndarray]:
        """The pattern of the transpose, and the numbers of the entries in its order."""
        order = np.argsort(self.columns, kind="stable")
        return Pattern((self.shape[1], self.shape[0]), self.columns[order], self.rows[order]), order


class Total:
    """C = A + B + ... for matrices of these patterns, of one shape."""

    def __init__(self, *parts: Pattern) -> None:
        rows, columns = (np.concatenate([getattr(x, name) for x in parts]) for name in ("rows", "columns"))
        self.pattern = Pattern.of(parts[0].shape, rows, columns)
        self.to = self.pattern.places(rows, columns)

    def data(self, *parts: Array) -> Array:
        """Those of C."""
        return np.bincount(self.to, np.concatenate(parts), len(self.pattern)).astype(float, copy=False)


class Product:
    """C = A B for matrices of two patterns; ``pattern``: of C, or a larger one that is given; ``through``: columns of A that
    count (all).
    """

    def __init__(
        self, a: Pattern, b: Pattern, within: Pattern | None = None, through: np.ndarray | None = None
    ) -> None:
        # each entry of A meets all of a row of B
        counts = (np.diff(b.start) * (True if through is None else through))[a.columns]
        self.a = np.repeat(np.arange(len(a)), counts)
        first = np.cumsum(counts) - counts
        self.b = np.arange(len(self.a)) - np.repeat(first - b.start[:-1][a.columns], counts)

        rows, columns, shape = a.rows[self.a], b.columns[self.b], (a.shape[0], b.shape[1])
        self.pattern = Pattern.of(shape, rows, columns) if within is None else within
        self.to = self.pattern.places(rows, columns)

    def data(self, a: Array, b: Array) -> Array:
        """Those of C."""
        return np.bincount(self.to, a[self.a] * b[self.b], len(self.pattern)).astype(float, copy=False)
