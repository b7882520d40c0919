"""Rows of contacts on the velocities of a trace's nodes: few numbers a row, whose products are dense ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from ...rotations import Array


@dataclass(frozen=True)
class NodalRows:
    """``count`` rows: row ``row`` (k,) sees node ``node`` (k,) along ``value`` (k, d), in the body's axes."""

    count: int
    row: np.ndarray
    node: np.ndarray
    value: Array

    @classmethod
    def none(cls, count: int, dim: int) -> NodalRows:
        """Rows that see no node."""
        return cls(count, np.zeros(0, dtype=int), np.zeros(0, dtype=int), np.zeros((0, dim)))

    @classmethod
    def stacked(cls, parts: Sequence[NodalRows]) -> NodalRows:
        """Rows behind each other."""
        first = np.cumsum([0, *(p.count for p in parts)])
        return cls(
            int(first[-1]),
            np.concatenate([p.row + k for p, k in zip(parts, first, strict=False)]),
            np.concatenate([p.node for p in parts]),
            np.concatenate([p.value for p in parts]),
        )

    def __add__(self, other: NodalRows) -> NodalRows:
        return NodalRows(
            self.count,
            np.concatenate((self.row, other.row)),
            np.concatenate((self.node, other.node)),
            np.concatenate((self.value, other.value)),
        )

    def take(self, rows: np.ndarray) -> NodalRows:
        """Some of the rows, by their numbers or by a mask."""
        if self._single:
            node = self.node[rows]
            return NodalRows(len(node), np.arange(len(node)), node, self.value[rows])
        number = np.full(self.count, -1)
        chosen = number[rows].size
        number[rows] = np.arange(chosen)
        row = number[self.row]
        kept = row >= 0
        return NodalRows(chosen, row[kept], self.node[kept], self.value[kept])

    @cached_property
    def _single(self) -> bool:
        """Whether each row sees one node."""
        return len(self.row) == self.count and bool(np.logical_and.reduce(self.row == np.arange(self.count)))

    def _sums(self, x: Array) -> Array:
        """Sums over the nodes of each row, (count, ..), of x (k, ..)."""
        if self._single:
            return x
        out = np.zeros((self.count, *x.shape[1:]))
        np.add.at(out, self.row, x)
        return out

    def times(self, w: Array) -> Array:
        """Products with w (n, d) on the nodes of the trace, (count,)."""
        return self._sums((self.value[:, None, :] @ w[self.node][:, :, None])[:, 0, 0])

    def transposed(self, force: Array, n: int) -> Array:
        """Forces (n, d) on the nodes by ``force`` (count,) on the rows."""
        out = np.zeros((n, self.value.shape[1]))
        np.add.at(out, self.node, force[self.row, None] * self.value)
        return out

    def turned(self, turn: Array | None) -> NodalRows:
        """The rows in axes turned by ``turn`` (d, d)."""
        return self if turn is None else NodalRows(self.count, self.row, self.node, self.value @ turn)

    def columns(self, values: Array) -> Array:
        """Products with columns (n d, m) on the nodes, (count, m)."""
        d = self.value.shape[1]
        of_nodes = values.reshape(len(values) // d, d, values.shape[1])
        return self._sums((self.value[:, None, :] @ of_nodes[self.node])[:, 0])

    def matrix(self, n: int) -> Any:
        """The rows as a sparse matrix (count, n d)."""
        d = self.value.shape[1]
        columns = self.node[:, None] * d + np.arange(d)
        return sp.csr_matrix((self.value.ravel(), (np.repeat(self.row, d), columns.ravel())), shape=(self.count, n * d))
