"""Multiplier spaces: constants, biorthogonality, border rules, patches."""

from __future__ import annotations

import numpy as np
import pytest
from test_traces import make

from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends, Linear, default_space

SPACES = [
    Continuous(),
    Continuous(1),
    Dual(),
    Discontinuous(0),
    Discontinuous(1),
    Aggregated(),
    Continuous(ends=Ends.KEPT),
]


@pytest.mark.parametrize("dim, degree", [(2, 1), (2, 2), (3, 1)])
@pytest.mark.parametrize("space", SPACES, ids=str)
def test_constants_are_in_the_space(dim: int, degree: int, space) -> None:
    _, _, t = make(dim, degree)
    mu = space.on(t)
    one = np.linalg.lstsq(mu.basis.T.toarray(), np.ones(mu.basis.shape[1]), rcond=None)[0]
    assert np.abs(mu.coefficients(one) - 1.0).max() < 1e-12
    assert one @ mu.coupling() @ np.ones(t.n) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.matrix_rank(mu.basis.toarray()) == mu.n


def test_ends_dropped_lose_constants() -> None:
    _, _, t = make(2, 1)
    assert Continuous(ends=Ends.DROPPED).on(t).coupling().sum() < 0.99


@pytest.mark.smoke
@pytest.mark.parametrize("dim, degree", [(2, 1), (2, 2), (3, 1)])
def test_dual_is_biorthogonal_to_inner_functions(dim: int, degree: int) -> None:
    _, _, t = make(dim, degree)
    mu = Dual().on(t)
    inner = np.setdiff1d(np.arange(t.n), t.border)
    B = mu.coupling().toarray()[:, inner]
    integrals = np.asarray(t.mass().sum(axis=1)).ravel()[inner]
    assert np.abs(B - np.diag(integrals)).max() < 1e-14


def test_merged_p2_ends_keep_linear_functions_in_the_plane() -> None:
    _, _, t = make(2, 2)
    mu = Continuous().on(t)
    x = t.corners[:, :, 0]
    wanted = np.concatenate((x, x.mean(1, keepdims=True)), axis=1).ravel()
    found = np.linalg.lstsq(mu.basis.T.toarray(), wanted, rcond=None)[0]
    assert np.abs(mu.basis.T @ found - wanted).max() < 1e-12


def test_resultants_see_forces_and_moments() -> None:
    _, _, t = make(3, 2)
    mu = Linear().on(t)
    assert mu.n == 3  # 1, x, z on the plane y = 1
    B = mu.coupling()
    assert B[0].sum() == pytest.approx(1.0, abs=1e-13)
    assert np.abs((B @ np.ones(t.n))[1:]).max() < 1e-13


def test_dual_of_p2_on_triangles_is_refused() -> None:
    _, _, t = make(3, 2)
    with pytest.raises(InputError, match="do not exist on triangles"):
        Dual().on(t)


def test_aggregates_are_about_twice_as_coarse() -> None:
    _, _, t = make(2, 1)
    assert Aggregated().on(t).n == 1
    for space, n in ((default_space(1), 2), (default_space(2), 4)):
        degree = 1 if n == 2 else 2
        assert space.on(make(2, degree)[2]).n == n
