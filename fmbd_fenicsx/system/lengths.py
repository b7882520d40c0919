"""Weights that turn everything into lengths: they make norms and guards independent of the system of units."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..rotations import Array

if TYPE_CHECKING:
    from .system import System


def of_increments(system: System) -> Array:
    """For arrays like v, (n_v,): rotations times the model's length, amplitudes of modes times what they displace."""
    m, n = system.motions, system.n_frames
    out = np.ones(system.n_v)
    out[: n * m.n_twist].reshape(n, m.n_twist)[:, m.dim :] = system.length
    for part, own in zip(system.parts, system.slices[1], strict=True):
        out[own] = part.lengths(system.length)
    return out


def of_rows(system: System) -> Array:
    """For values of constraints, (n_lam,): angles times the model's length.

    Frame conditions are moments of a body's mass: what they are per displacement or turn makes them lengths. Rows of a user's
    own count as they are.
    """
    return _of_rows(system, system.length)


def of_multipliers(system: System) -> Array:
    """What multipliers are divided by to be compared as forces, (n_lam,).

    A moment M counts as the pair of forces M / L, with the model's length L between them, that could stand for it: of norm
    sqrt(2) M / L.
    """
    return _of_rows(system, system.length / np.sqrt(2.0))


def _of_rows(system: System, turn: float) -> Array:
    """For rows, (n_lam,): a radian as the length ``turn``."""
    out = np.ones(system.n_lam)
    for batch, rows in system.batches:
        out[rows] = batch.lengths(turn)

    for part, own in zip(system.parts, system.frame_rows, strict=True):
        out[own] = part.frame_lengths(turn)
    return out


def farthest(system: System, q: Array) -> float:
    """Largest coordinate of a frame in q, its angles as lengths, and of what is counted: places are known to eps times it, m."""
    m, at = system.motions, system.counted_angles
    frames = np.abs(q[: at.start].reshape(-1, m.n_pose))
    most = np.maximum.reduce
    place = float(most(frames[:, : m.dim], axis=None, initial=0.0))
    angle = float(most(frames[:, 2], initial=0.0)) if m.dim == 2 else 1.0
    counted = float(most(np.abs(q[at]), initial=0.0))
    return place + system.length * (angle + counted)
