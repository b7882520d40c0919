"""Break points of a scene are told to the motions in it, whose rates by differences must not reach across them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from ...mechanics.forces.effort_laws import Feedback
from ...mechanics.forces.forces import CoordinateForce
from ...mechanics.joints.couplings import SmoothMotion
from ...mechanics.joints.drives import Coupling

if TYPE_CHECKING:
    from .scene import Scene


def tell_break_points(scene: Scene) -> None:
    """Every prescribed motion and every target of a motor is smooth between the break points of its scene only."""
    for motion in _given(scene):
        if isinstance(motion, SmoothMotion):
            motion.steps.break_at(scene.breakpoints)


def _given(scene: Scene) -> Iterator[Any]:
    """All functions of time that have rates."""
    for joint in scene.joints.values():
        yield from (row.motion for row in joint.rows)
        if isinstance(joint, Coupling):
            yield joint.motion
    yield from (tie.motion for tie in scene.ties.values())
    for force in scene.forces.values():
        if isinstance(force, CoordinateForce) and isinstance(force.law, Feedback):
            yield force.law.target
