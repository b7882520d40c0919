"""States of systems with floating elastic fields by the driver: balance and constraints in one call each.

The driver's tables of a field hold its matrices and ports; what its own factor has solved for a size of step is left out, as
nothing is solved here. Rows of constraints with their ports, and biases of surfaces, are NumPy's.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...rotations import Array
from ..system import System
from .evaluation import STORAGE_LIMIT, Configurations, DriverStates
from .items import covers, other_loads
from .library import driver_library, units_of
from .tables import Tables, covers_bodies


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

    def tables_of(self) -> Tables:
        """Tables with fields that nothing is solved for."""
        blocks = [unsolved(part) for _, part in self.system.fields]

        return Tables(self.system, redundant=False, blocks=blocks)

    def rows(self, at: Configurations) -> Array | None:
        """None: G of a field is kept by its ports."""
        return None


def field_states(system: System) -> FieldStates | None:
    """The driver for states of a system with fields, made once; None where it does not know all of it."""
    if "field states" not in system.cache:
        system.cache["field states"] = _made(system)
    found: FieldStates | None = system.cache["field states"]

    return found


def _made(system: System) -> FieldStates | None:
    known = covers_bodies(system) and covers(system) and not any(p.field.nonlinear for _, p in system.fields)
    if not system.fields or not known or system.curved or other_loads(system):
        return None

    library = driver_library(system.motions.dim, units_of(system))
    states = None if library is None else FieldStates(system, library)
    return states if states is None or states.tables.fronts.storage <= STORAGE_LIMIT else None
