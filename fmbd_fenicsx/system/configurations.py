"""Geometry of the configurations of a system: increments, local coordinates, counted angles.

A configuration q holds the poses of all frames, then the counted angles, then the coordinates of the parts. An increment xi is
an array like v. q o exp(xi) turns each frame by the rotation vector in its own axes, carries the counted angles along (by any
number of turns, :mod:`..mechanics.joints.counted`) and adds what belongs to the parts. Leading axes of the
arrays are many configurations.
"""

from __future__ import annotations

import numpy as np

from ..rotations import Array
from .layout import Layout


def flat(system: Layout) -> bool:
    """Whether configurations are added like vectors: in the plane, without counted angles."""
    return system.counted_angles.stop == system.n_frames * system.motions.n_twist


def _together(*arrays: Array) -> tuple[Array, ...]:
    """Arrays with the same leading axes."""
    leads = [x.shape[:-1] for x in arrays]
    lead = np.broadcast_shapes(*leads)
    return tuple(np.broadcast_to(x, (*lead, x.shape[-1])) for x in arrays)


def _poses(system: Layout, q: Array) -> Array:
    """Poses of all frames, the ground left out, (..., n_frames, n_pose)."""
    return q[..., : system.counted_angles.start].reshape(*q.shape[:-1], system.n_frames, system.motions.n_pose)


def _twists(system: Layout, v: Array) -> Array:
    """Twists of all frames, the ground left out, (..., n_frames, n_twist)."""
    k = system.n_frames * system.motions.n_twist
    return v[..., :k].reshape(*v.shape[:-1], system.n_frames, system.motions.n_twist)


def composed(system: Layout, q: Array, xi: Array) -> Array:
    """q o exp(xi).

    Collective where surfaces without a frame count their angles; a configuration of the core alone leaves these to :func:`count`.
    """
    q, xi = _together(q, xi)
    at = system.counted_angles
    lead = q.shape[:-1]
    k = system.n_frames * system.motions.n_twist
    frames = system.motions.compose(_poses(system, q), _twists(system, xi))
    out = np.concatenate((frames.reshape(*lead, at.start), q[..., at], q[..., at.stop :] + xi[..., k:]), axis=-1)

    if at.stop > at.start:
        count(system, out, xi)
    return out


def increment_between(system: Layout, q0: Array, q1: Array, near: Array | None = None) -> Array:
    """The increment xi with q0 o exp(xi) = q1: of all rotations the smallest, or the one nearest to that of ``near``."""
    q0, q1 = _together(q0, q1)
    at = system.counted_angles
    k = system.n_frames * system.motions.n_twist
    guess = None if near is None else _twists(system, near)

    frames = system.motions.difference(_poses(system, q0), _poses(system, q1), guess)
    return np.concatenate((frames.reshape(*q0.shape[:-1], k), q1[..., at.stop :] - q0[..., at.stop :]), axis=-1)


def rate_of_increment(system: Layout, xi: Array, v: Array) -> Array:
    """d(xi)/dt of the local coordinates q o exp(xi) for the velocity v."""
    xi, v = _together(xi, v)
    m = system.motions
    k = system.n_frames * m.n_twist
    frames = m.rate(_twists(system, xi), _twists(system, v))
    return np.concatenate((frames.reshape(*v.shape[:-1], k), v[..., k:]), axis=-1)


# -- counted angles ---------------------------------------------------------------------------------------------------
def count(system: Layout, q: Array, xi: Array | None = None) -> None:
    """Put the counted angles in q where the increment xi leads them, then to the nearest values that the attitude allows.

    ``q``: the new configuration with the old angles, changed in place. Without an increment only the second is done. Collective
    as :func:`composed` is.
    """
    if system.counted is None or not system.counted.count:
        return

    at = system.counted_angles

    if xi is not None:
        twists = _twists(system, xi)
        ground = np.zeros((*twists.shape[:-2], 1, twists.shape[-1]))
        q[..., at] += system.counted.ahead(np.concatenate((twists, ground), axis=-2))

    # surfaces without a frame are known where the coordinates of their bodies are part of q
    surfaces = None
    if system.counted.free.any() and q.shape[-1] == system.n_q:
        each = [_marker_rotations(system, x) for x in q.reshape(-1, system.n_q)]
        surfaces = np.reshape(each, (*q.shape[:-1], *each[0].shape))

    ground = np.broadcast_to(system.ground, (*q.shape[:-1], *system.ground.shape))
    rotation = system.motions.matrix(np.concatenate((_poses(system, q), ground), axis=-2))
    q[..., at] = system.counted.followed(q[..., at], rotation, surfaces)


def _marker_rotations(system: Layout, q: Array) -> Array:
    """Rotations of all markers, (n, d, d); collective."""
    pose = system.poses(q)
    port = system.ports(q, 0.0)  # markers sit on surfaces, whose ports do not move with time
    return system.markers.rotations(system.motions.matrix(pose), port)
