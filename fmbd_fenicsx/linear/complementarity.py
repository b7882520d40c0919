"""Small dense complementarity problems of contact: active sets, and Coulomb friction by semismooth Newton.

    0 <= L  _|_  g = q + W L >= 0                                                                           (1)
    tau in disk of radius mu L,  tau = projection(tau - c s),  s = q_t + W_t (L, tau)                       (2)
    x_k+1 solves (1), (2) with W + rho D and q - rho D x_k,  D = diag W                                     (3)

W (the Delassus matrix, m/N) is symmetric and positive semi-definite. c_i = 1 / W_ii makes L and g comparable, so the
choice of the sets does not depend on units. (1) is solved by the active-set iteration, which is Newton's method on
L - max(0, L - c g) = 0 (Hintermueller, Ito and Kunisch, doi:10.1137/S1052623401383558). When a set returns, the
iteration cycles; then least-index pivoting takes over, which ends in finitely many steps for positive definite W
(Murty, doi:10.1016/0024-3795(74)90019-0). (2) is Alart and Curnier's function (doi:10.1016/0045-7825(91)90022-X).
Contacts that depend on each other (a plate on four corners) make W singular; the proximal points (3) choose one of the
force distributions, near the start, and converge in a few steps since rho is small (Rockafellar,
doi:10.1137/0314056).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import ConvergenceError
from ..rotations import Array

PROXIMAL = (0.0, 1e-8, 1e-6, 1e-4)  # rho of (3), tried in turn


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

    Newton's method from ``start``; where it fails, because contacts depend on each other, proximal points (3); where
    friction and normal forces are strongly coupled, the same from the forces of pivoting.

    Raises:
        ConvergenceError: no solution found; with large friction none may exist (Painleve) and an impact law
        is needed.
    """
    m, d = q.shape
    c = np.stack([1.0 / np.maximum(np.diag(W)[k::d], 1e-300) for k in range(d)], axis=1)
    c[:, 1:] = c[:, 1:].min(axis=1)[:, None]
    problem = _Coulomb(W, q, mu, c)
    best = np.inf
    for first in (lambda: start, lambda: _pivoted(problem, 16), lambda: _pivoted(problem, 64)):
        x0 = first()
        for rho in PROXIMAL:
            x, size, iterations = _proximal_points(problem, x0, rho)
            counts.iterations += iterations
            if size <= 1e-12:
                counts.most, counts.solves = max(counts.most, iterations), counts.solves + 1
                counts.residual = max(counts.residual, size)
                return x
            best = min(best, size)
            counts.cycles += 1
    raise ConvergenceError(
        f"The friction problem did not converge (residual {best:.1e} of the largest force). With large friction "
        "coefficients no solution with finite forces may exist (Painleve); use the Moreau scheme, which has impacts, "
        "or a smaller dt."
    )


def _pivoted(problem: _Coulomb, facets: int) -> Array:
    """Forces (m, d) by Lemke's pivoting with the cone of (2) as a pyramid (in the plane: as it is).

    Stewart and Trinkle, doi:10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I. It finds a solution
    wherever impulses can exist (Anitescu and Potra, doi:10.1023/A:1008292328909).
    """
    m, d = problem.q.shape
    k = 2 if d == 2 else facets
    angle = 2 * np.pi * np.arange(k) / k
    e = np.stack((np.cos(angle), np.sin(angle)), axis=1)[:, : d - 1]
    T = np.zeros((m, d, m, 1 + k))  # forces from normal and facet components
    T[range(m), 0, range(m), 0] = 1.0
    T[range(m), 1:, range(m), 1:] = e.T
    T = T.reshape(m * d, m * (1 + k))
    scale = 1.0 / np.repeat(problem.c.min(axis=1), 1 + k).max()
    n = m * (1 + k)
    M, rhs = np.zeros((n + m, n + m)), np.zeros(n + m)
    M[:n, :n] = T.T @ problem.W @ T / scale
    rhs[:n] = T.T @ problem.q.ravel() / scale
    for i in range(m):
        facet = slice(i * (1 + k) + 1, (i + 1) * (1 + k))
        M[facet, n + i], M[n + i, facet], M[n + i, i * (1 + k)] = 1.0, -1.0, problem.mu[i]
    return (T @ _lemke(M, rhs)[:n]).reshape(m, d)


def _lemke(M: Array, q: Array) -> Array:
    """z >= 0 with w = M z + q >= 0 and w . z = 0, by complementary pivoting with the lexicographic rule; zeros on a ray.

    Lemke (1965), doi:10.1287/mnsc.11.7.681.
    """
    n = len(q)
    if q.min(initial=0.0) >= 0:
        return np.zeros(n)
    # columns: w (n), z (n), artificial, right-hand side; rows w - M z - z0 = q
    A = np.concatenate((np.eye(n), -M, -np.ones((n, 1)), q[:, None]), axis=1)
    basis = np.arange(n)
    enter, row = 2 * n, int(np.argmin(q))
    for _ in range(50 * n):
        A[row] /= A[row, enter]
        others = np.arange(n) != row
        A[others] -= np.outer(A[others, enter], A[row])
        leave, basis[row] = basis[row], enter
        if leave == 2 * n:
            z = np.zeros(2 * n)
            z[basis] = A[:, -1]
            return np.maximum(z[n:], 0.0)
        enter = leave + n if leave < n else leave - n
        column = A[:, enter]
        rows = np.flatnonzero(column > 1e-11 * np.abs(column).max(initial=1e-300))
        if rows.size == 0:
            break
        row = _lexicographic(A, enter, rows, basis)
    return np.zeros(n)


def _lexicographic(A: Array, enter: int, rows: np.ndarray, basis: np.ndarray) -> int:
    """The row that leaves: smallest ratio, ties broken by the next columns; the artificial one as soon as it can."""
    n = len(basis)
    for key in (-1, *range(n)):
        ratio = A[rows, key] / A[rows, enter]
        rows = rows[ratio <= ratio.min() + 1e-12 * max(1.0, np.abs(ratio).max())]
        artificial = rows[basis[rows] == 2 * n]
        if len(rows) == 1 or len(artificial):
            break
    return int(artificial[0] if len(artificial) else rows[0])


@dataclass(frozen=True)
class _Coulomb:
    """Data of (1), (2): W (m d, m d), q (m, d), mu (m,), and c (m, d), which makes gaps and forces comparable."""

    W: Array
    q: Array
    mu: Array
    c: Array

    def residual(self, x: Array) -> tuple[Array, Array, Array]:
        """Alart and Curnier's function at forces x and its derivatives."""
        return _alart_curnier(x, self.q + (self.W @ x.ravel()).reshape(x.shape), self.c, self.mu)

    def size(self, F: Array, x: Array) -> float:
        """Largest residual over the largest force."""
        free = np.abs(self.c * self.q).max(initial=0.0)
        scale = free + min(np.abs(x).max(initial=0.0), 1e3 * free)  # large forces that cancel each other do not count
        return float(np.abs(F).max(initial=0.0) / max(scale, 1e-300))


def _proximal_points(problem: _Coulomb, x: Array, rho: float) -> tuple[Array, float, int]:
    """Forces, their residual in the original problem, and Newton iterations, by (3) from x."""
    m, d = x.shape
    D = rho * np.repeat(np.diag(problem.W).reshape(m, d).mean(axis=1), d)
    total = 0
    for _ in range(10 if rho else 1):
        near = problem
        if rho:
            near = replace(problem, W=problem.W + np.diag(D), q=problem.q - (D * x.ravel()).reshape(m, d))
        x, iterations = _newton(near, x)
        total += iterations
        size = problem.size(problem.residual(x)[0], x)
        if size <= 1e-12 or not np.isfinite(size):
            break
    return x, size, total


def _newton(problem: _Coulomb, x: Array) -> tuple[Array, int]:
    """Semismooth Newton from x, until the residual is small or does not fall; forces and iterations."""
    best = np.inf
    for k in range(40):
        F, dx, du = problem.residual(x)
        size = problem.size(F, x)
        if size <= 1e-13 or not np.isfinite(size) or (k > 8 and size > 0.5 * best):
            return x, k
        best = min(best, size)
        x = x + _solve(_blocks(dx) + _blocks(du) @ problem.W, -F.ravel()).reshape(x.shape)
    return x, 40


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
