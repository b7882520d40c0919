"""The small problems of contact: linear complementarity and Coulomb friction on random and on treacherous
matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmbd_fenicsx.linear.complementarity import ContactCounts, solve_normal
from fmbd_fenicsx.linear.coulomb import solve_friction


def matrix(seed: int, m: int) -> np.ndarray:
    A = np.random.default_rng(seed).standard_normal((m, m + 2))
    return A @ A.T


@given(st.integers(0, 10_000), st.integers(1, 12), st.floats(-6, 6))
def test_normal_problem_is_solved_in_any_units(seed: int, m: int, exponent: float) -> None:
    W, q = matrix(seed, m), np.random.default_rng(seed + 1).standard_normal(m)
    unit = 10.0**exponent
    counts = ContactCounts()
    L = solve_normal(unit * W, q, np.zeros(m, dtype=bool), counts)
    g = q + unit * W @ L
    assert L.min() >= 0 and g.min() > -1e-9 * np.abs(q).max()
    assert np.abs(L * g).max() <= 1e-8 * max(np.abs(L).max(), 1e-300) * np.abs(q).max()


def test_cycle_is_broken_and_counted() -> None:
    """A P-matrix on which the plain active-set iteration cycles (found by search)."""
    rng = np.random.default_rng(0)
    for _ in range(4000):
        A = rng.standard_normal((6, 6))
        W, q = A @ A.T + 1e-3 * np.eye(6), rng.standard_normal(6)
        counts = ContactCounts()
        L = solve_normal(W, q, np.zeros(6, dtype=bool), counts)
        if counts.cycles:
            assert (q + W @ L).min() > -1e-8 * np.abs(q).max() and L.min() >= 0
            assert counts.residual < 1e-8
            return
    pytest.fail("no matrix of the sample cycles")


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
    u, size = q + (W @ x.ravel()).reshape(m, d), max(np.abs(q).max(), 1.0)
    assert counts.residual <= 1e-6
    assert x[:, 0].min() >= -1e-6 * size and u[:, 0].min() > -1e-4 * size
    assert np.abs(x[:, 0] * u[:, 0]).max() <= 1e-4 * size**2
    assert (np.linalg.norm(x[:, 1:], axis=1) <= mu * x[:, 0] + 1e-4 * size).all()
