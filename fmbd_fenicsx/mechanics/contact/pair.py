"""What all pairs that may touch have: the points of the slave, the obstacle and what carries it, and their laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...rotations import Array, Motions
from .contact_set import Here
from .obstacles import Way
from .rows import Rows
from .trace import ContactTrace, SurfaceNodes


@dataclass(frozen=True)
class Side:
    """Slave points: nodes of a trace (``trace`` its number, ``surface``), or ``points`` (m, d) of moving ``frames`` (m,)."""

    trace: int
    surface: SurfaceNodes | None
    frames: np.ndarray
    points: Array
    radius: float


@dataclass(frozen=True)
class SomeRows:
    """Those candidates of a ``group`` of pairs that are ``near``, (m,) bool."""

    group: Any
    near: np.ndarray

    def rows(self, here: Here, way: Way | None) -> Rows:
        """Their rows, taken from those of all; collective."""
        return self.group.rows(here, way).take(self.near)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Carrier:
    """Pose of an obstacle: a frame of the system (its number, the ground included) times an optional prescribed motion."""

    frame: int
    offset: Array  # pose of a locked body, (n_pose,)
    motion: Callable[[float], Array] | None


def bodies_overlap(name: str, depth: float, x: Array, normal: Array) -> str:
    """The sentence that refuses a start of contact ``name`` with a depth (m) at a point x along a normal, world axes."""
    return (
        f'Contact "{name}": the bodies overlap at the start by {depth:.3g} m, at {np.round(x, 6).tolist()}. '
        f"Move one of them apart along {np.round(normal, 3).tolist()}."
    )


@dataclass(frozen=True)
class Pair:
    """One contact with an obstacle, ready to evaluate."""

    name: str
    slave: Side
    shape: Any
    carrier: Carrier
    friction: float
    restitution: float
    search: float | None
    massless: bool
    bounces: bool  # its points carry inertia that cannot be taken off: those of a rigid body, or of modes

    searches: ClassVar[bool] = False  # whether :meth:`update` changes what its gaps are
    exchanged: ClassVar[bool] = False  # the slave is the one that was given

    @property
    def moving(self) -> bool:
        """Whether the obstacle moves as prescribed."""
        return self.carrier.motion is not None

    def overlap(self, system: Any, depth: float, x: Array, normal: Array) -> str:
        """The sentence that refuses a start with an overlap of a depth (m), at a point x along a normal, world axes."""
        said = bodies_overlap(self.name, depth, x, normal)
        if self.carrier.frame < 0:
            return said
        return f"{said} (A shape that a body carries stands in axes of it, with the origin in its centre of mass.)"

    @classmethod
    def together(cls, pairs: list[Any], motions: Motions, traces: tuple[ContactTrace, ...]) -> list[Any]:
        """What evaluates pairs of this kind: each for itself, or some in one."""
        return pairs

    def some(self, near: np.ndarray) -> SomeRows:
        """Those of its candidates that are ``near``, (m,) bool."""
        return SomeRows(self, near)

    def pressures(self, force: Array) -> Array:
        """Pressures (N/m^(d-1), N on rigid points) of normal forces (.., m) in N on the candidates; see :mod:`.trace`."""
        surface = self.slave.surface
        if surface is None:
            return force
        return (force if surface.gather is None else (surface.gather @ force.T).T) / surface.weights

    @property
    def trace_nodes(self) -> np.ndarray | None:
        """Numbers in the trace of the candidates' nodes, None for rigid points."""
        return None if self.slave.surface is None else self.slave.surface.nodes

    @property
    def count(self) -> int:
        """Candidates."""
        return len(self.slave.points) if self.slave.surface is None else len(self.slave.surface.nodes)
