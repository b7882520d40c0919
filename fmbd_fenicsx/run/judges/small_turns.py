"""A look at linear bodies in absolute coordinates, x = X + u: their strains are those of small rotations.

A rotation by theta stretches such a body by 1 - cos theta, and no joint or energy shows it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...log import log
from ...system.layout import State
from ...system.system import System

SMALL = 0.05  # rad
LOOKS, FEW = 128, 8  # at a run of equal steps, at least, and steps from one to the next where it is short


class SmallTurns:
    """Who looks at the linear ones among the bodies in absolute coordinates."""

    def __init__(self, system: System, *, silent: bool) -> None:
        """``silent``: of a run that warns of nothing."""
        self.system = system
        self.bodies: list[tuple[int, Any]] = [(k, p) for k, p in system.fields if p.turns_little and not silent]

    def most(self, steps: int) -> int:
        """So many of all steps at most between two looks."""
        return max(steps // LOOKS + 1, FEW) if self.bodies else steps

    def look(self, state: State) -> None:
        """Warn once of each body that has turned by more than is small; collective."""
        for k, part in list(self.bodies):
            R = part.mean_rotation(self.system.local_q(state.q, k))
            sine = float(np.linalg.norm(R - R.T)) / np.sqrt(8.0)
            if sine <= SMALL:
                continue
            self.bodies.remove((k, part))
            log.warning(
                'body "%s" has turned by %.2g rad in absolute coordinates: its linear form is for small rotations, and stretches '
                "it by some %.1g of its size. Take a FloatingBody, or an energy in place of elastic=",
                part.name, np.arcsin(sine), 1.0 - np.sqrt(1.0 - sine**2),
            )  # fmt: skip
