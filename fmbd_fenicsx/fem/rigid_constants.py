"""A field as a rigid body: its mass, centre and inertia, and the columns of inertia of its nodes.

Q = [M 1_k, M (e_k x X)],        J = sum X x Q                                                                   (1)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..rotations import Array, Motions

Product = Callable[[Array], Array]


@dataclass(frozen=True)
class RigidConstants:
    """``mass`` (kg), ``center`` (d,) and ``inertia`` about it, (n_rot, n_rot); ``X`` (n, d): owned nodes about the centre, ``Q``
    (n d, n_twist); ``size`` (m): of the box around all nodes.
    """

    mass: float
    center: Array
    X: Array
    Q: Array
    inertia: Array
    size: float

    @classmethod
    def of(cls, x: Array, times_mass: Product, total: Product, m: Motions, comm: Any) -> RigidConstants:
        """Those of nodes at the places x (n, d), by products with M and sums over the ranks; collective."""
        n, d = x.shape
        one = times_mass(np.ones((n, d)))
        mass = float(total(np.array(one[:, 0].sum())))
        center = total((one * x).sum(0)) / mass
        X = x - center

        Q = np.zeros((n, d, m.n_twist))
        for k in range(d):
            Q[:, k, k] = one[:, 0]
        for k in range(m.n_rot):
            w = np.zeros((1, m.n_rot))
            w[0, k] = 1.0
            Q[:, :, d + k] = times_mass(m.spin(w, X))

        J = np.empty((m.n_rot, m.n_rot))
        for k in range(m.n_rot):
            J[:, k] = m.moment(X, Q[:, :, d + k]).sum(0)
        return cls(mass, center, X, Q.reshape(n * d, m.n_twist), total(J), _size(x, comm))


def _size(x: Array, comm: Any) -> float:
    """The diagonal of the box around all nodes; collective."""
    n, d = x.shape
    low = comm.allgather(x.min(0) if n else np.full(d, np.inf))
    high = comm.allgather(x.max(0) if n else np.full(d, -np.inf))
    return float(np.linalg.norm(np.max(high, axis=0) - np.min(low, axis=0)))
