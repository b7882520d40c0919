"""Coulomb friction in small dense problems: semismooth Newton, proximal points, pivoting.

    0 <= L  _|_  q + W L >= 0   in normal directions                                                        (1)
    tau in disk of radius mu L,  tau = projection(tau - c s),  s = q_t + W_t (L, tau)                       (2)
    x_k+1 solves (1), (2) with W + rho D and q - rho D x_k,  D = diag W                                     (3)

(2) is Alart and Curnier's function (doi:10.1016/0045-7825(91)90022-X). Contacts that depend on each other (a plate on
four corners) make W singular; the proximal points (3) choose one of the force distributions, near the start, and
converge in a few steps since rho is small (Rockafellar, doi:10.1137/0314056).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import ConvergenceError
from ..rotations import Array
from .complementarity import ContactCounts, solve_least

PROXIMAL = (0.0, 1e-8, 1e-6, 1e-4, 1e-10)  # rho of (3), tried in turn
ACCEPTED = 1e-6  # residual where all attempts miss 1e-12: the direction of a slip much slower than the impact is lost


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
    best: tuple[float, Array] = (np.inf, start)
    for first in (lambda: start, lambda: _pivoted(problem, 16), lambda: _pivoted(problem, 64)):
        x0 = first()
        for rho in PROXIMAL:
            x, size, iterations = _proximal_points(problem, x0, rho)
            counts.iterations += iterations
            best = min(best, (size, x), key=lambda found: found[0])
            if size <= 1e-12:
                break
            counts.cycles += 1
        if best[0] <= 1e-12:
            break
    size, x = best
    if size <= ACCEPTED:
        counts.most, counts.solves = max(counts.most, iterations), counts.solves + 1
        counts.residual = max(counts.residual, size)
        return x
    raise ConvergenceError(
        f"The friction problem did not converge (residual {size:.1e} of the largest force). With large friction "
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
    T: Array = np.zeros((m, d, m, 1 + k))  # forces from normal and facet components
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
        x = x + solve_least(_blocks(dx) + _blocks(du) @ problem.W, -F.ravel()).reshape(x.shape)
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
