"""How far linear bodies are bent in their moving frames: a linear form takes a rotation by theta of its material for a stretch

    s = 1 - cos theta,                                                                                      (1)

of which ``stiffening``, of second order, leaves some s^2 (places of soft pendulums are off by s^2 to 1.5 s^2 of their lengths, up
to s = 0.3). Looked at are the surfaces in use, and the mean rotation of the mass in frames that do not go along with it.
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
            s = max(turned.get(part.frame, 0.0), self._mean(part, self.system.local_q(state.q, k)))
            left = s * s if stiffened else s
            if left <= SHARE:
                continue
            self.bodies = [b for b in self.bodies if b[0] != k]
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
