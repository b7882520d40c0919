"""Bodies with an energy whose cells are turned inside out: shapes that balance forces and that no material takes."""

from __future__ import annotations

from ..fem.cell_volumes import least_volume
from ..rotations import Array
from .system import System


def inside_out(system: System, q: Array) -> str:
    """The name of a body with a cell that is turned inside out in a configuration, "" where there is none; collective."""
    for k, part in system.fields:
        if part.field.nonlinear and least_volume(part.field, system.local_q(q, k)) <= 0.0:
            return str(part.name)
    return ""
