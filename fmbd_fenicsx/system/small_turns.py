"""A look at bodies in absolute coordinates, x = X + u, whose forms are for small rotations.

A rotation by theta strains a body of a linear form, or of an energy of linear strains, by 1 - cos theta, and no joint or
energy shows it; a viscous form of linear strains brakes the rotation itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..log import log
from .layout import State
from .system import System

SMALL = 0.05  # rad


class SmallTurns:
    """Who looks at those among the bodies in absolute coordinates that are to turn little."""

    looks, between = 128, 8  # at a run of equal steps, at least; steps from one to the next where it is short

    def __init__(self, system: System) -> None:
        self.system = system
        self.bodies: list[tuple[int, Any]] = [(k, p) for k, p in system.fields if p.turns_little]

    def look(self, state: State) -> None:
        """Warn once of each body that has turned by more than is small; collective."""
        for k, part in list(self.bodies):
            R = part.mean_rotation(self.system.local_q(state.q, k))
            sine = float(np.linalg.norm(R - R.T)) / np.sqrt(8.0)
            if sine <= SMALL:
                continue
            self.bodies.remove((k, part))
            log.warning(
                'body "%s" has turned by %.2g rad in absolute coordinates: %s',
                part.name,
                np.arcsin(sine),
                part.turns_little.format(strain=1.0 - np.sqrt(1.0 - sine**2)),
            )
