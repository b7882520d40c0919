"""Linearisation of a system about a state, by differences in the directions of its local coordinates.

For a function f(q, v) of the configuration and the velocity, with q o exp(xi) the local coordinates about q,

    df/dxi (q, v)   and   df/dv (q, v),                                                                     (1)

one column for each replicated coordinate. Central differences by xi: a spring of stiffness k on a length l has a second
derivative k / l, and an error of k / l times the step across the spring would swamp the tangent of the motion that is left.
Forward differences by v, where the equations are quadratic at most. Small systems only: the result is dense. The 3 n + 1
evaluations are made together (:mod:`..evaluation_batch`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...rotations import Array
from ..evaluation_batch import EvaluationBatch
from ..system import System

LARGEST = 2_000_000  # entries of matrices that are evaluated at once
_STEP = float(np.sqrt(np.finfo(float).eps))
_CENTRAL = float(np.cbrt(np.finfo(float).eps))


@dataclass(frozen=True)
class Sizes:
    """Typical sizes of the replicated coordinates and velocities: what a difference step is measured by."""

    system: System

    @cached_property
    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the frames' translations and rotations in v, (n_frames d,) and (n_frames n_rot,)."""
        m, n = self.system.motions, self.system.n_frames
        numbers = np.arange(n * m.n_twist).reshape(n, m.n_twist)
        return numbers[:, : m.dim].ravel(), numbers[:, m.dim :].ravel()

    @cached_property
    def _ones(self) -> Array:
        return np.ones(self.system.n_core)

    def positions(self, q: Array) -> Array:
        """Size of each replicated coordinate, (n_core,): the model's length, one radian, or a coordinate's own size, which is a
        thousandth of the largest of its body at least, and what moves it by a millionth of the model's length.
        """
        s = self.system
        out = self._ones.copy()
        out[self.blocks[0]] = s.length
        for k, _ in s.core_parts:
            unit = s.units[s.slices[1][k]]
            own = unit * np.abs(s.local_q(q, k))
            least = 1e-3 * max(float(own.max(initial=0.0)), 1e-3 * s.length)
            out[s.slices[1][k]] = np.maximum(own, least) / np.where(unit > 0.0, unit, 1.0)
        return out

    def velocities(self, v: Array, a: Array) -> Array:
        """Size of each replicated velocity, (n_core,): the largest of its kind, or what accelerations like ``a`` lead to on a
        hundredth of the model's length.
        """
        s = self.system
        fastest = float(np.abs(s.units[: s.n_core] * a[: s.n_core]).max(initial=0.0))
        least = 0.1 * np.sqrt(fastest * s.length) or 1e-2  # m/s
        out = self._ones.copy()
        for block, arm in zip(self.blocks, (1.0, s.length), strict=True):
            out[block] = max(float(np.abs(v[block]).max(initial=0.0)), least / arm)
        for k, _ in s.core_parts:
            unit = s.units[s.slices[1][k]]
            own = unit * np.abs(s.local_v(v, k))
            least_of_all = 1e-2 * max(float(own.max(initial=0.0)), least)
            out[s.slices[1][k]] = np.maximum(own, least_of_all) / np.where(unit > 0.0, unit, 1.0)
        return out


def differences(
    system: System, function: Callable[[Array, Array], Array], at: tuple[Array, Array, Array]
) -> tuple[Array, Array]:
    """(1) for ``function(q, v)``, (k, n_q), (k, n_v) -> (k, m), of many configurations at once: two arrays (m, n_core).

    ``at``: q, v, and accelerations that tell which velocities matter.
    """
    q, v, a = at
    n, count = system.n_v, system.n_core
    every = np.arange(count)
    hq, hv = difference_steps(Sizes(system), q, v, a)
    step = np.zeros((count, n))
    step[every, every] = hq
    moved = np.repeat(v[None], count, axis=0)
    moved[every, every] += hv
    hv = moved[every, every] - v[:count]

    qs = np.concatenate((system.compose(q, step), system.compose(q, -step), np.repeat(q[None], count + 1, axis=0)))
    f = function(qs, np.concatenate((np.repeat(v[None], 2 * count, axis=0), moved, v[None])))
    in_q, in_v = f[:count] - f[count : 2 * count], f[2 * count : 3 * count] - f[-1]
    return (in_q / (2 * hq)[:, None]).T, (in_v / hv[:, None]).T


def difference_steps(sizes: Sizes, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """By how much coordinates and velocities are moved, (n_core,) each."""
    return _CENTRAL * sizes.positions(q), _STEP * sizes.velocities(v, a)


def at_once(system: System, t: float, function: Callable[[EvaluationBatch], Array]) -> Callable[[Array, Array], Array]:
    """``function`` of configurations at time t as a function of (q, v): (k, n_q), (k, n_v) -> (k, m).

    As many at a time (:mod:`..evaluation_batch`) as fit in some ten megabytes.
    """
    largest = max(1, LARGEST // max(1, system.n_v * (system.n_lam + system.n_v)))

    def made(q: Array, v: Array) -> Array:
        parts = [slice(i, min(i + largest, len(q))) for i in range(0, len(q), largest)]
        return np.concatenate([function(system.batch(t, q[p], v[p])) for p in parts])

    return made
