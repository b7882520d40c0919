"""Small dense complementarity problems of contact without friction: primal-dual active sets.

    0 <= L  _|_  g = q + W L >= 0                                                                           (1)

W (the Delassus matrix, m/N) is symmetric and positive semi-definite. c_i = 1 / W_ii makes L and g comparable, so the
choice of the sets does not depend on units. (1) is solved by the active-set iteration, which is Newton's method on
L - max(0, L - c g) = 0 (Hintermueller, Ito and Kunisch, doi:10.1137/S1052623401383558). When a set returns, the
iteration cycles; then least-index pivoting takes over, which ends in finitely many steps for positive definite W
(Murty, doi:10.1016/0024-3795(74)90019-0); a W that is not is made so by a small shift, whose effect is iterated away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array

SHIFT = 1e-8  # of the diagonal of W, before pivoting


@dataclass
class ContactCounts:
    """Statistics of a run: active-set iterations, changes of the set between them, cycles broken, worst
    residual; products of the compliance that compiled code has made.
    """

    iterations: int = 0
    changes: int = 0
    cycles: int = 0
    most: int = 0
    solves: int = 0
    residual: float = 0.0
    products: int = 0


class Dense:
    """(1) with the matrix W stored."""

    noise = 1e-14

    def __init__(self, W: Array, q: Array) -> None:
        self.W, self.q, self.m = W, q, len(q)
        self.c = 1.0 / np.maximum(np.diag(W), 1e-300)
        self.L: Array = np.zeros(self.m)

    @property
    def size(self) -> float:
        """Scale of the forces."""
        return float(np.abs(self.L).max(initial=0.0) + np.abs(self.c * self.q).max(initial=0.0))

    def trial(self, active: np.ndarray) -> tuple[Array, Array]:
        """Forces that close the gaps of ``active``, and all gaps."""
        self.L = np.zeros(self.m)
        if active.any():
            self.L[active] = solve_least(self.W[np.ix_(active, active)], -self.q[active])
        return self.L, np.where(active, 0.0, self.gap(self.L))

    def sharpen(self) -> bool:
        """A trial is exact: nothing to improve."""
        return False

    def pivot(self) -> Array:
        """L by pivoting, where the iteration cycles."""
        return _regular(self.W, self.q)

    def gap(self, L: Array) -> Array:
        """Gaps under forces L."""
        return np.asarray(self.q + self.W @ L)


def active_set(problem: Any, start: np.ndarray, counts: ContactCounts) -> Array:
    """L of (1) by the primal-dual active set, from ``start`` (m,) bool.

    ``problem`` gives ``trial(active)``, forces that close these gaps, and says by ``sharpen`` whether they were rough: the set
    is first found with rough forces, where that is cheaper.
    """
    active, c = start.copy(), problem.c
    seen: set[bytes] = set()
    L: Array = np.zeros(problem.m)
    for k in range(1, 2 * problem.m + 20):
        counts.most = max(counts.most, k)
        L, g = problem.trial(active)
        fresh = L - c * g > 0
        # a point that just touches without force stays as it is: roundoff must not toggle it
        fresh = np.where(np.abs(L - c * g) <= problem.noise * problem.size, active, fresh)

        changed = int((fresh != active).sum())
        counts.iterations += 1
        if changed == 0:
            if problem.sharpen():
                continue
            break
        counts.changes += changed

        # a set that was there before comes again and again
        key = fresh.tobytes()
        if key in seen and problem.sharpen():
            seen.clear()
        elif key in seen:
            counts.cycles += 1
            L = problem.pivot()
            break
        seen.add(key)
        active = fresh

    counts.solves += 1
    L = np.maximum(L, 0.0)
    if L.any():  # beside gaps that stay open, forces may be roundoff
        missed = float(np.abs(np.minimum(L, c * problem.gap(L))).max())
        counts.residual = max(counts.residual, missed / problem.size)
    return L


def solve_least(A: Array, b: Array) -> Array:
    """A^-1 b; the least solution where contacts depend on each other."""
    try:
        x = np.linalg.solve(A, b)
        if np.isfinite(x).all() and np.abs(A @ x - b).max(initial=0.0) <= 1e-8 * max(
            np.abs(b).max(initial=0.0), 1e-300
        ):
            return x
    except np.linalg.LinAlgError:
        pass
    return np.asarray(np.linalg.lstsq(A, b, rcond=1e-12)[0])


def _regular(W: Array, q: Array) -> Array:
    """Least-index pivoting on W + D, and on q - D L with the L found."""
    D = SHIFT * np.diag(W)
    L: Array = np.zeros(len(q))
    for _ in range(5):
        L = _least_index(W + np.diag(D), q - D * L)
    return L


def _least_index(W: Array, q: Array) -> Array:
    """Principal pivoting with the least index: one change at a time."""
    m = len(q)
    active = np.zeros(m, dtype=bool)
    tiny = 1e-13 * np.abs(q).max(initial=0.0)

    # the first wrong point changes sides: never a cycle
    for _ in range(50 * m + 1000):
        L = np.zeros(m)
        if active.any():
            L[active] = solve_least(W[np.ix_(active, active)], -q[active])
        g = q + W @ L
        wrong = np.flatnonzero(np.where(active, np.diag(W) * L < -tiny, g < -tiny))
        if wrong.size == 0:
            return L
        active[wrong[0]] = ~active[wrong[0]]

    raise ConvergenceError(
        "The contact problem has no solution that pivoting can find: contacts contradict each other."
    )
