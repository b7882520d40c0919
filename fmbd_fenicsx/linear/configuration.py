"""What the matrices of a step depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..rotations import Array
from .blocks.field_blocks import Weights


@dataclass(frozen=True, eq=False)
class MatrixConfiguration:
    """What the matrices depend on; velocities only where they weigh damping or stiffness. ``versions``: of tangents, columns."""

    t: float
    q: Array
    v: Any
    weights: Weights
    versions: list[tuple[int, int]]

    def equals(self, other: MatrixConfiguration) -> bool:
        """Whether the matrices are the same to the last bit."""
        plain = self.t == other.t and self.weights == other.weights and self.versions == other.versions
        return plain and all(x is y or np.array_equal(x, y) for x, y in ((self.q, other.q), (self.v, other.v)))
