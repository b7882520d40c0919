"""Rows of a slave against an obstacle: equation (1) of :mod:`.rows`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array
from .rows import ContactSet, Here, LinearRows, Pair, Rows, Touch, tangents_of


class ObstaclePair(Pair):
    """A slave, points or nodes, against an obstacle."""

    @property
    def thickness(self) -> float:
        """Shortest way through the obstacle, m."""
        return float(self.shape.thickness)

    def _place(
        self, contacts: ContactSet, system: Any, at: tuple[float, Array], here: Here
    ) -> tuple[Touch, tuple[Any, ...]]:
        t, q = at
        m, side = contacts.m, self.slave
        pose = contacts.pose(system, self.carrier, t, q)
        r = pose[: m.dim]
        R = m.matrix(pose)

        # points of the slave
        P: Array = np.zeros((0, m.dim))
        origin: Array = np.zeros(m.dim)
        if side.surface is not None:
            x_all, P, Rb = here.nodes(side.trace)
            x = x_all[side.surface.nodes]
        else:
            own = system.poses(q)[side.frames]
            origin = own[:, : m.dim]
            Rb = m.matrix(own)
            x = origin + (Rb @ side.points[:, :, None])[..., 0]
        # distances in the axes of the obstacle
        y = (x - r) @ R
        dist, grad = self.shape.evaluate(y)
        normal = grad @ R.T
        return Touch(dist - side.radius, x - side.radius * normal, normal, y), (r, R, P, origin, Rb)

    def touch(self, contacts: ContactSet, system: Any, at: tuple[float, Array], here: Here) -> Touch:
        """Gaps of this pair; collective."""
        return self._place(contacts, system, at, here)[0]

    def rows(self, contacts: ContactSet, system: Any, at: tuple[float, Array, Any], here: Here) -> Rows:
        """Candidates of this pair; collective."""
        t, q, since = at
        side, d = self.slave, contacts.m.dim
        touch, (r, R, P, origin, Rb) = self._place(contacts, system, (t, q), here)
        count = len(touch.gap)

        def linear(direction: Array) -> LinearRows:
            core, field = contacts.blank(count)
            if side.surface is not None:
                full = np.zeros((contacts.traces[side.trace].n, d))
                full[side.surface.nodes] = direction
                contacts.add_nodes((core, field), side.trace, (contacts.picked(self), full), (P, Rb))
            else:
                contacts.add_frames(core, side.frames, (direction, touch.x, origin, Rb))
            if 0 <= self.carrier.frame < system.n_frames and self.carrier.motion is None:
                contacts.add_frames(core, np.full(count, self.carrier.frame), (-direction, touch.x, r, R))
            return LinearRows(core, tuple(field))

        directions = tangents_of(touch.normal) if contacts.frictional else []
        drift = np.zeros((count, len(directions)))
        if since is not None and self.carrier.motion is not None and directions:
            before = self.carrier.motion(since[0])
            after = self.carrier.motion(since[0] + since[1])
            y = (touch.x - r) @ R
            turned = y @ (contacts.m.matrix(after) - contacts.m.matrix(before)).T
            moved = after[:d] - before[:d] + turned
            drift = np.stack([(e * moved).sum(1) for e in directions], axis=1)
        one = np.ones(count)
        return Rows(
            gap=touch.gap,
            N=linear(touch.normal),
            tangents=tuple(linear(e) for e in directions),
            friction=self.friction * one,
            restitution=self.restitution * one,
            normal=touch.normal,
            drift=drift,
            trace=np.full(count, contacts.carrier_of(side)),
        )
