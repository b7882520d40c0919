"""Linearisation of a system about a state, by differences in the directions of its local coordinates.

For a function f(q, v) of the configuration and the velocity, with q o exp(xi) the local coordinates about q,

    df/dxi (q, v)   and   df/dv (q, v),                                                                     (1)

one column for each replicated coordinate. Central differences by xi: a spring of stiffness k on a length l has a second
derivative k / l, and an error of k / l times the step across the spring would swamp the tangent of the motion that is left.
Forward differences by v, where the equations are quadratic at most. Small systems only: the result is dense and costs 3 n
evaluations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..rotations import Array
from .system import Evaluation, System

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

    def positions(self, q: Array) -> Array:
        """Size of each replicated coordinate, (n_core,): the model's length, one radian, or a coordinate's own size."""
        s = self.system
        out = np.ones(s.n_core)
        out[self.blocks[0]] = s.length
        for k, _ in s.core_parts:
            own = np.abs(s.local_q(q, k))
            out[s.slices[1][k]] = np.maximum(own, 1e-3 * max(float(own.max(initial=0.0)), 1e-3))
        return out

    def velocities(self, v: Array) -> Array:
        """Size of each replicated velocity, (n_core,): the largest of its kind, or a hundredth of its coordinate's size."""
        s = self.system
        out = np.ones(s.n_core)
        for block in self.blocks:
            out[block] = max(float(np.abs(v[block]).max(initial=0.0)), 1e-2)
        for k, _ in s.core_parts:
            own = np.abs(s.local_v(v, k))
            out[s.slices[1][k]] = np.maximum(own, 1e-2 * max(float(own.max(initial=0.0)), 1e-2))
        return out


def differences(system: System, function: Callable[[Array, Array], Array], q: Array, v: Array) -> tuple[Array, Array]:
    """(1) for ``function(q, v)`` -> (m,): two arrays (m, n_core); collective when the function is."""
    sizes, n = Sizes(system), system.n_core
    base = function(q, v)
    in_q, in_v = np.empty((len(base), n)), np.empty((len(base), n))
    step = np.zeros(system.n_v)
    for j, (hq, hv) in enumerate(zip(_CENTRAL * sizes.positions(q), _STEP * sizes.velocities(v), strict=True)):
        step[j] = hq
        in_q[:, j] = (function(system.compose(q, step), v) - function(system.compose(q, -step), v)) / (2 * hq)
        step[j] = 0.0
        moved = v.copy()
        moved[j] += hv
        in_v[:, j] = (function(q, moved) - base) / (moved[j] - v[j])
    return in_q, in_v


def core_tangent(ev: Evaluation, a: Array, lam: Array) -> tuple[Array, Array]:
    """Stiffness and damping of the core: derivatives of M a + h + G^T lambda by local coordinates and velocities,
    (n_core, n_core).

    They contain springs and dampers, gyroscopic and centrifugal terms, and the geometric stiffness of the multipliers.
    """
    s = ev.system
    assert ev.v is not None
    return differences(s, lambda q, v: s.at(ev.t, q, v).balance(a, lam)[: s.n_core], ev.q, ev.v)
