"""Mortar integrals: exact on flat surfaces, partial overlap, symmetric in ranks, clear errors."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.mortar import mortar
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Discontinuous, Ends
from fmbd_fenicsx.fem.traces.traces import trace_of


def pair(dim: int, slave: int, master: int, degree: int = 1, shift: float = 0.0, gap: float = 0.0):
    from dolfinx import fem

    size = (1.0, 1.0, 1.0)[:dim]
    up = fmbd.read_gmsh(ROOT / "meshes/block.py", size=size, cells=slave, origin=(shift, 1.0 + gap, 0.0)[:dim])
    low = fmbd.read_gmsh(ROOT / "meshes/block.py", size=size, cells=master)
    spaces = [fem.functionspace(m.dolfinx, ("Lagrange", degree)) for m in (up, low)]
    return trace_of(spaces[0], up, "bottom"), trace_of(spaces[1], low, "top")


@pytest.mark.smoke
@pytest.mark.mpi
@pytest.mark.parametrize("dim, slave, master", [(2, 6, 6), (2, 6, 9), (2, 7, 11), (2, 8, 5), (3, 2, 3), (3, 5, 3)])
@pytest.mark.parametrize("degree", [1, 2])
def test_polynomials_agree_on_both_sides(dim: int, slave: int, master: int, degree: int) -> None:
    a, b = pair(dim, slave, master, degree)
    m = mortar(a, b, Discontinuous(degree))
    along = [0] if dim == 2 else [0, 2]
    for f in (lambda x: 1 + 0 * x[:, 0], lambda x: x[:, along].sum(1), lambda x: x[:, 0] ** degree):
        assert np.abs(m.slave @ f(a.points) - m.master @ f(b.points)).max() < 2e-15
    assert m.covered == pytest.approx(1.0, abs=1e-12)
    assert abs(m.slave - m.multipliers.coupling()).max() < 1e-15


@pytest.mark.parametrize("dim", [2, 3])
def test_partial_overlap_ties_the_overlap_only(dim: int) -> None:
    a, b = pair(dim, 6, 4, shift=0.5)
    m = mortar(a, b, Continuous(ends=Ends.KEPT))
    assert m.covered == pytest.approx(0.5, abs=1e-12)
    assert m.multipliers.n == (4 if dim == 2 else 28)
    ones = m.slave @ np.ones(a.n) - m.master @ np.ones(b.n)
    assert np.abs(ones).max() < 1e-15
    assert m.slave.sum() == pytest.approx(0.5, abs=1e-12)


@pytest.mark.mpi
def test_surfaces_apart_are_refused_with_their_distance() -> None:
    a, b = pair(2, 4, 4, gap=0.7)
    with pytest.raises(InputError, match="do not overlap: their distance is 0.7 m"):
        mortar(a, b, Continuous())
    a, b = pair(2, 4, 4, shift=3.0)
    with pytest.raises(InputError, match="do not overlap: their distance is 2 m"):
        mortar(a, b, Continuous())


def test_coarse_slave_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    a, b = pair(2, 2, 8)
    with caplog.at_level(logging.WARNING, "fmbd_fenicsx"):
        mortar(a, b, Continuous())
    assert "choose the finer side as slave" in caplog.text


def test_small_gap_is_bridged_along_the_normal() -> None:
    a, b = pair(2, 4, 6, gap=1e-3)
    m = mortar(a, b, Continuous())
    assert m.gap == pytest.approx(1e-3, rel=1e-9)
    assert m.covered == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size, shift", [(2.0, 0.0), (2.0, 1.5), (0.01, 0.005)])
def test_the_covered_part_is_a_ratio(size: float, shift: float) -> None:
    from dolfinx import fem

    up = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(size, size), cells=8, origin=(shift, size))
    low = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(size, size), cells=6)
    upper, lower = (fem.functionspace(m.dolfinx, ("Lagrange", 1)) for m in (up, low))
    found = mortar(trace_of(upper, up, "bottom"), trace_of(lower, low, "top"), Continuous(1))
    assert found.covered == pytest.approx(1.0 - shift / size, abs=1e-12)
