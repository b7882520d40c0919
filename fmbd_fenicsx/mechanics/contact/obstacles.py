"""Rigid obstacles: a shape placed in the world: at rest, moving as prescribed, or carried by a rigid body, on which it reacts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...checks import check_fields, instance
from ...errors import InputError
from ..bodies.bodies import RigidBody
from ..shapes import Shape

Way = tuple[tuple[float, float], ...]  # times (s) and weights by which places of moving obstacles are summed up


def way_over(start: float, h: float) -> Way:
    """How far obstacles come from a start (s) on in a time h (s)."""
    return (start, -1.0), (start + h, 1.0)


def way_at_start(start: float, h: float) -> Way:
    """How far they would come with their velocities at the start: of second order, by places that a step asks for anyway."""
    return (start, -3.0), (start + 0.5 * h, 4.0), (start + h, -1.0)


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A rigid obstacle: a shape at rest, moving as ``motion(t) -> (position (d,), rotation)``, or carried by a rigid body.

    Args:
        name: what messages call it.
        shape: its signed distance, in the obstacle's axes: the world's, those of ``motion``, or those of the body ``on``
            (origin in its centre of mass).
        motion: position (m) and rotation (an angle in the plane, a matrix in space) at time t (s).
        on: the rigid body that carries it.
    """

    name: str
    shape: Shape
    motion: Callable[[float], tuple[Any, Any]] | None = None
    on: Any = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.on is not None:
            instance(f'Obstacle "{self.name}": on', self.on, RigidBody)
            self.shape.check(f'Obstacle "{self.name}"', self.on.dim)
        if self.motion is not None and self.on is not None:
            raise InputError(
                f'Obstacle "{self.name}" is carried by a body and also moves by prescription: give one of them.'
            )
