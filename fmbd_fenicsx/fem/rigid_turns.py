"""What the forms of a field make of rigid motions: those of small rotations resist finite ones.

    energy Pi(u):            Pi((R - 1) X) = Pi(0)                                                          (1)
    viscous D u', bilinear:  P(W R X) = P(W X),  P(w) = w . D w                                             (2)

hold for a law of strains and any rotation R, W its generator; also where the world brakes all points alike. A form that
resists translations, as a foundation does, holds the body in the world, and is not asked.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from ..rotations import Array

FREE = 1e-11  # forces under a translation by 1 m, of those under random displacements of that size: roundoff
ANGLE = 0.5  # rad, of R in (1); in (2) it is a quarter turn
SEEN = 1e-3  # of the energy or power of a swelling of that size, above which a rotation is seen
RESISTED = 0.1  # of the energy of a shear of that size: initial stress is less beside small strains


def resists_shifts(field: Any) -> bool:
    """Whether its stiffness resists translations; collective."""
    random = np.random.default_rng(7 + field.comm.rank).standard_normal(field.n * field.dim)
    moved = [random, *(np.tile(e, field.n) for e in np.eye(field.dim))]
    largest, *force = np.max(field.comm.allgather([np.abs(field.stiffness(u)).max(initial=0.0) for u in moved]), axis=0)
    return bool(max(force) > FREE * largest)


def resistance_to_turns(field: Any) -> float:
    """Energy of a small rotation over that of a shear of the same size, the largest over all planes; collective."""
    found = 0.0
    for i, j in combinations(range(field.dim), 2):
        turn, shear = np.zeros((2, field.n, field.dim))
        turn[:, i], turn[:, j] = -field.X[:, j], field.X[:, i]
        shear[:, i], shear[:, j] = field.X[:, j], field.X[:, i]
        taken, slide = field.total(np.array([w.ravel() @ field.stiffness(w.ravel()) for w in (turn, shear)]))
        if slide > 0.0:
            found = max(found, float(taken / slide))
    return found


def energy_sees_turns(field: Any) -> bool:
    """Whether (1) does not hold for an energy of the user's own; collective."""
    if field.strain_energy is not None or resists_shifts(field):
        return False
    rest, swelling = field.energy(np.zeros(field.n * field.dim)), 1.0 - np.cos(ANGLE)
    size = abs(field.energy(-swelling * field.X.ravel()) - rest)
    for i, j in combinations(range(field.dim), 2):
        turned = field.energy((_turned(field.X, i, j, ANGLE) - field.X).ravel())
        if not abs(turned - rest) <= SEEN * size:
            return True
    return False


def damping_sees_turns(field: Any) -> bool:
    """Whether (2) does not hold for a bilinear viscous form; collective."""
    if field.D is None or field.viscous.law is not None:
        return False

    def power(rate: Array) -> float:
        return float(field.total(np.array(rate.ravel() @ field.damping(rate.ravel()))))

    size = power(field.X)
    for i, j in combinations(range(field.dim), 2):
        spin = _turned(field.X, i, j, 0.5 * np.pi)
        spin[:, [k for k in range(field.dim) if k not in (i, j)]] = 0.0
        # a quarter turn later the points go where they were seen from the axis
        later = _turned(spin, i, j, 0.5 * np.pi)
        if abs(power(later) - power(spin)) > SEEN * size:
            return True
    return False


def _turned(x: Array, i: int, j: int, angle: float) -> Array:
    """Vectors x (n, d) turned in the plane of the axes i and j."""
    c, s = np.cos(angle), np.sin(angle)
    found = x.copy()
    found[:, i], found[:, j] = c * x[:, i] - s * x[:, j], s * x[:, i] + c * x[:, j]
    return found
