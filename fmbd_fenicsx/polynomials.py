"""Lagrange's polynomials of nodes x_j: one at its own node, zero at all others,

l_j(x) = prod_{i != j} (x - x_i) / (x_j - x_i).                                                                (1)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .rotations import Array


def lagrange(nodes: Sequence[Any] | Array, x: Any) -> list[Any]:
    """(1) of nodes that are numbers, or arrays of one shape with x; of a few numbers sooner than by arrays."""
    values = []
    for j, node in enumerate(nodes):
        value: Any = 1.0
        for i, other in enumerate(nodes):
            if i != j:
                value = value * ((x - other) / (node - other))
        values.append(value)
    return values


def lagrange_values(nodes: Array, x: Array) -> Array:
    """(1) at places x (n,), (n, k), of nodes (k,), or of each place's own (n, k)."""
    values = lagrange(nodes.T, x)
    return np.stack(values, axis=-1) if len(values) > 1 else np.ones((*x.shape, 1))
