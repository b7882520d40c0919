"""Tables of time that end before the run: what interpolates them goes on with the last polynomial, which grows by itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ...log import log
from ...mechanics.forces.effort_laws import Feedback
from ...mechanics.forces.forces import OfTime
from ...mechanics.joints.couplings import SmoothMotion
from ...system.scene.scene import Scene

ROUNDING = 1e-9  # share of the run by which a table may be shorter


def warn_of_short_tables(scene: Scene, begin: float, end: float) -> None:
    """Tell of tables that end, or begin, within a run between two times (s)."""
    for what, function in _functions_of_time(scene):
        span = _span(function)
        if span is None or (span[0] <= begin + ROUNDING * end and span[1] >= end * (1.0 - ROUNDING)):
            continue
        log.warning(
            "the table of %s goes from %g to %g s, the run from %g to %g s: outside, its interpolation is extrapolated. Let the "
            "table cover the run, or give a function that says what is there",
            what, *span, begin, end,
        )  # fmt: skip


def _functions_of_time(scene: Scene) -> Iterator[tuple[str, Any]]:
    """Functions of a user's own that are asked with the time alone, and whose they are."""
    yield "gravity", scene.gravity
    for force in scene.forces.values():
        law: Any = getattr(force, "law", None)
        law = law.given if isinstance(law, OfTime) else law.target if isinstance(law, Feedback) else law
        yield f'{force.kind} "{force.name}"', law.table if isinstance(law, SmoothMotion) else law
    for joint in scene.joints.values():
        for motion in (getattr(joint, "motion", None), *(row.motion for row in joint.rows)):
            if isinstance(motion, SmoothMotion):
                yield f'joint "{joint.name}"', motion.table
    for body in scene.bodies.values():
        for load in getattr(body, "loads", ()):
            yield f'a load on body "{body.name}"', getattr(load, "time", None)


def _span(function: Any) -> tuple[float, float] | None:
    """From where to where (s) an interpolation knows its values, as SciPy's say; None for other functions."""
    if getattr(function, "extrapolate", None) not in (True, np.True_):
        return None
    places, degree = getattr(function, "x", None), getattr(function, "k", 0)
    if places is None:
        knots = np.asarray(getattr(function, "t", ()), dtype=float)
        places = knots[degree : len(knots) - degree]
    return (float(places[0]), float(places[-1])) if len(places) else None
