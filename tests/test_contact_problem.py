"""Small problems of contact forces in compiled code, and rows on the nodes of elastic bodies."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from fmbd_fenicsx.linear.complementarity.coulomb import ContactCounts, solve_friction
from fmbd_fenicsx.mechanics.contact.nodal_rows import NodalRows
from fmbd_fenicsx.schemes.impacts.compiled.problem import CompiledProblem
from fmbd_fenicsx.system.compiled.library import CONTACT, driver_library

pytestmark = pytest.mark.compiled


def library(dim: int) -> Any:
    return driver_library(dim, (CONTACT,))


@pytest.mark.parametrize("d", [1, 2, 3])
def test_compiled_forces_are_those_of_numpy(d: int) -> None:
    """One object for problems of many sizes, from any forces; openings that it is given are those under them."""
    rng = np.random.default_rng(d)
    compiled = CompiledProblem(library(max(d, 2)), d)
    counts, found = ContactCounts(), 0
    for m in (1, 7, 3, 12, 40, 12) * 5:
        A = rng.standard_normal((m * d, m * d))
        W = A @ A.T / (m * d) + 0.5 * np.eye(m * d)
        q, mu, start = rng.standard_normal((m, d)), rng.uniform(0.0, 0.4, m), np.abs(rng.standard_normal((m, d)))
        opening = q + (W @ start.ravel()).reshape(m, d)
        force = compiled.forces(W, opening, mu, start, counts)
        if force is None:  # that is for NumPy
            continue
        found += 1
        expected = solve_friction(W, q, mu if d > 1 else 0.0 * mu, start, ContactCounts())
        assert force == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    assert found >= 25
    assert counts.solves == found
    assert counts.residual < 1e-12


def test_dependent_contacts_are_given_back() -> None:
    """A plate on four corners: one of the distributions is NumPy's choice."""
    corners = np.array([(1.0, x, y) for x in (-1, 1) for y in (-1, 1)])
    W = corners @ corners.T
    none, counts = np.zeros((4, 1)), ContactCounts()
    assert CompiledProblem(library(2), 1).forces(W, none - 1.0, none[:, 0], none, counts) is None
    assert counts.solves == counts.iterations == 0


def random_rows(rng: np.random.Generator, count: int, n: int, d: int, *, single: bool) -> NodalRows:
    row = np.arange(count) if single else np.sort(rng.integers(0, count, 3 * count))
    return NodalRows(count, row, rng.integers(0, n, len(row)), rng.standard_normal((len(row), d)))


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_rows_on_nodes_are_a_sparse_matrix(d: int, single: bool) -> None:
    rng, n = np.random.default_rng(7), 9
    one, two = (random_rows(rng, 5, n, d, single=single) for _ in range(2))
    w, force, columns = rng.standard_normal((n, d)), rng.standard_normal(5), rng.standard_normal((n * d, 4))
    turn = np.linalg.qr(rng.standard_normal((d, d)))[0]
    full, other = one.matrix(n).toarray(), two.matrix(n).toarray()

    assert one.times(w) == pytest.approx(full @ w.ravel(), abs=1e-14)
    assert one.transposed(force, n).ravel() == pytest.approx(full.T @ force, abs=1e-14)
    assert one.columns(columns) == pytest.approx(full @ columns, abs=1e-14)
    assert one.turned(turn).times(w) == pytest.approx(full @ (w @ turn.T).ravel(), abs=1e-14)
    assert one.turned(None) is one
    for rows in (np.array([3, 0]), np.array([True, False, True, True, False])):
        assert one.take(rows).matrix(n).toarray() == pytest.approx(full[rows], abs=1e-14)
    assert (one + two).times(w) == pytest.approx((full + other) @ w.ravel(), abs=1e-14)
    assert NodalRows.stacked([one, two]).matrix(n).toarray() == pytest.approx(np.concatenate((full, other)))
    assert not NodalRows.none(5, d).times(w).any()


def test_contacts_that_stay_open_cost_little() -> None:
    """Of 100 contacts with friction 8 close: rows of the others hold nothing to eliminate."""
    rng, m, d = np.random.default_rng(0), 100, 2
    A = rng.standard_normal((m * d, m * d))
    W = A @ A.T / (m * d) + np.eye(m * d)
    compiled, none, mu = CompiledProblem(library(2), d), np.zeros((m, d)), np.full(m, 0.3)

    def seconds(closed: int) -> float:
        """CPU time of an iteration in the middle of nine problems."""
        opening, spent = np.where(np.arange(2 * m).reshape(m, d) < closed * d, -1.0, 10.0 * m), []
        for _ in range(9):
            counts, begin = ContactCounts(), time.process_time()
            assert compiled.forces(W, opening, mu, none, counts) is not None
            spent.append((time.process_time() - begin) / counts.iterations)
        return float(np.median(spent))

    seconds(m)
    assert seconds(8) < 0.4 * seconds(m)
