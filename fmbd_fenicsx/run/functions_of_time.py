"""Functions of time that a run warns of: drives whose accelerations jump where no break point says so, tables that end early.

A velocity that rises in a ramp is a motion whose s'' jumps, by J. Generalized-alpha goes on with accelerations of before: with
rho_inf = 0.8 the effort of the drive is off by J times its inertia at the jump, and by a twentieth of that for 17 steps (GGL) or
27 (index 3), however small these are, and under error control. From a break point on it begins anew, and nothing is off.
What interpolates a table goes on behind its end with the last polynomial, which grows by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import FmbdError
from ..log import log
from ..mechanics.forces.effort_laws import Feedback
from ..mechanics.forces.forces import OfTime
from ..mechanics.joints.constraints import standstill
from ..mechanics.joints.couplings import SmoothMotion
from ..rotations import Array
from ..system.scene.scene import Scene
from ..system.system import System
from .accuracy.jumps_in_time import instants, jumps_in_time
from .judges.prescribed_motions import prescribed
from .named_times import functions_of
from .schedule import StepSchedule, far_side, near_side

SHARE = 0.05  # of the largest acceleration: a jump that is told
NAMED = 6  # instants in a message
LOOKS, EACH = 200, 8  # intervals of a run that are looked at, and of one of its steps, at most


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
    known = (x for x, _ in prescribed(system) if isinstance(x, SmoothMotion) and not (x.by_differences or x.analytic))
    looked_at = instants(schedule, min(LOOKS, EACH * schedule.steps or LOOKS))
    for motion in {id(x): x for x in known}.values():
        try:
            found = _jumps(Accelerations(motion), looked_at)
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


ROUNDING = 1e-9  # share of the run by which a table may be shorter


def warn_of_short_tables(scene: Scene, begin: float, end: float) -> None:
    """Tell of tables that end, or begin, within a run between two times (s)."""
    named: list[tuple[str, Any]] = [(f'{force.kind} "{force.name}"', force) for force in scene.forces.values()]
    named += [(f'joint "{joint.name}"', joint) for joint in scene.joints.values()]
    named += [(f'a load on body "{body.name}"', body) for body in scene.bodies.values()]

    functions = [("gravity", scene.gravity)] if callable(scene.gravity) else []
    functions += [(what, f) for what, thing in named for f in functions_of(thing) if f is not standstill]
    for what, function in functions:
        span = _span(function)
        if span is None or (span[0] <= begin + ROUNDING * end and span[1] >= end * (1.0 - ROUNDING)):
            continue

        log.warning(
            "the table of %s goes from %g to %g s, the run from %g to %g s: outside, its interpolation is extrapolated. Let the "
            "table cover the run, or give a function that says what is there",
            what, *span, begin, end,
        )  # fmt: skip


def _span(function: Any) -> tuple[float, float] | None:
    """From where to where (s) an interpolation knows its values, as SciPy's say, also one that a drive, a motor or a motion asks;
    None for other functions.
    """
    if isinstance(function, OfTime | Feedback):
        function = function.given if isinstance(function, OfTime) else function.target
    if isinstance(function, SmoothMotion):
        function = function.table
    if getattr(function, "extrapolate", None) not in (True, np.True_):
        return None
    places, degree = getattr(function, "x", None), getattr(function, "k", 0)
    if places is None:
        knots = np.asarray(getattr(function, "t", ()), dtype=float)
        places = knots[degree : len(knots) - degree]
    return (float(places[0]), float(places[-1])) if len(places) else None
