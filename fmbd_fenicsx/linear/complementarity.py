"""Small dense complementarity problems of contact: primal-dual active sets, and Coulomb friction by
semismooth Newton.

    0 <= L  _|_  g = q + W L >= 0
    (1)
    tau in disk of radius mu L,  tau = projection(tau - c s),  s = q_t + W_t (L, tau)
    (2)

W (the Delassus matrix, m/N) is symmetric and positive semi-definite. c_i = 1 / W_ii makes L and g
comparable, so the choice of
the sets does not depend on units. (1) is solved by the active-set iteration, which is Newton's method on
L - max(0, L - c g) = 0 (Hintermueller, Ito and Kunisch, doi:10.1137/S1052623401383558). When a set returns,
the iteration
cycles; then least-index pivoting takes over, which ends in finitely many steps for positive definite W
(Murty,
doi:10.1016/0024-3795(74)90019-0). (2) is Alart and Curnier's function (doi:10.1016/0045-7825(91)90022-X)
with block
Gauss-Seidel sweeps as the fall-back.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import ConvergenceError
from ..rotations import Array


@dataclass
class ContactCounts:
    """Statistics of a run: active-set iterations, changes of the set between them, cycles broken, worst
    residual of (1), (2).
    """

    iterations: int = 0
    changes: int = 0
    cycles: int = 0
    most: int = 0
    solves: int = 0
    residual: float = 0.0
    history: list[int] = field(default_factory=list, repr=False)


def solve_normal(W: Array, q: Array, start: np.ndarray, counts: ContactCounts) -> Array:
    """L of (1), from the active set ``start`` (m,) bool."""
    return active_set(_Dense(W, q), start, counts)


class _Dense:
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
            self.L[active] = _solve(self.W[np.ix_(active, active)], -self.q[active])
        return self.L, np.where(active, 0.0, self.gap(self.L))

    def sharpen(self) -> bool:
        """A trial is exact: nothing to improve."""
        return False

    def pivot(self) -> Array:
        """L by pivoting, where the iteration cycles."""
        return _least_index(self.W, self.q)

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
    scale = np.abs(L).max(initial=0.0)
    if scale > 0:
        counts.residual = max(counts.residual, float(np.abs(np.minimum(L, c * problem.gap(L))).max() / scale))
    return L


def _solve(A: Array, b: Array) -> Array:
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


def _least_index(W: Array, q: Array) -> Array:
    """Principal pivoting with the least index: one change at a time."""
    m = len(q)
    active = np.zeros(m, dtype=bool)
    tiny = 1e-13 * np.abs(q).max(initial=0.0)
    for _ in range(50 * m + 1000):
        L = np.zeros(m)
        if active.any():
            L[active] = _solve(W[np.ix_(active, active)], -q[active])
        g = q + W @ L
        wrong = np.flatnonzero(np.where(active, np.diag(W) * L < -tiny, g < -tiny))
        if wrong.size == 0:
            return L
        active[wrong[0]] = ~active[wrong[0]]
    raise ConvergenceError(
        "The contact problem has no solution that pivoting can find: contacts contradict each other."
    )


def solve_friction(W: Array, q: Array, mu: Array, start: Array, counts: ContactCounts) -> Array:
    """Forces (m, d): normal, then tangential, of (1) and (2). W (m d, m d) and q (m, d) in blocks of
    components by point.

    Raises:
        ConvergenceError: no solution found; with large friction none may exist (Painleve) and an impact law
        is needed.
    """
    m, d = q.shape
    c = np.stack([1.0 / np.maximum(np.diag(W)[k::d], 1e-300) for k in range(d)], axis=1)
    c[:, 1:] = c[:, 1:].min(axis=1)[:, None]
    x, scale = start.copy(), 1e-300
    for attempt in range(4):
        best = np.inf
        for k in range(1, 60):
            u = q + (W @ x.ravel()).reshape(m, d)
            F, dx, du = _alart_curnier(x, u, c, mu)
            size = float(np.abs(F).max(initial=0.0))
            scale = float(np.abs(x).max(initial=0.0)) + float(np.abs(c * q).max(initial=0.0))
            if size <= 1e-12 * scale:
                counts.most, counts.solves = max(counts.most, k), counts.solves + 1
                counts.residual = max(counts.residual, size / scale if scale > 0 else 0.0)
                return x
            if k > 20 and size > 0.5 * best:
                break  # cycles between sets
            best = min(best, size)
            counts.iterations += 1
            J = _blocks(dx) + _blocks(du) @ W
            step = _solve(J, -F.ravel()).reshape(m, d)
            x = x + step
        counts.cycles += 1
        x = _gauss_seidel(W, q, mu, np.zeros_like(x) if attempt == 1 else x, c, 100 * 5**attempt)
    u = q + (W @ x.ravel()).reshape(m, d)
    size = float(np.abs(_alart_curnier(x, u, c, mu)[0]).max())
    if size > 1e-6 * scale:  # sweeps converge slowly where contacts depend on each other; the residual is reported
        raise ConvergenceError(
            f"The friction problem did not converge (residual {size / scale:.1e} of the largest "
            "force). With large friction coefficients "
            "no solution with finite forces may exist (Painleve); use the Moreau scheme, which has "
            "impacts, or a smaller dt."
        )
    counts.residual = max(counts.residual, size / scale)
    return x


def _alart_curnier(x: Array, u: Array, c: Array, mu: Array) -> tuple[Array, Array, Array]:
    """F(x, u) of (1), (2) and its derivatives (m, d, d) with respect to x and u."""
    m, d = x.shape
    F, dx, du = np.zeros((m, d)), np.zeros((m, d, d)), np.zeros((m, d, d))
    trial = x[:, 0] - c[:, 0] * u[:, 0]
    on = trial > 0
    F[:, 0] = np.where(on, c[:, 0] * u[:, 0], x[:, 0])
    dx[:, 0, 0] = np.where(on, 0.0, 1.0)
    du[:, 0, 0] = np.where(on, c[:, 0], 0.0)
    ct = c[:, 1]
    y = x[:, 1:] - ct[:, None] * u[:, 1:]
    radius = mu * np.maximum(x[:, 0], 0.0)
    size = np.linalg.norm(y, axis=1)
    stick = on & (size <= radius)
    slip = on & ~stick
    t = range(1, d)
    F[:, 1:] = np.where(stick[:, None], ct[:, None] * u[:, 1:], x[:, 1:])
    dx[:, t, t] = np.where(stick, 0.0, 1.0)[:, None]
    du[:, t, t] = np.where(stick, ct, 0.0)[:, None]
    if slip.any():
        s = np.flatnonzero(slip)
        e = y[s] / size[s, None]
        F[s, 1:] = x[s, 1:] - radius[s, None] * e
        dx[s, 1:, 0] = -(mu[s] * (x[s, 0] > 0))[:, None] * e
        if d == 3:
            P = (radius[s] / size[s])[:, None, None] * (np.eye(2) - e[:, :, None] * e[:, None, :])
            dx[s, 1:, 1:] -= P
            du[s, 1:, 1:] += ct[s, None, None] * P
    return F, dx, du


def _blocks(B: Array) -> Array:
    """Block-diagonal matrix of (m, d, d)."""
    m, d, _ = B.shape
    out = np.zeros((m, d, m, d))
    out[range(m), :, range(m)] = B
    return out.reshape(m * d, m * d)


def _gauss_seidel(W: Array, q: Array, mu: Array, x: Array, c: Array, sweeps: int) -> Array:
    """Sweeps over the points; each is projected on its cone."""
    m, d = q.shape
    x = x.copy()
    for _ in range(sweeps):
        before = x.copy()
        for i in range(m):
            rows = slice(i * d, (i + 1) * d)
            u = q[i] + W[rows] @ x.ravel()
            x[i, 0] = max(0.0, x[i, 0] - c[i, 0] * u[0])
            u = q[i] + W[rows] @ x.ravel()
            y = x[i, 1:] - c[i, 1] * u[1:]
            size = float(np.linalg.norm(y))
            radius = mu[i] * x[i, 0]
            x[i, 1:] = y if size <= radius else radius / size * y
        if np.abs(x - before).max() <= 1e-12 * max(np.abs(x).max(), 1e-300):
            break
    return x
