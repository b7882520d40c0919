"""How far linear bodies are bent in their moving frames: a linear form takes a rotation by theta of its material for a stretch

    s = 1 - cos theta,                                                                                      (1)

of which ``stiffening``, of second order, leaves some s^2 (places of soft pendulums are off by s^2 to 1.5 s^2 of their lengths, up
to s = 0.3). Looked at are the surfaces in use, and the mean rotation of the mass in frames that do not go along with it.

Surfaces that are tied and turn against each other resist (1) by themselves, and what hardly changes its volume, far more than the
turn: a bushing is a tenth too stiff where forces on its surfaces do a fifth of its energy by (1), at any angle.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..log import log
from ..rotations import Array
from .layout import State
from .spins import in_linear_frames
from .system import System

SHARE = 0.02  # of its size by which a body may be stretched where it is turned most
WORK = 0.2  # of its energy that forces on its surfaces may do by that


class Bends:
    """Who looks at the linear bodies of a system in moving frames."""

    looks, between = 8, 1  # at a run of equal steps, at least; steps from one to the next where it is short

    def __init__(self, system: System) -> None:
        self.system = system
        self.bodies = in_linear_frames(system)

    def look(self, state: State) -> None:
        """Warn once of each body that is bent too far for its form; collective."""
        if not self.bodies:
            return
        turned = self._surfaces(state)

        for k, part, stiffened in list(self.bodies):
            u = self.system.local_q(state.q, k)
            s = max(turned.get(part.frame, 0.0), self._mean(part, u))
            left = s * s if stiffened else s
            work = part.work_of_turns(u) if part.distributed and left <= SHARE else 0.0
            if left <= SHARE and work <= WORK:
                continue
            self.bodies = [b for b in self.bodies if b[0] != k]
            if left <= SHARE:
                log.warning(
                    'body "%s" takes turns of its surfaces in its floating frame for strains, which its linear form resists: '
                    "these do %.0f %% of its energy, and it is too stiff. Take an energy in place of elastic=",
                    part.name, 100 * work,
                )  # fmt: skip
                continue
            log.warning(
                'body "%s" is bent by %.2g rad in its floating frame: its linear form%s is for small rotations, and stretches it '
                "by some %.1g of its size there. Take %sseveral bodies joined, or one with an energy",
                part.name,
                np.arccos(1.0 - s),
                " with stiffening" if stiffened else "",
                left,
                "a frame in its middle (mean axes), " if part.mean_rates is not None else "",
            )

    def _surfaces(self, state: State) -> dict[int, float]:
        """The largest stretch (1) of the surfaces in use by the frame that they are on; collective."""
        markers, ev = self.system.markers, self.system.at(state.t, state.q, state.v)
        found: dict[int, float] = {}
        if not markers.surface.size:
            return found
        R = markers.rotations(ev.rotation, ev.port)[markers.surface]
        frames, at_start = markers.frame[markers.surface], markers.rotation[markers.surface]
        cosines = np.einsum("nki,nkj,nij->n", ev.rotation[frames], R, at_start)
        for frame, sum_of in zip(frames.tolist(), cosines.tolist(), strict=True):
            found[frame] = max(found.get(frame, 0.0), 0.5 * (R.shape[-1] - sum_of))
        return found

    def _mean(self, part: Any, u: Array) -> float:
        """The stretch (1) of the mean rotation of the mass in the frame; collective."""
        if part.mean_rates is None:
            return 0.0
        mean = part.mean_rates[self.system.motions.dim :] @ u
        angle = float(np.linalg.norm(part.field.total(mean) if part.distributed else mean))
        return 1.0 - float(np.cos(min(angle, np.pi)))
