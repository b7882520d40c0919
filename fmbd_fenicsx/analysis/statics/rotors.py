"""Whether bodies that spin among others at rest do so steadily: nothing may change as they turn.

They are turned by some angles, and must be in equilibrium as well. See :mod:`..small_motions.steady`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import InputError
from ...system.system import System
from ..small_motions.steady import MOUNTS, BodySpin
from .static_newton import StaticNewton, StaticPoint

ANGLES = (1.0, 2.5)  # by which bodies are turned, rad
CHANGED = 1e-6  # increment, over the model's length, and speed, over that of the rotation, which are none


def check_steady(newton: StaticNewton, point: StaticPoint, t: float) -> None:
    """Refuse what holds the bodies that spin, and equilibria that change as they turn; collective."""
    system, spin = newton.residual.system, newton.residual.spin
    if not isinstance(spin, BodySpin) or spin.rate == 0.0:
        return

    _check_held(system, newton.residual.at(point.q, t), spin)

    # what turns must leave forces and gaps as they are
    lam = point.lam
    for angle in ANGLES:
        q = spin.turned(system, point.q, angle)
        newton.take(replace(point, q=q), t)

        there, later = (newton.residual.at(q, x) for x in (t, t + angle / spin.rate))
        balance = newton.residual.values(there, lam)[0]
        gaps = later.constraint()

        moved = system.max_abs(newton.solver.solve(-balance, -gaps)[0])
        if moved > CHANGED * system.length:
            raise InputError(
                f"The rotation of {spin.listed} is not steady: turned by {angle:g} rad, the scene moves by {moved:.3g} m. "
                "Bodies that spin among others at rest must be round about their axes, with the mass centre on it and loads that "
                "do not turn with them. " + MOUNTS
            )


def _check_held(system: System, ev: Any, spin: BodySpin) -> None:
    """Refuse joints and drives that the rotation violates."""
    if not system.n_lam:
        return
    missed = np.abs(ev.opening())
    row = int(missed.argmax())
    if missed[row] > CHANGED * abs(spin.rate) * max(system.length, 1.0):
        raise InputError(
            f'"{system.block_of(row).name}" does not let {spin.listed} spin with {spin.rate:g} rad/s: it would open with '
            f"{missed[row]:.3g} (rad/s, m/s). Name all bodies that turn, and give drives the same rate."
        )
