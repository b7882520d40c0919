"""Tables of time that end before the run: what interpolates them goes on with the last polynomial, which grows by itself."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...log import log
from ...mechanics.forces.effort_laws import Feedback
from ...mechanics.forces.forces import OfTime
from ...mechanics.joints.constraints import standstill
from ...mechanics.joints.couplings import SmoothMotion
from ...system.scene.scene import Scene
from ..named_times import functions_of

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
