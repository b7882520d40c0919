"""Moments about mean-axis frames that the constant columns of a step's matrix leave out."""

from __future__ import annotations

import numpy as np

from ...rotations import Array
from ...system.system import System


def frame_moments(system: System, sways: list[Array | None], cm: float, increments: list[Array]) -> Array | None:
    """Moments, (n_core,), that field increments dU have about their frames by M (e x U): -cm (M U) x dU; collective.

    ``sways``: M U of each field or None. They are applied after the solve, by a second one with the core's factor: no
    back-solve, and a light axis of a slender body does not slow Newton's iteration. None where there are none.
    """
    if all(MU is None for MU in sways):
        return None
    m = system.motions
    out: Array = np.zeros(system.n_core)
    for (_, f), MU, dU in zip(system.fields, sways, increments, strict=True):
        if MU is not None:
            at = f.frame * m.n_twist
            out[at + m.dim : at + m.n_twist] -= cm * f.field.total(m.moment(MU, dU.reshape(-1, m.dim)).sum(0))
    return out
