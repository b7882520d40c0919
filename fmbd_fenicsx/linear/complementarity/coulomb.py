"""Forces of contact points, with Coulomb friction or without: semismooth Newton with a line search, proximal points, pivoting.

    0 <= L  _|_  q + W L >= 0   in normal directions                                                        (1)
    tau in disk of radius mu L,  tau = projection(tau - c s),  s = q_t + W_t (L, tau)                       (2)
    x_k+1 solves (1), (2) with W + rho_k / c and q - rho_k x_k / c                                          (3)

(2) is Alart and Curnier's function (doi:10.1016/0045-7825(91)90022-X), solved to 1e-12 of the largest force, and of
each contact's own or of 1e4 c times the gaps and slips without forces; without friction it is the iteration of active sets
(Hintermueller, Ito and Kunisch, doi:10.1137/S1052623401383558). Contacts that depend on each
other (a plate on four corners) make W singular; the proximal points (3) choose one of the force distributions, near the start
(Rockafellar, doi:10.1137/0314056). rho falls with every point found, so that slips and gaps much slower than the impact, which
move the forces by s / rho, are found too. Newton's steps along such a distribution leave the cones by the square of their
length: the line search looks behind some whole steps before it makes one shorter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ...errors import ConvergenceError
from ...rotations import Array
from ...system.compiled.declarations import constants

ATTEMPTS = ((0, 0.0), (0, 1e-4), (8, 1e-4), (16, 1e-4))
"""Tried in turn: facets of the pyramid whose pivoting gives the start (0: the forces given); rho_0."""
PIVOTED = 30  # points at most: a tableau of many takes minutes, where half a step takes moments
# residual of a solution, of the largest force; the same where roundoff in W (an elastic step of many wave transits) allows no
# better; share of a Newton step below which the line search takes it
FOUND, ACCEPTED, SHORTEST = constants("contact/friction.c", "FOUND", "ACCEPTED", "SHORTEST")
(MISSED,) = constants("contact/complementarity.c", "MISSED")  # what a share of missed rates counts beside one of forces
# shares of the largest compliance: known to few digits; those of contacts that depend on others
FAINT, DEPENDENT = 1e-9, 1e-14
PAINLEVE = (
    " With large friction coefficients no solution with finite forces may exist (Painleve); use the Moreau scheme, which has "
    "impacts, or a smaller dt."
)


@dataclass
class ContactCounts:
    """Statistics of a run: Newton's iterations, changes of points' states between them, further attempts, worst residual;
    products of the compliance that compiled code has made.
    """

    iterations: int = 0
    changes: int = 0
    cycles: int = 0
    most: int = 0
    solves: int = 0
    residual: float = 0.0
    products: int = 0


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


def solve_friction(W: Array, q: Array, mu: Array, start: Array, counts: ContactCounts) -> Array:
    """Forces (m, d): normal, then tangential, of (1) and (2). W (m d, m d) and q (m, d) in blocks of components by point; d = 1
    without friction.

    Contacts that share no body, nor bodies joined to each other, are problems of their own: what is hard in one heap is not
    asked of all. Newton's method from ``start``; where it fails, because contacts depend on each other, proximal points (3);
    where friction and normal forces are strongly coupled, the same from the forces of pivoting.

    Raises:
        ConvergenceError: no solution found; with large friction none may exist (Painleve) and an impact law
        is needed.
    """
    m, d = q.shape
    parts = independent(W, d)
    if len(parts) > 1:
        out = np.zeros((m, d))
        for part in parts:
            rows = (part[:, None] * d + np.arange(d)).ravel()
            out[part] = solve_friction(W[np.ix_(rows, rows)], q[part], mu[part], start[part], counts)
        return out
    problem = Coulomb(W, q, mu, comparable(1.0 / np.maximum(np.diag(W), 1e-300), q.shape))
    return solved(problem, start, problem.gap(start), counts)


def comparable(c: Array, shape: tuple[int, ...]) -> Array:
    """What makes gaps and forces comparable, (m, d), from that of each component: one for both tangents, as the cone is round."""
    found = c.reshape(shape).copy()
    found[:, 1:] = found[:, 1:].min(axis=1, initial=np.inf)[:, None]
    return found


def independent(W: Array, d: int) -> list[np.ndarray]:
    """Groups of points between which W (m d, m d) is zero, each ascending, in the order of their first ones."""
    from scipy.sparse.csgraph import connected_components

    m = len(W) // d
    count, label = connected_components((W.reshape(m, d, m, d) != 0.0).any(axis=(1, 3)), directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def solved(problem: Coulomb, start: Array, gap: Array, counts: ContactCounts) -> Array:
    """As :func:`solve_friction`, for a problem that may know W by its products only; ``gap``: gaps and slips under ``start``."""
    best: tuple[float, Array] = (np.inf, start)
    counts.solves += 1

    # the cheapest start first, and the best answer of all counts
    for facets, rho in problem.attempts:
        if facets and (not problem.mu.any() or len(problem.q) > PIVOTED):
            continue
        x0 = _pivoted(problem, facets) if facets else start
        size, x = _proximal_points(problem, x0, problem.gap(x0) if facets else gap, rho, counts)
        best = min(best, (size, x), key=lambda found: found[0])
        if size <= FOUND:
            break
        counts.cycles += 1

    size, x = best
    if size <= ACCEPTED:
        counts.residual = max(counts.residual, size)
        return np.concatenate((np.maximum(x[:, :1], 0.0), x[:, 1:]), axis=1)  # none pulls by roundoff
    raise ConvergenceError(
        f"The contact problem did not converge (residual {size:.1e} of the largest force)."
        + (_lost_in_roundoff(problem) or (PAINLEVE if problem.mu.any() else " Use a smaller dt."))
    )


def _lost_in_roundoff(problem: Coulomb) -> str:
    """What to say where contacts give way by so little more than others, which depend on them, that W hardly knows it."""
    if not isinstance(problem.W, np.ndarray):
        return ""
    c = np.sqrt(problem.c.ravel())
    give = np.linalg.eigvalsh(c[:, None] * problem.W * c)
    faint = give[(give > DEPENDENT * give[-1]) & (give < FAINT * give[-1])]
    if not faint.size:
        return ""
    return (
        f" Motions of bodies in contact have inertias that differ by {give[-1] / faint[0]:.0e}, as of heavy bodies on light "
        "ones: roundoff hides the smaller ones. Take masses that differ by less than 1e9, or leave out what is so light."
    )


def _pivoted(problem: Coulomb, facets: int) -> Array:
    """Forces (m, d) by Lemke's pivoting with the cone of (2) as a pyramid (in the plane: as it is).

    Stewart and Trinkle, doi:10.1002/(SICI)1097-0207(19960815)39:15<2673::AID-NME972>3.0.CO;2-I. It finds a solution
    wherever impulses can exist (Anitescu and Potra, doi:10.1023/A:1008292328909).
    """
    m, d = problem.q.shape
    k = 2 if d == 2 else facets
    angle = 2 * np.pi * np.arange(k) / k
    e = np.stack((np.cos(angle), np.sin(angle)), axis=1)[:, : d - 1]

    # forces by normal and facet components
    T: Array = np.zeros((m, d, m, 1 + k))  # forces from normal and facet components
    T[range(m), 0, range(m), 0] = 1.0
    T[range(m), 1:, range(m), 1:] = e.T
    T = T.reshape(m * d, m * (1 + k))
    scale = 1.0 / np.repeat(problem.c.min(axis=1), 1 + k).max()
    n = m * (1 + k)

    # complementarity: openings, facet speeds, and what is left of the cone
    M = np.zeros((n + m, n + m))
    rhs = np.zeros(n + m)
    M[:n, :n] = T.T @ problem.W @ T / scale
    rhs[:n] = T.T @ problem.q.ravel() / scale
    for i in range(m):
        facet = slice(i * (1 + k) + 1, (i + 1) * (1 + k))
        M[facet, n + i], M[n + i, facet], M[n + i, i * (1 + k)] = 1.0, -1.0, problem.mu[i]
    return (T @ _lemke(M, rhs)[:n]).reshape(m, d)


@np.errstate(over="ignore", invalid="ignore")
def _lemke(M: Array, q: Array) -> Array:
    """z >= 0 with w = M z + q >= 0 and w . z = 0, by complementary pivoting with the lexicographic rule; zeros on a ray, and
    where pivots are so small that the numbers overflow (forces asked for at an iterate far off).

    Lemke (1965), doi:10.1287/mnsc.11.7.681.
    """
    n = len(q)
    if q.min(initial=0.0) >= 0:
        return np.zeros(n)
    # columns: w (n), z (n), artificial, right-hand side; rows w - M z - z0 = q
    A = np.concatenate((np.eye(n), -M, -np.ones((n, 1)), q[:, None]), axis=1)
    basis = np.arange(n)
    enter = 2 * n
    row = int(np.argmin(q))
    for _ in range(50 * n):
        # pivot: what enters takes the place of what leaves
        A[row] /= A[row, enter]
        others = np.arange(n) != row
        A[others] -= np.outer(A[others, enter], A[row])
        if not np.isfinite(A).all():
            break

        leave, basis[row] = basis[row], enter
        if leave == 2 * n:
            z = np.zeros(2 * n)
            z[basis] = A[:, -1]
            return np.maximum(z[n:], 0.0)
        # the complement of what has left enters next
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
class Iterate:
    """(1), (2) at forces x with gaps and slips u: the function F, its derivatives dx, du (m, d, d), and whether each point
    is open (0), sticks (1) or slips (2).
    """

    x: Array
    u: Array
    F: Array
    dx: Array
    du: Array
    state: np.ndarray


@dataclass(frozen=True)
class Coulomb:
    """Data of (1), (2): W (m d, m d), q (m, d), mu (m,), c (m, d), which makes gaps and forces comparable, and the
    ``shift`` (m, d) of W by (3).
    """

    W: Any
    q: Array
    mu: Array
    c: Array
    shift: Array | float = 0.0
    attempts: ClassVar[tuple[tuple[int, float], ...]] = ATTEMPTS
    enough: ClassVar[float] = 1e-13  # residual at which Newton's iteration stops
    ahead: ClassVar[int] = 5  # whole Newton steps, one behind the other, before one is made shorter

    def gap(self, x: Array) -> Array:
        """Gaps and slips under forces x."""
        return np.asarray(self.q + (self.W @ x.ravel()).reshape(x.shape) + self.shift * x)

    def at(self, x: Array, u: Array) -> Iterate:
        """Alart and Curnier's function."""
        return Iterate(x, u, *_alart_curnier(x, u, self.c, self.mu))

    def size(self, F: Array, x: Array) -> float:
        """Largest residual over the largest force; of each contact also over its own force, or the rates without forces.

        The largest force knows nothing of contacts of light bodies, which open and close at any rate under forces far below it.
        Large forces on light bodies count up to where their roundoff, in rates, is all that others move by.
        """
        free = np.abs(self.c[:, :1] * self.q).max(initial=0.0)
        scale = free + min(np.abs(x).max(initial=0.0), 1e3 * free)  # large forces that cancel each other do not count
        light = self.c * (np.abs(self.q).max(initial=0.0) / MISSED)
        own = light + np.minimum(np.abs(x).max(axis=1, initial=0.0)[:, None], light / MISSED)
        return float((np.abs(F) / np.maximum(np.minimum(own, scale), 1e-300)).max(initial=0.0))

    def step(self, it: Iterate) -> Array:
        """Newton's step of the forces."""
        W = self.W + np.diag(np.broadcast_to(self.shift, it.x.shape).ravel())
        return solve_least(_blocks(it.dx) + _blocks(it.du) @ W, -it.F.ravel()).reshape(it.x.shape)


def _proximal_points(problem: Coulomb, x: Array, u: Array, rho: float, counts: ContactCounts) -> tuple[float, Array]:
    """Residual in the original problem, and forces, by (3) from x with gaps and slips u, and the first ``rho``."""
    best, restart, before = (np.inf, x), rho, counts.iterations

    # Newton on a problem made easier by rho; rho falls as long as it succeeds
    for _ in range(40 if rho else 1):
        D = rho / problem.c
        near = replace(problem, q=problem.q - D * x, shift=D) if rho else problem
        found = _newton(near, near.at(x, u), counts)
        x, u = found.x, found.u + D * (x - found.x)
        size = problem.size(problem.at(x, u).F, x)
        best = min(best, (size, x), key=lambda pair: pair[0])
        if size <= FOUND or not np.isfinite(size):
            break
        # made harder after success, easier after failure
        rho = 0.1 * rho if near.size(found.F, x) <= FOUND else 10.0 * rho
        rho = restart if rho > 1.0 else rho

    counts.most = max(counts.most, counts.iterations - before)
    return best


def _newton(problem: Coulomb, it: Iterate, counts: ContactCounts) -> Iterate:
    """Semismooth Newton from an iterate, until the residual is small or does not fall."""
    best = np.inf
    for k in range(40):
        size = problem.size(it.F, it.x)
        # after eight steps each has to halve the residual
        if size <= problem.enough or not np.isfinite(size) or (k > 8 and size > 0.5 * best):
            break

        best = min(best, size)
        new = _searched(problem, it)

        counts.iterations += 1
        counts.changes += int((new.state != it.state).sum())
        it = new
    return it


def _searched(problem: Coulomb, it: Iterate) -> Iterate:
    """The iterate after a Newton step, halved while the function does not fall.

    Forces that depend on each other move along a curved valley: a whole step leaves it sideways, and those behind it come back.
    They are tried before the step is made so short that it stays in the valley.
    """
    s = problem.step(it)
    norm = np.linalg.norm(it.F)
    share = 1.0
    # gaps are linear in the forces: one product serves all shares of the step
    full = problem.gap(it.x + s)
    ahead = problem.at(it.x + s, full)
    for left in reversed(range(problem.ahead)):
        if np.linalg.norm(ahead.F) <= (1.0 - 1e-4) * norm:
            return ahead
        if left and np.isfinite(ahead.F).all():
            x = ahead.x + problem.step(ahead)
            ahead = problem.at(x, problem.gap(x))

    while True:
        new = problem.at(it.x + share * s, it.u + share * (full - it.u))
        if np.linalg.norm(new.F) <= (1.0 - 1e-4 * share) * norm or share < SHORTEST:
            return new
        share *= 0.5


def _alart_curnier(x: Array, u: Array, c: Array, mu: Array) -> tuple[Array, Array, Array, np.ndarray]:
    """F(x, u) of (1), (2), its derivatives (m, d, d) with respect to x and u, and the states of :class:`Iterate`."""
    m, d = x.shape
    F = np.zeros((m, d))
    dx = np.zeros((m, d, d))
    du = np.zeros((m, d, d))
    trial = x[:, 0] - c[:, 0] * u[:, 0]
    on = trial > 0
    # a point that presses is closed, one that does not has no force
    F[:, 0] = np.where(on, c[:, 0] * u[:, 0], x[:, 0])
    dx[:, 0, 0] = np.where(on, 0.0, 1.0)
    du[:, 0, 0] = np.where(on, c[:, 0], 0.0)

    # tangential: inside the cone the point sticks, outside it slips along e
    if d == 1:
        return F, dx, du, on.astype(int)
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
    return F, dx, du, on + slip.astype(int)


def _blocks(B: Array) -> Array:
    """Block-diagonal matrix of (m, d, d)."""
    m, d, _ = B.shape
    out = np.zeros((m, d, m, d))
    out[range(m), :, range(m)] = B
    return out.reshape(m * d, m * d)
