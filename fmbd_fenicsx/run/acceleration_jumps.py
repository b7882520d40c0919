"""Drives whose accelerations jump where no break point says so, under schemes that carry accelerations from step to step.

A velocity that rises in a ramp is a motion whose s'' jumps, by J. Generalized-alpha goes on with accelerations of before: with
rho_inf = 0.8 the effort of the drive is off by J times its inertia at the jump, and by a twentieth of that for 17 steps (GGL) or
27 (index 3), however small these are, and under error control. From a break point on it begins anew, and nothing is off.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import FmbdError
from ..log import log
from ..mechanics.joints.couplings import SmoothMotion
from ..rotations import Array
from ..system.system import System
from .accuracy.jumps_in_time import instants, jumps_in_time
from .judges.prescribed_motions import prescribed
from .schedule import StepSchedule, far_side, near_side

SHARE = 0.05  # of the largest acceleration: a jump that is told
NAMED = 6  # instants in a message
LOOKS = 200  # intervals of a run that are looked at


@dataclass(frozen=True)
class Accelerations:
    """s'' of one motion, as :class:`.HeldState` tells forces; ``known`` at the times (s) that were asked for."""

    motion: SmoothMotion
    known: dict[float, float] = field(default_factory=dict)

    def rows(self, times: Array) -> Array:
        """At given times (s), (n, 1)."""
        at = [float(t) for t in times]
        self.known.update((t, self.motion(t)[2]) for t in at if t not in self.known)
        return np.array([[self.known[t]] for t in at]).reshape(-1, 1)

    def scale(self, rows: Array) -> Array:
        """The largest of all times, (1,)."""
        most = np.abs(rows).max(axis=0, initial=0.0)
        return np.where(most > 0.0, most, 1.0)

    def change(self, a: Array, b: Array, scale: Array) -> Array:
        """The change of each of several rows, over the scale."""
        return np.asarray((np.abs(b - a) / scale)[:, 0])


def warn_of_acceleration_jumps(system: System, schedule: StepSchedule) -> None:
    """Tell of drives, and of when their accelerations jump (s). Those that differences tell are smooth over their widths."""
    known = (x for x, _ in prescribed(system) if isinstance(x, SmoothMotion) and not x.by_differences)
    for motion in {id(x): x for x in known}.values():
        try:
            found = _jumps(Accelerations(motion), instants(schedule, LOOKS))
        except FmbdError:  # beyond where a run has ended that was to be longer
            continue

        if not found:
            continue
        more = f" and {len(found) - NAMED} more" if len(found) > NAMED else ""
        log.warning(
            'the acceleration of %s "%s" jumps at t = %s s%s, where no break point is: this scheme goes on with that of '
            "before, and efforts of drives and reactions are off by as much as they jump, some 20 steps long. Tell it, "
            "Scene(breakpoints=...), or take fmbd.Radau()",
            motion.of, motion.name, ", ".join(f"{t:.9g}" for t in found[:NAMED]), more,
        )  # fmt: skip


def _jumps(told: Accelerations, stretches: list[Array]) -> list[float]:
    """Instants (s) at which they jump by more than :data:`SHARE`, ascending."""
    found = jumps_in_time(told, stretches)
    scale = told.scale(told.rows(np.concatenate(stretches)))
    before, behind = (told.rows(np.array([side(t) for t in found])) for side in (near_side, far_side))
    return [t for t, size in zip(found, told.change(before, behind, scale), strict=True) if size > SHARE]
