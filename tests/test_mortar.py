"""Mortar integrals: exact on flat surfaces, partial overlap, symmetric in ranks, clear errors."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.mortar import Mortar, mortar
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Discontinuous, Ends
from fmbd_fenicsx.fem.traces.traces import surface_trace, trace_of


def pair(dim: int, slave: int, master: int, degree: int = 1, shift: float = 0.0, gap: float = 0.0):
    from dolfinx import fem

    size = (1.0, 1.0, 1.0)[:dim]
    up = fmbd.read_gmsh(ROOT / "meshes/block.py", size=size, cells=slave, origin=(shift, 1.0 + gap, 0.0)[:dim])
    low = fmbd.read_gmsh(ROOT / "meshes/block.py", size=size, cells=master)
    spaces = [fem.functionspace(m.dolfinx, ("Lagrange", degree)) for m in (up, low)]
    return trace_of(spaces[0], up, "bottom"), trace_of(spaces[1], low, "top")


def covered(m: Mortar) -> float:
    """The part of the slave's area that both surfaces share: multipliers sum up to one, and so do functions of nodes."""
    return m.slave.sum() / m.multipliers.trace.sizes.sum()


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
    assert covered(m) == pytest.approx(1.0, abs=1e-12)
    assert abs(m.slave - m.multipliers.coupling()).max() < 1e-15


def second_order(folder: Path, mesh: str, **of: Any) -> Any:
    """A mesh of this clone with cells of the second order."""
    script = folder / f"second_{mesh}"
    script.write_text(
        "import runpy\n\n\ndef build(gmsh, **of):\n"
        f"    runpy.run_path({str(ROOT / 'meshes' / mesh)!r})['build'](gmsh, **of)\n    gmsh.model.mesh.setOrder(2)\n"
    )
    return fmbd.read_gmsh(script, **of)


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kinds", [(True, True), (True, False), (False, True)])
def test_quadrilaterals_and_cells_of_the_second_order_pass_the_patch_test(
    kinds: tuple[bool, bool], degree: int, shared_tmp: Path
) -> None:
    """A bar of two parts whose meshes do not match, pulled: the strain of each is the stress over the modulus."""
    modulus, pull = 3.0, 0.3
    law = fmbd.materials.plane_stress(modulus, 0.25)
    size: dict[str, Any] = {"size": (1.0, 0.5)}
    left = fmbd.read_gmsh(ROOT / "meshes/block.py", counts=(3, 2), quads=kinds[0], **size)
    right = second_order(shared_tmp, "block.py", counts=(4, 3), quads=kinds[1], origin=(1.0, 0.0), **size)
    a = fmbd.FloatingBody("a", left, degree=degree, density=1.0, elastic=law)
    b = a.with_(name="b", mesh=right, loads=[fmbd.traction("right", (pull, 0.0))])
    scene = fmbd.Scene("patch")
    tie = fmbd.tie_surface("tie", *fmbd.finer_first(a.surface("right"), b.surface("left")))
    scene.add(a, b, tie, fmbd.fixed("clamp", fmbd.ground, a.surface("left")))
    for name, body in (("a", a), ("b", b)):
        scene.sensor(name, fmbd.sensors.strain(body, point=(1.02 if name == "b" else 0.97, 0.1)))
    found = fmbd.equilibrium(scene)
    for name in ("a", "b"):
        np.testing.assert_allclose(np.ravel(found[name]), pull / modulus * np.array([1.0, -0.25, 0.0]), atol=1e-9)


@pytest.mark.mpi
def test_facets_without_a_plain_trace_say_what_to_do(shared_tmp: Path) -> None:
    disk = second_order(shared_tmp, "half_ball.py", dim=2, radius=1.0, h=0.3, near=0.5, coarse=0.3)
    with pytest.raises(
        InputError, match=r'surface "contact".*its facets are curved .nodes are up to 0.0\d+ of their size'
    ):
        surface_trace(disk, "contact")


@pytest.mark.parametrize("dim", [2, 3])
def test_partial_overlap_ties_the_overlap_only(dim: int) -> None:
    a, b = pair(dim, 6, 4, shift=0.5)
    m = mortar(a, b, Continuous(ends=Ends.KEPT))
    assert covered(m) == pytest.approx(0.5, abs=1e-12)
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
    assert covered(m) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("size, shift", [(2.0, 0.0), (2.0, 1.5), (0.01, 0.005)])
def test_the_covered_part_is_a_ratio(size: float, shift: float) -> None:
    from dolfinx import fem

    up = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(size, size), cells=8, origin=(shift, size))
    low = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(size, size), cells=6)
    upper, lower = (fem.functionspace(m.dolfinx, ("Lagrange", 1)) for m in (up, low))
    found = mortar(trace_of(upper, up, "bottom"), trace_of(lower, low, "top"), Continuous(1))
    assert covered(found) == pytest.approx(1.0 - shift / size, abs=1e-12)
