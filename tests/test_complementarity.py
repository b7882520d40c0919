"""The small problems of contact: linear complementarity and Coulomb friction on random and on treacherous
matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmbd_fenicsx.errors import ConvergenceError
from fmbd_fenicsx.linear.complementarity import coulomb
from fmbd_fenicsx.linear.complementarity.coulomb import ContactCounts, _lemke, solve_friction


def solve_normal(W: np.ndarray, q: np.ndarray, counts: ContactCounts) -> np.ndarray:
    none = np.zeros(len(q))
    return solve_friction(W, q[:, None], none, none[:, None], counts)[:, 0]


def matrix(seed: int, m: int) -> np.ndarray:
    A = np.random.default_rng(seed).standard_normal((m, m + 2))
    return A @ A.T


@given(st.integers(0, 10_000), st.integers(1, 12), st.floats(-6, 6))
def test_normal_problem_is_solved_in_any_units(seed: int, m: int, exponent: float) -> None:
    W, q = matrix(seed, m), np.random.default_rng(seed + 1).standard_normal(m)
    unit = 10.0**exponent
    counts = ContactCounts()
    L = solve_normal(unit * W, q, counts)
    g = q + unit * W @ L
    assert L.min() >= 0 and g.min() > -1e-9 * np.abs(q).max()
    assert np.abs(L * g).max() <= 1e-8 * max(np.abs(L).max(), 1e-300) * np.abs(q).max()


def test_no_set_of_closed_points_comes_again_and_again() -> None:
    """P-matrices, on some of which the plain iteration of active sets cycles (found by search)."""
    rng = np.random.default_rng(0)
    for _ in range(300):
        A = rng.standard_normal((6, 6))
        W, q = A @ A.T + 1e-3 * np.eye(6), rng.standard_normal(6)
        counts = ContactCounts()
        L = solve_normal(W, q, counts)
        assert (q + W @ L).min() > -1e-8 * np.abs(q).max() and L.min() >= 0
        assert counts.residual < 1e-8 and counts.most < 40


def test_forces_of_roundoff_beside_open_gaps_are_no_residual() -> None:
    """A point that stays closed with a force of roundoff below zero, as one that just touches does."""
    W = np.array([[14.0, 3.0, 0.0], [3.0, 14.0, 0.0], [0.0, 0.0, 14.0]])
    counts = ContactCounts()
    q = np.array([*(W[:2, :2] @ [-3e-15, 2e-16]), 1.0])
    solve_normal(W, q, counts)
    assert counts.residual < 1e-14


@pytest.mark.parametrize("seed", range(30))
def test_normal_problem_of_contacts_that_depend_on_each_other(seed: int) -> None:
    """Many nodes on few modes, the last of them stiff: they cannot all close, and forces stay of the impact's size."""
    rng = np.random.default_rng(seed)
    m, modes = int(rng.integers(20, 42)), int(rng.integers(3, 6))
    x = np.linspace(-1.0, 1.0, m)
    N = np.polynomial.legendre.legvander(x, modes - 1) * np.r_[np.ones(modes - 1), 1e-3]
    q = N @ np.r_[-1.0, 0.1 * rng.standard_normal(modes - 1)] * 1e-3 + 1e-9 * rng.standard_normal(m)
    W, counts = N @ N.T, ContactCounts()
    L = solve_normal(W, q, counts)
    g, size = q + W @ L, np.abs(q / np.diag(W)).max()
    assert np.abs(np.minimum(L, g / np.diag(W))).max() <= 1e-10 * size
    assert L.max() <= 10 * size
    assert counts.residual <= 1e-10


@given(st.integers(0, 10_000), st.integers(1, 5), st.sampled_from([2, 3]))
def test_friction_problem(seed: int, m: int, d: int) -> None:
    W = matrix(seed, m * d)
    q = np.random.default_rng(seed + 1).standard_normal((m, d))
    mu = np.full(m, 0.2)
    x = solve_friction(W, q, mu, np.zeros((m, d)), ContactCounts())
    u = q + (W @ x.ravel()).reshape(m, d)
    size = max(np.abs(x).max(), 1e-300)
    assert x[:, 0].min() >= -1e-9 * size and u[:, 0].min() > -1e-7
    assert np.abs(x[:, 0] * u[:, 0]).max() <= 1e-7 * size
    slip = np.linalg.norm(u[:, 1:], axis=1)
    t = np.linalg.norm(x[:, 1:], axis=1)
    assert (t <= mu * x[:, 0] + 1e-8 * size).all()
    for i in np.flatnonzero((slip > 1e-6) & (x[:, 0] > 1e-8 * size)):
        assert x[i, 1:] == pytest.approx(-mu[i] * x[i, 0] * u[i, 1:] / slip[i], abs=1e-6 * size)


@given(st.integers(0, 10_000), st.integers(1, 6), st.sampled_from([2, 3]), st.sampled_from([0.3, 1.0, 2.0]))
def test_friction_of_contacts_that_depend_on_each_other(seed: int, m: int, d: int, mu: float) -> None:
    """W of any rank, friction strongly coupled with normal forces; velocities that forces can stop."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((m * d, int(rng.integers(1, m * d + 1))))
    W, q = A @ A.T, (A @ rng.standard_normal(A.shape[1])).reshape(m, d)
    counts = ContactCounts()
    x = solve_friction(W, q, np.full(m, mu), np.zeros((m, d)), counts)
    check_coulomb((W, q, mu), x, counts)


def check_coulomb(problem: tuple[np.ndarray, np.ndarray, float], x: np.ndarray, counts: ContactCounts) -> None:
    """Signorini's and Coulomb's laws, to 1e-12 of the largest force."""
    W, q, mu = problem
    m, d = q.shape
    force = max(np.abs(x).max(), np.abs(q).max() / np.diag(W).max())
    u, speed = q + (W @ x.ravel()).reshape(m, d), np.diag(W).max() * force
    assert counts.residual <= 1e-12
    assert x[:, 0].min() >= -1e-11 * force and u[:, 0].min() > -1e-11 * speed
    assert np.abs(np.minimum(x[:, 0] / force, u[:, 0] / speed)).max() <= 1e-10
    slip, t = np.linalg.norm(u[:, 1:], axis=1), np.linalg.norm(x[:, 1:], axis=1)
    assert (t <= mu * x[:, 0] + 1e-11 * force).all()
    assert (np.minimum(mu * x[:, 0] - t, force) * np.minimum(slip, speed)).max() <= 1e-10 * force * speed
    for i in np.flatnonzero((slip > 1e-6 * speed) & (x[:, 0] > 1e-6 * force)):
        assert x[i, 1:] == pytest.approx(-mu * x[i, 0] * u[i, 1:] / slip[i], abs=1e-5 * force)


@pytest.mark.parametrize("seed", [33, 62, 91, 140, 302, 318, 860, 934, 1349, *range(30)])
def test_slips_much_slower_than_the_impact(seed: int) -> None:
    """Points of a rigid plate that hits a floor while it hardly slides: more points than the plate has freedoms."""
    rng = np.random.default_rng(seed)
    m, mu = int(rng.integers(2, 9)), float(rng.choice([0.3, 1.0, 2.0, 3.0]))
    e, flat = float(rng.choice([0, 0.4, 0.8])), rng.random() < 0.7
    X = np.c_[rng.uniform(-0.5, 0.5, (m, 2)), np.full(m, -0.05) if flat else rng.uniform(-0.3, 0, m)]
    turn = np.cross(np.eye(3)[None], X[:, None]).swapaxes(1, 2)  # omega x X
    J = np.concatenate((np.broadcast_to(np.eye(3), (m, 3, 3)), turn), axis=2)[:, [2, 0, 1]].reshape(3 * m, 6)
    W = (J / np.array([1, 1, 1, 0.0842, 0.0842, 0.1667])) @ J.T
    slow = 10.0 ** -rng.integers(0, 8)
    v = rng.standard_normal(6) * np.array([slow, slow, 1, 1, 1, slow])
    v[2] = -abs(v[2])
    if rng.random() < 0.3:
        v[3:5] *= slow
    q = (J @ v).reshape(m, 3)
    q[:, 0] += e * np.minimum(q[:, 0], 0.0)
    counts = ContactCounts()
    x = solve_friction(W, q, np.full(m, mu), np.zeros((m, 3)), counts)
    check_coulomb((W, q, mu), x, counts)


def test_pivots_that_overflow_end_the_pivoting() -> None:
    """Without a finite number no start is found, and nobody else's floating point settings are met."""
    with np.errstate(over="raise", invalid="raise"):
        z = _lemke(np.array([[1e-309]]), np.array([-1.0]))
    np.testing.assert_array_equal(z, np.zeros(1))


@pytest.mark.parametrize("seed", range(40))
def test_corners_that_cannot_all_touch(seed: int) -> None:
    """Gaps of a plate's corners differ from a plane's by 1e-5 ... 1e-11 of the impact, and this says which three carry it."""
    rng = np.random.default_rng(seed)
    X = np.array([(x, y, -0.05) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    turn = np.cross(np.eye(3)[None], X[:, None]).swapaxes(1, 2)
    J = np.concatenate((np.broadcast_to(np.eye(3), (4, 3, 3)), turn), axis=2)[:, [2, 0, 1]].reshape(12, 6)
    W = (J / np.array([1, 1, 1, 0.08, 0.08, 0.16])) @ J.T
    v = rng.standard_normal(6) * np.array([0.3, 0.3, 1, 1e-2, 1e-2, 0.1])
    v[2] = -abs(v[2])
    q = (J @ v).reshape(4, 3)
    q[:, 0] += np.abs(q).max() * 10.0 ** -rng.uniform(5, 11) * rng.standard_normal(4)
    mu, counts = float(rng.choice([0.1, 0.3, 0.8, 1.2])), ContactCounts()
    x = solve_friction(W, q, np.full(4, mu), np.zeros((4, 3)), counts)
    check_coulomb((W, q, mu), x, counts)
    assert counts.iterations < 100


@pytest.mark.parametrize("d", [2, 3])
def test_heaps_that_do_not_touch_are_problems_of_their_own(d: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point's group is solved with its own rows of W alone; the forces solve the whole."""
    W = np.zeros((6 * d, 6 * d))
    groups = ([0, 2, 5], [1, 4], [3])
    for k, group in enumerate(groups):
        rows = np.array([d * i + a for i in group for a in range(d)])
        W[np.ix_(rows, rows)] = matrix(k, len(rows))
    q = -np.random.default_rng(3).uniform(0.1, 1.0, (6, d))
    assert [list(x) for x in coulomb.independent(W, d)] == [list(x) for x in sorted(groups)]

    sizes, solved = [], coulomb.solved
    monkeypatch.setattr(coulomb, "solved", lambda p, *args: (sizes.append(len(p.q)), solved(p, *args))[1])
    counts = ContactCounts()
    check_coulomb((W, q, 0.4), solve_friction(W, q, np.full(6, 0.4), np.zeros((6, d)), counts), counts)
    assert sizes == [3, 2, 1]


def test_pivoting_is_for_few_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tableau of 50 contacts takes minutes: a problem that nothing else solves is refused, and the step made shorter."""
    failed = lambda problem, x, u, rho, counts: (1.0, x)  # noqa: E731
    sizes: list[int] = []
    pivoted = coulomb._pivoted
    monkeypatch.setattr(coulomb, "_proximal_points", failed)
    monkeypatch.setattr(coulomb, "_pivoted", lambda p, facets: (sizes.append(len(p.q)), pivoted(p, facets))[1])
    for count in (2, 50):
        W, q = matrix(1, 3 * count), -np.ones((count, 3))
        with pytest.raises(ConvergenceError):
            solve_friction(W, q, np.full(count, 0.3), np.zeros((count, 3)), ContactCounts())
    assert sizes == [2, 2]
