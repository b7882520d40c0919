"""Inf-sup constants against the published table, and norms of H^1/2 and H^-1/2 against Fourier modes."""

from __future__ import annotations

import numpy as np
import pytest
from test_traces import ROOT, make

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.fem.traces.multipliers import Aggregated, Continuous, Discontinuous, Dual, Ends
from fmbd_fenicsx.fem.traces.stability import DualNorm, half_norm, infsup

KEPT, DROPPED = Continuous(ends=Ends.KEPT), Continuous(ends=Ends.DROPPED)
P1 = Continuous(1, Ends.KEPT)
# degree, space, neighbours free (n = 4, 8), neighbours clamped (n = 4, 8), zero modes when clamped
TABLE = [
    (1, KEPT, (0.612, 0.612), (0.0, 0.0), 2),
    (1, Continuous(), (0.765, 0.634), (0.601, 0.603), 0),
    (1, DROPPED, (0.729, 0.630), (0.653, 0.621), 0),
    (1, Dual(), (0.724, 0.629), (0.646, 0.622), 0),
    (1, Discontinuous(0), (0.423, 0.222), (0.0, 0.0), 1),
    (1, Aggregated(), (0.909, 0.800), (0.731, 0.731), 0),
    (2, KEPT, (0.583, 0.583), (0.0, 0.0), 2),
    (2, P1, (0.892, 0.892), (0.687, 0.709), 0),
    (2, Discontinuous(0), (0.900, 0.864), (0.848, 0.848), 0),
    (2, Discontinuous(1), (0.332, 0.173), (0.0, 0.0), 1),
]


@pytest.fixture(scope="module")
def squares():
    known = {}

    def of(n: int):
        if n not in known:
            known[n] = fmbd.read_gmsh(ROOT / "meshes/block.py", cells=n)
        return known[n]

    return of


@pytest.mark.mpi
@pytest.mark.parametrize(
    "degree, space, free, clamped, zero", TABLE, ids=lambda v: str(v) if not isinstance(v, tuple) else ""
)
def test_table(squares, degree: int, space, free, clamped, zero: int) -> None:
    for n, wanted, held in zip((4, 8), free, clamped, strict=True):
        reference = (squares(4 * n), 2)
        a = infsup((squares(n), "bottom"), space, degree=degree, reference=reference)
        assert a.constant == pytest.approx(wanted, abs=1.5e-3) and a.zero_modes == 0
        b = infsup((squares(n), "bottom"), space, degree=degree, clamped=("left", "right"), reference=reference)
        assert b.constant == pytest.approx(held, abs=1.5e-3) and b.zero_modes == zero
        assert infsup((squares(n), "bottom"), space, degree=degree).constant == pytest.approx(a.constant, abs=0.02)


@pytest.mark.smoke
def test_half_norms_of_a_cosine() -> None:
    """cos(k x) on [0, 1] with k = 2 pi: the norm of order s is sqrt((1 + k^2)^s / 2)."""
    _, _, t = make(2, 3)
    from fmbd_fenicsx.fem.traces.traces import refined

    fine = refined(t, 5, 2)
    k = 2 * np.pi
    for s in (-0.5, 0.0, 0.5, 1.0):
        assert half_norm(fine, np.cos(k * fine.points[:, 0]), order=s) == pytest.approx(
            np.sqrt((1 + k * k) ** s / 2), rel=1e-4
        )


def test_dual_norm_of_a_constant() -> None:
    _, _, t = make(2, 1)
    mu = KEPT.on(t)
    assert DualNorm(mu).of(np.ones(mu.n)) == pytest.approx(1.0, abs=1e-10)


@pytest.mark.parametrize(
    "degree, finer, free, clamped",
    [(1, 2.0, (4, 8), (6, 10)), (0, 1.5, (1, 3), (3, 5))],
    ids=["P1 on h/2", "P0 on h/1.5"],
)
def test_finer_carrier_is_unstable(
    squares, degree: int, finer: float, free: tuple[int, int], clamped: tuple[int, int]
) -> None:
    """Multipliers on a finer mesh beside P1: zero modes, whatever their norm (the coarser side must not carry more functions)."""
    space = KEPT if degree else Discontinuous(0)
    for n, loose, held in zip((4, 8), free, clamped, strict=True):
        carrier = (squares(round(finer * n)), "bottom")
        assert infsup((squares(n), "bottom"), space, degree=1, carrier=carrier).zero_modes == loose
        found = infsup((squares(n), "bottom"), space, degree=1, carrier=carrier, clamped=("left", "right"))
        assert found.zero_modes == held


def test_infsup_of_a_tie(squares) -> None:
    body = fmbd.AbsoluteBody(
        "plate", squares(8), degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3)
    )
    good = fmbd.tie_surface("good", body.surface("bottom"), fmbd.ground)
    bad = fmbd.tie_surface("bad", body.surface("top"), fmbd.ground, space=Discontinuous(1))
    assert infsup(good).constant == pytest.approx(0.635, abs=2e-3)
    assert infsup(bad).zero_modes == 7


def test_constants_do_not_depend_on_units() -> None:
    """A block of 40 m or of 1 mm has the constant of one of 1 m."""
    for size in (40.0, 1e-3):
        mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(size, size), cells=4)
        assert infsup((mesh, "bottom"), P1, degree=2).constant == pytest.approx(0.892, abs=0.01)
