"""Rows of slaves against obstacles: equation (1) of :mod:`.rows`, for all pairs at once."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from ...rotations import Array, Motions
from ..shapes import distances
from .contact_set import Here
from .obstacles import Way
from .pair import Pair
from .rows import LinearRows, Rows, Touch, directions_of, in_turn
from .trace import ContactTrace, FieldTrace

TOLD = 8  # times at which poses of moving obstacles are kept: those of a step


class ObstaclePair(Pair):
    """A slave, points or nodes, against an obstacle."""

    @classmethod
    def together(cls, pairs: list[Any], motions: Motions, traces: tuple[ContactTrace, ...]) -> list[Any]:
        """One search for all of them."""
        return [ObstacleSearch(pairs, motions, traces)]

    @property
    def thickness(self) -> float:
        """Shortest way through the obstacle, m."""
        return float(self.shape.thickness)


class Carriers:
    """Where obstacles (k,) are: at rest, moved as prescribed, or carried by a frame."""

    def __init__(self, pairs: list[ObstaclePair]) -> None:
        carriers = [p.carrier for p in pairs]
        self.begin = np.array([c.offset for c in carriers])
        self.prescribed = [(i, c.motion) for i, c in enumerate(carriers) if c.motion is not None]
        self.frame = np.array([c.frame for c in carriers])
        self._carried = np.flatnonzero(self.frame >= 0)
        self.at_rest = not (self.prescribed or len(self._carried))
        self._asked: dict[float, list[Array]] = {}  # of prescribed ones, by time

    def poses(self, t: float, frames: Array) -> Array:
        """Poses of all, where frames are known."""
        found = self.begin.copy()
        found[self._carried] = frames[self.frame[self._carried]]
        if self.prescribed:
            found[[i for i, _ in self.prescribed]] = self.told(t)
        return found

    def told(self, t: float) -> list[Array]:
        """Poses of those that move as prescribed; those of the times of a step are asked for once."""
        found = self._asked.get(t)
        if found is None:
            found = self._asked[t] = [motion(t) for _, motion in self.prescribed]
            for old in list(self._asked)[:-TOLD]:
                del self._asked[old]
        return found


class ObstacleSearch:
    """Pairs with obstacles that follow each other: places, distances and rows of all their candidates (m,) in arrays."""

    def __init__(self, pairs: list[ObstaclePair], motions: Motions, traces: tuple[ContactTrace, ...]) -> None:
        counts = [p.count for p in pairs]
        self.of = np.repeat(np.arange(len(pairs)), counts)
        self.count, self.dim = len(self.of), motions.dim
        self.radius, self.friction, self.restitution = (
            np.repeat(x, counts)
            for x in zip(*((p.slave.radius, p.friction, p.restitution) for p in pairs), strict=True)
        )

        self.all_shapes = [p.shape for p in pairs]
        self.shapes = distances(self.all_shapes, self.of, self.dim)

        self.carriers = Carriers(pairs)
        self.pushed = np.flatnonzero(self.carriers.frame[self.of] >= 0)
        self._still: tuple[Array, Array | None] | None = None  # where all are at rest
        if self.carriers.at_rest:
            r, R = self._placed(motions, self.carriers.begin)
            self._still = r, R if (np.eye(self.dim) != R).any() else None

        sides = [p.slave for p in pairs]
        self._take_points(sides, counts)
        self._take_nodes(sides, counts, traces)
        self._chosen: tuple[bytes, ObstacleSearch] | None = None  # those asked for last

    @property
    def prescribed(self) -> list[tuple[int, Any]]:
        """Numbers and motions of the obstacles that move as prescribed."""
        return self.carriers.prescribed

    def _take_points(self, sides: list[Any], counts: list[int]) -> None:
        """Points of frames: which candidates they are, their places, and numbers of their frames."""
        rigid = [s for s in sides if s.surface is None]
        self.rigid = np.flatnonzero(np.repeat([s.surface is None for s in sides], counts))
        self.places = np.concatenate([np.zeros((0, self.dim)), *(s.points for s in rigid)])
        frames = np.concatenate([np.zeros(0, dtype=int), *(s.frames for s in rigid)])
        self.frames, self.on = np.unique(frames, return_inverse=True)

    def _take_nodes(self, sides: list[Any], counts: list[int], traces: tuple[ContactTrace, ...]) -> None:
        """Nodes of traces: which candidates they are, and which nodes of each trace."""
        of_trace = np.repeat([s.trace for s in sides], counts)
        self.nodes: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for i in sorted({s.trace for s in sides if s.surface is not None}):
            at = np.flatnonzero(of_trace == i)
            nodes = np.concatenate([s.surface.nodes for s in sides if s.surface is not None and s.trace == i])
            self.nodes[i] = at, nodes
        on_field = np.array([*(isinstance(tr, FieldTrace) for tr in traces), False])
        self.multiplier = np.where(on_field[of_trace], of_trace, -1)

    def some(self, near: np.ndarray) -> ObstacleSearch:
        """The same with those candidates alone that are ``near``, (m,) bool."""
        key = near.tobytes()
        if self._chosen is None or self._chosen[0] != key:
            self._chosen = key, self._of_some(near)
        return self._chosen[1]

    def _of_some(self, near: np.ndarray) -> ObstacleSearch:
        some = copy.copy(self)
        number = np.cumsum(near) - 1
        some._chosen, some.count = None, int(near.sum())
        some.of, some.multiplier, some.radius = self.of[near], self.multiplier[near], self.radius[near]
        some.friction, some.restitution = self.friction[near], self.restitution[near]
        some.pushed = number[self.pushed[near[self.pushed]]]
        if self._still is not None:
            r, R = self._still
            some._still = r[near], None if R is None else R[near]
        some.shapes = [x for x in distances(self.all_shapes, some.of, self.dim) if len(x[0])]

        kept = near[self.rigid]
        some.rigid, some.places, some.on = number[self.rigid[kept]], self.places[kept], self.on[kept]
        some.nodes = {i: (number[at[near[at]]], nodes[near[at]]) for i, (at, nodes) in self.nodes.items()}
        return some

    def _place(self, here: Here) -> tuple[Touch, tuple[Any, ...]]:
        """Where all candidates stand, and the frames that this was found with; collective."""
        m, poses = here.contacts.m, here.poses
        r, R = self._obstacles(m, here.t, poses)

        # points of the slaves
        x = np.empty((self.count, m.dim))
        origin: Array = np.zeros(0)
        turned: Array = origin
        if len(self.rigid):
            origin, turned = poses[self.frames][self.on, : m.dim], m.matrix(poses[self.frames])[self.on]
            x[self.rigid] = origin + (turned @ self.places[:, :, None])[:, :, 0]
        for trace, (rows, nodes) in self.nodes.items():
            x[rows] = here.nodes(trace)[0][nodes]

        # distances in the axes of the obstacles
        y = x - r if R is None else ((x - r)[:, None] @ R)[:, 0]
        gap, gradient = self._distances(y)
        normal = gradient.copy() if R is None else (R @ gradient[:, :, None])[:, :, 0]
        return Touch(gap - self.radius, x - self.radius[:, None] * normal, normal, y), (r, R, origin, turned)

    def _obstacles(self, m: Motions, t: float, poses: Array) -> tuple[Array, Array | None]:
        """Places (m, d) and rotations (m, d, d; None: no turn) of the obstacles that the candidates may touch."""
        if self._still is not None:
            return self._still
        return self._placed(m, self.carriers.poses(t, poses))

    def _placed(self, m: Motions, obstacles: Array) -> tuple[Array, Array]:
        """The same of known poses of obstacles."""
        return obstacles[self.of, : m.dim], m.matrix(obstacles)[self.of]

    def _distances(self, y: Array) -> tuple[Array, Array]:
        """Distances and gradients at points (m, d) in the axes of their obstacles."""
        if len(self.shapes) == 1:
            return self.shapes[0][1](y)
        gap, gradient = np.empty(self.count), np.empty_like(y)
        for rows, told in self.shapes:
            gap[rows], gradient[rows] = told(y[rows])
        return gap, gradient

    def _ways(self, m: Motions, way: Way, y: Array) -> Array:
        """How far points y (m, d) in the axes of their obstacles move with those that are prescribed, (m, d).

        By the ways of these: by places of their own points would differ by roundoff, and ask contacts that depend on each
        other for what they cannot do.
        """
        out = np.zeros_like(y)
        told = [(weight, self.carriers.told(time)) for time, weight in way]
        for k, (i, _) in enumerate(self.prescribed):
            shift = sum(weight * poses[k][: m.dim] for weight, poses in told)
            turn: Any = sum(weight * m.matrix(poses[k]) for weight, poses in told)
            rows = self.of == i
            out[rows] = shift + y[rows] @ turn.T
        return out

    def gap_ways(self, here: Here, way: Way) -> Array:
        """What prescribed motion alone opens gaps by, (m,); collective."""
        touch = self.touch(here)
        return -(touch.normal * self._ways(here.contacts.m, way, touch.relative)).sum(1)

    def touch(self, here: Here) -> Touch:
        """Gaps of all candidates; collective."""
        return self._place(here)[0]

    def rows(self, here: Here, way: Way | None) -> Rows:
        """All candidates with their rows; collective."""
        contacts = here.contacts
        touch, (r, R, origin, turned) = self._place(here)
        e = directions_of(touch.normal, frictional=contacts.frictional)
        c = e.shape[1]
        core, field = contacts.blank(self.count * c)
        for trace, (rows, nodes) in self.nodes.items():
            entries = in_turn(rows, c), nodes.repeat(c), None
            contacts.add_nodes((core, field), trace, (entries, e.reshape(-1, e.shape[2])), here.nodes(trace))
        pushing: list[tuple[Any, ...]] = []
        if len(self.rigid):
            pushing.append((self.rigid, self.frames[self.on], 1.0, origin, turned))
        if len(on := self.pushed):
            assert R is not None
            pushing.append((on, self.carriers.frame[self.of[on]], -1.0, r[on], R[on]))

        for on, frames, sign, *at in pushing:
            told = (sign * e[on]).reshape(-1, e.shape[2]), *(y.repeat(c, axis=0) for y in (touch.x[on], *at))
            contacts.add_frames(core, in_turn(on, c), frames.repeat(c), told)

        drift = np.zeros((self.count, c - 1))
        if way is not None and c > 1:
            drift = (e[:, 1:] * self._ways(contacts.m, way, touch.relative)[:, None]).sum(2)

        return Rows(
            gap=touch.gap,
            L=LinearRows(core, tuple(field)),
            friction=self.friction,
            restitution=self.restitution,
            normal=touch.normal,
            drift=drift,
            trace=self.multiplier,
        )
