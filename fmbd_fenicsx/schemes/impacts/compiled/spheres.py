"""Spheres around what may touch, which compiled code looks at before it looks at contacts (``driver/contact/candidates.c``)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....mechanics.contact.obstacle_pair import ObstaclePair
from ....mechanics.shapes import KNOWN


@dataclass(frozen=True)
class BodySphere:
    """Of a body, about a place in its axes (m): what it holds turns within ``extent``, and reaches ``reach`` from there."""

    body: int
    place: tuple[float, ...]
    extent: float
    reach: float


class Spheres:
    """Those of all pairs, each once.

    ``first`` (pairs,): that of the pair's points, -1 where none holds them; ``single``: pairs that are not between two
    spheres; ``start``, ``partner``: of each sphere those of higher number that it has a pair with, and the pairs.
    """

    def __init__(self, pairs: Sequence[Any], carriers: Sequence[int], dim: int) -> None:
        """``carriers``: bodies that carry the obstacles, -1 for none."""
        numbers: dict[BodySphere, int] = {}
        self.first = np.full(len(pairs), -1)
        single, of_two = [], []

        for k, (pair, carrier) in enumerate(zip(pairs, carriers, strict=True)):
            one = around_points(pair)
            other = around_shape(pair, carrier, dim) if one and carrier >= 0 else None
            if one is None or (carrier >= 0 and (other is None or other == one)):
                single.append(k)
                continue
            self.first[k] = numbers.setdefault(one, len(numbers))
            if other is None:
                single.append(k)
                continue
            ends = sorted((self.first[k], numbers.setdefault(other, len(numbers))))
            of_two.append((*ends, k))

        self.spheres = list(numbers)
        self.single = np.array(single, dtype=np.int32)
        table = np.array(sorted(of_two), dtype=np.int32).reshape(-1, 3)
        self.start = np.searchsorted(table[:, 0], np.arange(len(self.spheres) + 1)).astype(np.int32)
        self.partner = table[:, 1:]


def around_points(pair: Any) -> BodySphere | None:
    """The sphere of a pair's points; None where they are not fixed in one body, or distances to the obstacle tell nothing of how
    near it is.
    """
    if not isinstance(pair, ObstaclePair) or pair.moving or type(pair.shape) not in KNOWN:
        return None
    frames, points = pair.slave.frames, pair.slave.points
    if pair.slave.surface is not None or len(set(frames.tolist())) != 1:
        return None

    # of balls there may be very many
    middle, extent = points[0], 0.0
    if len(points) > 1:
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        extent = float(np.linalg.norm(points - middle, axis=1).max())
    return BodySphere(int(frames[0]), tuple(middle.tolist()), extent, extent + pair.slave.radius)


def around_shape(pair: Any, carrier: int, dim: int) -> BodySphere | None:
    """The sphere of an obstacle that a body carries; None for one without end."""
    held = pair.shape.held(dim)
    if held is None:
        return None
    middle, extent, reach = held
    return BodySphere(carrier, tuple(middle.tolist()), extent, reach)
