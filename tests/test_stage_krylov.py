"""The Krylov method of stage systems: solutions, and what later right-hand sides take from earlier ones."""

from __future__ import annotations

import numpy as np
import pytest

from fmbd_fenicsx.errors import LinearSolveError
from fmbd_fenicsx.schemes.implicit.stage_krylov import LIMIT, Directions

N = 60


def near_one(rng: np.random.Generator) -> np.ndarray:
    """A complex matrix with eigenvalues on a segment from one to a point across it, and a few others."""
    A = np.diag(1.0 + np.linspace(0.0, 1.0, N) * (0.9j - 0.6))
    return A + 0.05 * np.outer(rng.normal(size=N), rng.normal(size=N)) / N


def test_right_hand_sides_share_directions() -> None:
    """To a hundredth each; one like the first costs no image, a correction to the same share few."""
    rng = np.random.default_rng(4)
    A, rows = near_one(rng), rng.normal(size=(3, N))
    known = Directions(lambda V, w: V.conj() @ w, "a test")

    def image(d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return A @ d, rows[:2] @ d, rows[2:] @ d

    def solved(b: np.ndarray) -> tuple[np.ndarray, int]:
        before = known.iterations
        x, y, z, _ = known.solve((b, np.ones(2), np.ones(1)), image)
        assert y == pytest.approx(1.0 - rows[:2] @ x)
        assert z == pytest.approx(1.0 + rows[2:] @ x)
        return x, known.iterations - before

    b = rng.normal(size=N) + 0j
    x, first = solved(b)
    assert np.linalg.norm(A @ x - b) < 1e-2 * np.linalg.norm(b)
    assert 1 < first < 20

    assert solved(3.0 * b)[1] == 0
    left = b - A @ x
    more, second = solved(left)
    assert np.linalg.norm(A @ more - left) < 1e-2 * np.linalg.norm(left)
    assert second <= first


def test_a_matrix_that_turns_everything_is_given_up() -> None:
    """A cycle of all places: no direction helps before the last one. Images take over, and the limit says so."""
    known = Directions(lambda V, w: V.conj() @ w, "a test")
    nothing = np.zeros(0)

    with pytest.raises(LinearSolveError, match=rf"a test: {LIMIT} iterations of the stages left 1\.0e\+00"):
        known.solve((np.eye(N)[0], nothing, nothing), lambda d: (np.roll(d, 1), nothing, nothing))
