"""Ties under refinement and together: spaces that fall like h, cross-points, dependent ties, the finer side first."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.traces.tie_stability import infsup_refined, infsup_together
from fmbd_fenicsx.fem.traces.traces import surface_trace

KEPT = fmbd.Continuous(ends=fmbd.Ends.KEPT)
LAW = fmbd.materials.linear_elastic(1.0, 0.3)


def block(name: str, dim: int = 2, cells: int = 3, degree: int = 1, origin: tuple[float, ...] = (0.0, 0.0, 0.0)):
    mesh = fmbd.read_gmsh(ROOT / "meshes/block.py", size=(1.0,) * dim, cells=cells, origin=origin[:dim])
    return fmbd.AbsoluteBody(name, mesh, degree=degree, density=1.0, elastic=LAW)


def held(body, *ties) -> fmbd.Scene:
    scene = fmbd.Scene("held")
    scene.add(body)
    for surface, space in ties:
        scene.add(fmbd.tie_surface(surface, body.surface(surface), fmbd.ground, space=space))
    return scene


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_a_refined_mesh_keeps_the_surface(dim: int) -> None:
    mesh = block("b", dim).mesh
    coarse, fine = surface_trace(mesh, "left"), surface_trace(mesh.refined(), "left")
    assert len(fine.nodes) == 2 ** (dim - 1) * len(coarse.nodes)
    assert fine.sizes.sum() == pytest.approx(coarse.sizes.sum(), rel=1e-12)
    assert np.abs(fine.points[:, 0]).max() < 1e-12


@pytest.mark.mpi
@pytest.mark.parametrize(
    "dim, degree, space, falls",
    [
        (2, 1, None, False),
        (2, 1, fmbd.Dual(), False),
        (2, 1, fmbd.Discontinuous(0), True),
        (2, 2, None, False),
        (2, 2, fmbd.Discontinuous(0), False),
        (2, 2, fmbd.Discontinuous(1), True),
        (3, 1, None, False),
        (3, 2, fmbd.Discontinuous(0), True),
    ],
)
def test_what_falls_like_h_is_noted_by_the_deep_check(dim: int, degree: int, space, falls: bool) -> None:
    cells = 2 if dim == 3 else 4
    scene = held(block("b", dim, cells, degree), ("left", space))
    assert infsup_refined(scene.ties["left"]).falls == falls
    notes = [n for n in scene.check(deep=True).notes if "tie" in n]
    assert len(notes) == falls and all('tie "left"' in n and "falls like h, UNSTABLE" in n for n in notes)
    assert not [n for n in scene.check().notes if "tie" in n]


@pytest.mark.mpi
def test_multipliers_that_see_no_displacement_are_refused() -> None:
    for space, count in ((fmbd.Discontinuous(1), "3 of 8"), (fmbd.Discontinuous(0), None)):
        scene = held(block("b", cells=4), ("left", space))
        if count is None:
            scene.build()
            continue
        with pytest.raises(InputError, match=f'Tie "left": {count} multiplier functions .* fail the inf-sup condition'):
            scene.build()


@pytest.mark.mpi
def test_two_ties_that_share_a_corner(caplog: pytest.LogCaptureFixture) -> None:
    """P1 multipliers with their ends count the corner twice: one zero mode a component, told in every way; merged ends do not."""
    bad = held(block("b"), ("left", KEPT), ("bottom", KEPT))
    found = bad.check(deep=True)
    assert found.redundant == 2
    assert any("all ties together" in n and "1 zero modes of 8" in n for n in found.notes)
    assert set(found.shares) == {"left", "bottom"}
    with caplog.at_level(logging.WARNING, "fmbd_fenicsx"):
        fmbd.solve(bad, t_end=0.02, dt=0.01)
    assert "depend on each other where their surfaces meet (2 redundant rows)" in caplog.text
    good = held(block("b"), ("left", None), ("bottom", None))
    found = good.check(deep=True)
    assert found.redundant == 0 and not [n for n in found.notes if "tie" in n]


def test_sliding_ties_count_their_normal_only() -> None:
    """Two rollers that meet at a corner hold different components there."""
    body = block("b")
    ties = [fmbd.tie_surface(s, body.surface(s), fmbd.ground, space=KEPT, sliding=True) for s in ("left", "bottom")]
    assert infsup_together(ties).zero_modes == 0
    full = [fmbd.tie_surface(s, body.surface(s), fmbd.ground, space=KEPT) for s in ("left", "bottom")]
    assert infsup_together(full).zero_modes == 1


@pytest.mark.mpi
def test_finer_first(caplog: pytest.LogCaptureFixture) -> None:
    coarse, fine = block("coarse", cells=2), block("fine", cells=5, origin=(0.0, 1.0, 0.0))
    assert fmbd.finer_first(coarse.surface("top"), fine.surface("bottom"))[0].body is fine
    assert fmbd.finer_first(fine.surface("bottom"), coarse.surface("top"))[0].body is fine
    # sizes that differ by roundoff, which depends on the ranks, exchange nothing
    one, two = block("one", cells=7), block("two", cells=7, origin=(100.1, 0.3, 0.0))
    for a, b in ((one.surface("top"), two.surface("top")), (two.surface("top"), one.surface("top"))):
        assert fmbd.finer_first(a, b) == (a, b)
    with pytest.raises(InputError, match="two surfaces of elastic bodies"):
        fmbd.finer_first(fine.surface("bottom"), fmbd.ground)
    for sides, warned in (
        ((coarse.surface("top"), fine.surface("bottom")), True),
        (fmbd.finer_first(coarse.surface("top"), fine.surface("bottom")), False),
    ):
        scene = fmbd.Scene("glued")
        scene.add(coarse, fine, fmbd.tie_surface("glue", *sides))
        caplog.clear()
        with caplog.at_level(logging.WARNING, "fmbd_fenicsx"):
            scene.build()
        assert ("choose the finer side as slave" in caplog.text) == warned


def test_ties_to_sections_of_rods_count_as_held() -> None:
    """A section moves as a rigid body: together with another tie, such a tie has no second mesh."""
    body, law = block("b"), {"youngs_modulus": 1.0, "poisson_ratio": 0.3, "density": 1.0, "width": 0.1, "height": 0.1}
    rod = fmbd.Rod("rod", [(1, 0.5, 0.5), (2, 0.5, 0.5)], fmbd.RodSection.rectangle(**law), elements=1)
    ties = [
        fmbd.tie_surface(s, body.surface(s), on) for s, on in (("left", fmbd.ground), ("right", rod.surface("start")))
    ]
    assert ties[1].surfaces == (ties[1].a,)
    assert infsup_together(ties).beta > 0.1
