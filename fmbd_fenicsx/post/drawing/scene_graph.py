"""A drawing as data: pieces with a surface, edges and a motion. Only level sets need a drawing library.

A piece says what it stands for (:class:`Role`), which triangles and edges it has, and where its points are at each instant:

    at rest          x = X                      :class:`Still`
    rigid, affine    x = o(t) + A(t) X          :class:`MovingPoints`: bodies, joints; springs, whose A stretches them
    deforming        x(t)                       :class:`Deforming`: skins of elastic bodies, wires

All points are in space, (n, 3); a plane scene lies in z = 0. Lengths in m, world axes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, Protocol

import numpy as np

from ...rotations import Array


class Role(Enum):
    """What a piece stands for; in the plane a later role is drawn in front of an earlier one."""

    GROUND = "ground"
    OBSTACLE = "obstacle"
    BODY = "body"
    WIRE = "wire"
    SPRING = "spring"
    JOINT = "joint"
    DRIVE = "drive"
    ARROW = "arrow"

    @property
    def layer(self) -> int:
        """Number of the layer, from the back."""
        return list(Role).index(self)


class Motion(Protocol):
    """Where the points of a piece are."""

    def at(self, k: int) -> Array:
        """Points at instant k, (n, 3)."""


@dataclass(frozen=True)
class Still:
    """Points (n, 3) that stay where they are."""

    points: Array

    def at(self, k: int) -> Array:
        """The points."""
        return self.points


@dataclass(frozen=True)
class MovingPoints:
    """x = o + A X: ``points`` X (n, 3), ``origin`` o (instants, 3), ``matrix`` A (instants, 3, 3)."""

    points: Array
    origin: Array
    matrix: Array

    def at(self, k: int) -> Array:
        """The points at instant k."""
        return np.asarray(self.origin[k] + self.points @ self.matrix[k].T)


@dataclass(frozen=True)
class Deforming:
    """Every point on its own: ``points`` (instants, n, 3)."""

    points: Array

    def at(self, k: int) -> Array:
        """The points at instant k."""
        return np.asarray(self.points[k])


@dataclass(frozen=True)
class Solid:
    """A surface: points (n, 3), triangles (m, 3) and edges (k, 2) of point numbers."""

    points: Array
    triangles: np.ndarray
    edges: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=int))

    def moved(self, origin: Any, matrix: Any = None) -> Solid:
        """The same surface at o + A X."""
        turned = self.points if matrix is None else self.points @ np.asarray(matrix, dtype=float).T
        return replace(self, points=np.asarray(origin, dtype=float) + turned)


def joined(solids: Sequence[Solid]) -> Solid:
    """Several surfaces as one."""
    first = np.cumsum([0, *(len(s.points) for s in solids)])

    return Solid(
        np.concatenate([s.points for s in solids]),
        np.concatenate([s.triangles + n for s, n in zip(solids, first, strict=False)]),
        np.concatenate([s.edges + n for s, n in zip(solids, first, strict=False)]),
    )


@dataclass(frozen=True)
class Piece:
    """One thing that is drawn.

    Attributes:
        name: of the body, joint, force or obstacle that it shows.
        role: what it stands for.
        triangles, edges: point numbers, (m, 3) and (k, 2).
        motion: where its points are.
        paint: a quantity on each triangle, (instants, m), or None.
        shade: which of several bodies it is, for colours that tell them apart.
        flag: at which instants it is in another state (a slack wire), (instants,) bool, or None.
    """

    name: str
    role: Role
    triangles: np.ndarray
    edges: np.ndarray
    motion: Motion
    paint: Array | None = None
    shade: int = 0
    flag: np.ndarray | None = None

    def at(self, k: int) -> Array:
        """Points at instant k, (n, 3)."""
        return self.motion.at(k)


@dataclass(frozen=True)
class ArrowScale:
    """What the arrows of one kind stand for: ``kind`` in words, the ``largest`` force (N) of all instants, which has the longest
    arrow, and the ``shade`` of their colour.
    """

    kind: str
    largest: float
    shade: int

    @property
    def text(self) -> str:
        """For legends."""
        return f"{self.kind}, longest arrow {self.largest:.3g} N"


@dataclass(frozen=True)
class Drawing:
    """All pieces of a run at its snapshots.

    Attributes:
        title: name of the scene. ``dim``: 2 or 3. ``up``: direction against gravity, (3,).
        times: of the snapshots, s.
        pieces: complete on rank 0 only.
        label: what the paint shows, with its unit; "" without paint.
        scales: what the arrows of forces stand for, one entry for each kind that is drawn.
    """

    title: str
    dim: int
    up: Array
    times: Array
    pieces: tuple[Piece, ...]
    label: str = ""
    scales: tuple[ArrowScale, ...] = ()

    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner of everything but the ground's patches over all instants, (3,) each."""
        boxes = [(x.min(0), x.max(0)) for x in self.places()]
        if not boxes:
            return -np.ones(3), np.ones(3)
        low, high = zip(*boxes, strict=True)
        return np.min(low, axis=0), np.max(high, axis=0)

    def places(self) -> Iterator[Array]:
        """Points (n, 3) of each piece but the ground's patches at each instant."""
        shown = [p for p in self.pieces if p.role is not Role.GROUND] or list(self.pieces)
        return (x for p in shown for k in range(len(self.times)) if len(x := p.at(k)))

    @property
    def span(self) -> tuple[float, float]:
        """Smallest and largest value of the paint; (0, 1) without paint."""
        values = [p.paint for p in self.pieces if p.paint is not None and p.paint.size]
        if not values:
            return 0.0, 1.0
        low = min(float(v.min()) for v in values)
        high = max(float(v.max()) for v in values)
        return low, high if high > low else low + 1.0
