"""Contact without friction: the active set, and proximal points where contacts depend on each other."""

from __future__ import annotations

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array
from .active_set import ContactCounts, Dense, active_set
from .coulomb import ACCEPTED, Coulomb, solved


def solve_normal(W: Array, q: Array, start: np.ndarray, counts: ContactCounts) -> Array:
    """L of (1) of :mod:`.active_set`, from the set ``start`` (m,) bool.

    Where contacts depend on each other gaps may contradict a set, and least squares answer it with any force: what does not
    solve (1) is found by the proximal points of :mod:`.coulomb`, without friction.

    Raises:
        ConvergenceError: no solution found.
    """
    none = np.zeros(len(q))
    problem = Coulomb(W, q[:, None], none, 1.0 / np.maximum(np.diag(W), 1e-300)[:, None])
    worst = counts.residual
    try:
        L = active_set(Dense(W, q), start, counts)
    except ConvergenceError:
        L = none
    x = L[:, None]
    if problem.size(problem.at(x, problem.gap(x)).F, x) <= ACCEPTED:
        return L
    counts.residual = worst
    counts.solves -= 1
    return solved(problem, none[:, None], counts)[:, 0]
