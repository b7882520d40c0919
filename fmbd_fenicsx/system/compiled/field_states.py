"""States of systems with floating elastic fields by the driver: balance and constraints in one call each.

The driver's tables of a field hold its matrices and ports; what its own factor has solved for a size of step is left out, as
nothing is solved here. Rows of constraints with their ports, and biases of surfaces, are NumPy's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...rotations import Array
from ..configurations import composed
from .evaluation import Configurations, DriverStates
from .tables import Tables


@dataclass
class Unsolved:
    """A field without a factor: the columns of its inertia and of its frame conditions, at unit compliance."""

    used: np.ndarray
    W: Array
    Y: Array
    factor: Any = field(default=None)


def unsolved(part: Any) -> Unsolved:
    """What the tables ask for of a part with a field, before anything is solved."""
    conditions = np.arange(0 if part.shared_columns else part.n_frame_rows)
    count = part.inertia_columns.shape[1] + len(conditions)

    return Unsolved(conditions, np.eye(count), np.zeros((part.n, count)))


class FieldStates(DriverStates):
    """The driver of a system with fields, for states that Python asks for."""

    solves = False

    def tables_of(self) -> Tables:
        """Tables with fields that nothing is solved for."""
        blocks = [unsolved(part) for _, part in self.system.fields]

        return Tables(self.system, redundant=False, blocks=blocks)

    def rows(self, at: Configurations) -> Array | None:
        """None: G of a field is kept by its ports."""
        return None

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi) in NumPy: most of it is a sum."""
        return composed(self.system, q, xi)
