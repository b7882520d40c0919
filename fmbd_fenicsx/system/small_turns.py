"""A look at what is to turn little: bodies in absolute coordinates, x = X + u, with forms for small rotations, and bushings.

A rotation by theta strains a body of a linear form, or of an energy of linear strains, by 1 - cos theta, and no joint or
energy shows it. The stress of that turns the body back, as no stress does: of stiff bodies, and of those that hardly change their
volume, more than all that acts on them long before theta is large. A viscous form of linear strains brakes the rotation itself.
The moments of a bushing change their sign at half a turn, at the same energy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..log import log
from ..mechanics.forces.bushing import BushingLoads
from .layout import State
from .system import System

SMALL, LEAST = 0.05, 1e-6  # rad; turns of less are roundoff
OWN = 0.2  # of the moments that act on a body
HALF = 0.9 * np.pi  # rad: what is turned by more is soon turned by half a turn


class SmallTurns:
    """Who looks at those among the bodies in absolute coordinates that are to turn little."""

    looks, between = 128, 8  # at a run of equal steps, at least; steps from one to the next where it is short

    def __init__(self, system: System) -> None:
        self.system = system
        self.bodies: list[tuple[int, Any]] = [(k, p) for k, p in system.fields if p.turns_little]

    def look(self, state: State) -> None:
        """Warn once of each body that has turned by more than is small; collective."""
        for k, part in list(self.bodies):
            u = self.system.local_q(state.q, k)
            R = part.mean_rotation(u)
            sine = float(np.linalg.norm(R - R.T)) / np.sqrt(8.0)
            own = part.own_moment(u) if LEAST < sine <= SMALL else 0.0
            if sine <= SMALL and own <= OWN:
                continue
            self.bodies.remove((k, part))
            log.warning(
                'body "%s" has turned by %.2g rad in absolute coordinates%s: %s',
                part.name,
                np.arcsin(sine),
                f", and its strains turn it by {100 * own:.0f} % of what joints and loads do" if own else "",
                part.turns_little.format(strain=1.0 - np.sqrt(1.0 - sine**2)),
            )


class HalfTurns:
    """Who looks at the bushings that resist rotations."""

    looks, between = 64, 8  # as of :class:`SmallTurns`

    def __init__(self, system: System) -> None:
        self.system = system
        self.bodies = [x for x in system.forces if isinstance(x, BushingLoads)]

    def look(self, state: State) -> None:
        """Warn once of each group of bushings where one is turned by half a turn; collective."""
        kin = self.system.at(state.t, state.q, state.v).kin
        for loads in list(self.bodies):
            turns = loads.turns(kin)
            if turns.max() <= HALF:
                continue
            self.bodies.remove(loads)
            log.warning(
                'bushing "%s" is turned by %.3g rad: its moments change their sign at half a turn. Take a joint and '
                "fmbd.joint_spring on its angle, which counts turns, or leave out the stiffness against rotations",
                loads.forces[int(turns.argmax())].name, turns.max(),
            )  # fmt: skip
