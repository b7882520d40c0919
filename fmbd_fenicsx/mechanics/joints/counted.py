"""Counted angles: the angle between two markers beyond a turn, a function of the configuration and of nothing else.

A rotation matrix tells an angle up to whole turns. What it leaves out is part of the configuration:

plane    the angle phi of a body, or of a section of a line, is a coordinate and goes beyond a turn, so the counted angle
         of two markers is phi_b - phi_a, less its value at the start
space    one number theta for each joint whose angle someone asks for stands in q beside the poses

An increment xi of the configuration, rotations xi_a and xi_b of the two bodies in their own axes, turns the joint by

    theta -> the angle nearest to  theta + e . xi_b - e . xi_a  among those that the new attitude allows             (1)

with e the axis of the joint in each body. The first part may be any number of turns, the second takes away its error, so that
theta is always the angle of the attitude itself. The small rotation of an elastic surface in its frame is not counted: it
stays below half a turn, and the angle of the attitude nearest to theta includes it. Surfaces of bodies without a frame turn
as a whole; for these theta is counted in the plane too, and one increment may turn them by less than half a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...rotations import Array
from ..frames import Markers
from .relative import RelativeAngle, dot, nearest


@dataclass(frozen=True)
class CountedAngles:
    """Which angles a configuration counts. ``turn``: those that have a number theta each, in this order.

    ``start``: angle phi of each marker at the start, (n,), zero in space. ``free``: which of the angles are those of a surface
    without a frame, (m,) bool.
    """

    markers: Markers
    turn: RelativeAngle
    start: Array
    free: np.ndarray

    @property
    def count(self) -> int:
        """Numbers theta in a configuration."""
        return len(self.turn.a)

    def turned(self, pose: Array, port: Array, theta: Array) -> Array:
        """An angle (rad) of each marker, (n,): the difference of the two markers of a joint is the angle that it has turned.

        ``pose``: of all frames, (n_frames + 1, n_pose); ``port``: of all surfaces; ``theta``: as they stand in q.
        """
        m = self.markers
        out = -self.start
        if m.motions.dim == 2:
            out = out + m.angles(pose, port)
        out[self.turn.a] = 0.0
        out[self.turn.b] = theta
        return out

    # -- increments of the configuration ------------------------------------------------------------------------
    @cached_property
    def _axes(self) -> tuple[Array, Array]:
        """The axis of each joint in the axes of the two frames, (m, 3) each."""
        R = self.markers.rotation
        e = self.turn.e[..., None]
        return (R[self.turn.a] @ e)[..., 0], (R[self.turn.b] @ e)[..., 0]

    def ahead(self, xi: Array) -> Array:
        """e . xi_b - e . xi_a of (1) for the increments of all frames, (..., n_frames + 1, n_twist)."""
        m = self.markers
        if m.motions.dim == 2:
            phi = xi[..., 2]
            return np.asarray(phi[..., m.frame[self.turn.b]] - phi[..., m.frame[self.turn.a]])
        (ea, eb), rotation = self._axes, xi[..., 3:]
        return dot(eb, rotation[..., m.frame[self.turn.b], :]) - dot(ea, rotation[..., m.frame[self.turn.a], :])

    def followed(self, theta: Array, rotation: Array, surfaces: Array | None) -> Array:
        """theta of (1) from its estimate and the new rotation matrices of all frames, (..., n_frames + 1, d, d).

        ``surfaces``: rotations of all markers, None where no angle is that of a surface without a frame or its ports are unknown.
        """
        undeformed = rotation[..., self.markers.frame, :, :] @ self.markers.rotation
        attitude = self.turn.attitude(undeformed)
        if self.free.any():
            attitude = np.where(self.free, theta if surfaces is None else self.turn.attitude(surfaces), attitude)
        return nearest(attitude, theta)


def turning_freely(markers: Markers, ground: int) -> np.ndarray:
    """Which markers sit on surfaces that turn as a whole and have no angle among their ports, (n,) bool.

    ``ground``: number of the frame that such surfaces have.
    """
    out = np.zeros(len(markers.frame), dtype=bool)
    on = markers.surface if markers.section is None else markers.surface[~markers.section]
    out[on] = markers.frame[on] == ground
    return out
