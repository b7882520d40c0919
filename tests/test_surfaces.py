"""Moments of named surfaces against integrals by hand."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion import elastic_rod, elastic_scene

import fmbd_fenicsx as fmbd
from fmbd_fenicsx import dolfinx_compat
from fmbd_fenicsx.errors import InputError, MeshError
from fmbd_fenicsx.fem.fields import Field

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_area_centroid_and_weights(dim: int, degree: int, rod_mesh: Callable[..., Any]) -> None:
    H = 0.4
    mesh = rod_mesh(dim=dim, h=0.5, height=H)
    f = Field("rod", mesh, elastic_rod(mesh, degree=degree).forms())
    tip = f.moments("tip")
    assert abs(tip.area / H ** (dim - 1) - 1) < 1e-13
    assert np.abs(tip.center - [1.0, 0, 0][:dim]).max() < 1e-13
    sums = f.total(tip.weights.sum(0))
    assert abs(sums[0] - 1) < 1e-13  # a mean
    assert np.abs(sums[1:]).max() < 1e-13  # first moments of a constant about the centroid


@pytest.mark.smoke
@pytest.mark.parametrize("dim", [2, 3])
def test_moments_of_linear_and_quadratic_displacements(dim: int, rod_mesh: Callable[..., Any]) -> None:
    """mean(u) and mean(u_i (x_k - c_k)) l^-1 of u = (x + 3 y, y^2) over the tip x = 1, |y| < H/2."""
    H = 0.4
    mesh = rod_mesh(dim=dim, h=0.5, height=H)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    tip = f.moments("tip")
    x = f.X_world
    U = np.zeros((f.n, dim))
    U[:, 0], U[:, 1] = x[:, 0] + 3 * x[:, 1], x[:, 1] ** 2
    b = f.total(tip.weights.T @ U[tip.nodes])
    assert np.abs(b[0] - [1.0, H * H / 12, 0][:dim]).max() < 1e-13
    assert abs(b[2, 0] - 3 * H * H / 12 / tip.length) < 1e-13
    assert np.abs(b[1]).max() < 1e-13  # no extension along x


def test_surfaces_are_cached_and_used_once(rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    assert f.moments("tip") is f.moments("tip")


def test_unknown_surface_lists_near_names(rod_mesh: Callable[..., Any]) -> None:
    rod = elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4))
    with pytest.raises(InputError, match=r'"rod".*"tipp".*Did you mean "tip".*"pin", "side", "tip"'):
        rod.surface("tipp")


def test_attached_frame_needs_a_known_surface(rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match=r'"pinn".*Did you mean "pin"'):
        elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4), frame=fmbd.Attached("pinn"))


def test_joint_on_a_surface_without_facets_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """A name whose tag no facet carries: the integral would be silently zero."""
    from dataclasses import replace

    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    hollow = replace(mesh, surfaces={**mesh.surfaces, "ghost": 99})
    scene, rod, block = elastic_scene(hollow)
    scene.add(fmbd.revolute("pin", rod.surface("ghost"), block, center=(0, 0)))
    with pytest.raises(MeshError, match='"ghost".*no facets'):
        scene.build()


@pytest.mark.mpi
@pytest.mark.parametrize("width, refused", [(1e-4, False), (2e-13, True)])
def test_tiny_surfaces(width: float, refused: bool) -> None:
    """M5: one small facet carries a joint or a tie; one of less than 1e-12 of the length is refused by both."""
    import ufl
    from basix.ufl import element
    from dolfinx import mesh as dmesh
    from mpi4py import MPI

    from fmbd_fenicsx.errors import MeshError
    from fmbd_fenicsx.fem.mesh.mesh import Mesh

    here = MPI.COMM_WORLD.rank == 0
    x = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, width], [0.0, 1.0]]) if here else np.zeros((0, 2))
    cells = np.array([[0, 1, 3], [1, 2, 3]] if here else np.zeros((0, 3)), dtype=np.int64)
    msh = dmesh.create_mesh(MPI.COMM_WORLD, cells, x, ufl.Mesh(element("Lagrange", "triangle", 1, shape=(2,))))
    facets = dmesh.locate_entities_boundary(msh, 1, lambda x: np.isclose(x[0], 1.0))
    tags = dmesh.meshtags(msh, 1, np.sort(facets), np.full(len(facets), 1, dtype=np.int32))
    tip = Mesh(msh, tags, {"tip": 1}, "wedge", "the wedge")
    assert tip.extent == pytest.approx(1.0, abs=1e-14)
    ball = (lambda name, a, b: fmbd.spherical(name, a, b, center=(1.0, 0.0)), 2)
    tie = (fmbd.tie_surface, 4)  # on one facet its linear functions are added: they hold the rotation
    for joint, rows in (tie, ball):
        body = fmbd.AbsoluteBody("wedge", tip, degree=1, density=1.0, elastic=fmbd.materials.linear_elastic(1.0, 0.3))
        scene = fmbd.Scene("wedge")
        scene.add(body, joint("hold", body.surface("tip"), fmbd.ground))
        if refused:
            with pytest.raises(
                MeshError, match=r'Surface "tip" of the wedge has area 2e-13 m\^1, not more than 1e-12: too small'
            ):
                scene.build()
        else:
            assert scene.build()[0].n_lam == rows


def test_one_form_serves_all_weights(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Making forms is most of what a small body takes to set up."""
    made = []
    form = dolfinx_compat.form
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    f = Field("rod", mesh, elastic_rod(mesh).forms())
    monkeypatch.setattr(dolfinx_compat, "form", lambda x: (made.append(x), form(x))[1])
    f.moments("tip")
    assert len(made) == 1


NARROW = """
def build(gmsh, size, h=0.1):
    \"\"\"A bar of 1 m by 0.1 m with a piece of its left end by itself.\"\"\"
    g = gmsh.model.geo
    corners = [(0, -0.05, h), (1, -0.05, h), (1, 0.05, h), (0, 0.05, h), (0, size / 2, size), (0, -size / 2, size)]
    points = [g.addPoint(x, y, 0, near) for x, y, near in corners]
    lines = [g.addLine(a, b) for a, b in zip(points, points[1:] + points[:1])]
    bar = g.addPlaneSurface([g.addCurveLoop(lines)])
    g.synchronize()
    gmsh.model.addPhysicalGroup(2, [bar], name="bar")
    gmsh.model.addPhysicalGroup(1, [lines[4]], name="piece")
    gmsh.model.addPhysicalGroup(1, [lines[1]], name="tip")
    gmsh.model.mesh.generate(2)
"""


@pytest.mark.parametrize(("size", "narrow"), [(1e-2, False), (1e-5, True)])
def test_surfaces_on_which_bodies_turn_are_named(size: float, narrow: bool, tmp_path: Path) -> None:
    """A clamped piece that is too small to carry the weight: messages on the joint tell its size."""
    (tmp_path / "narrow.py").write_text(NARROW)
    mesh = fmbd.read_gmsh(tmp_path / "narrow.py", size=size)
    body = fmbd.FloatingBody("bar", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(1e9, 0.3))
    scene = fmbd.Scene("clamped")
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("piece")))
    system, _, _ = scene.build()
    assert system.block_of(system.n_rows - 1).told == f'joint "clamp" (fixed{", on a surface of 2.9e-06 m" * narrow})'


@pytest.mark.parametrize("size", [1e-4, 1e-6])
def test_a_bar_on_a_small_clamped_piece_hangs(size: float, tmp_path: Path) -> None:
    """Such a clamp holds its bar as a hinge of little stiffness does: it hangs, and does not stand on its head."""
    (tmp_path / "narrow.py").write_text(NARROW)
    mesh = fmbd.read_gmsh(tmp_path / "narrow.py", size=size)
    body = fmbd.FloatingBody("bar", mesh, density=1000.0, elastic=fmbd.materials.plane_stress(1e9, 0.3))
    scene = fmbd.Scene("clamped", gravity=(0.0, -9.81))
    scene.add(body, fmbd.fixed("clamp", fmbd.ground, body.surface("piece")))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    found = fmbd.equilibrium(scene)
    assert found["tip"][1] < -0.99
    # a bar on a hinge: sqrt(3 g / 2 L)
    assert fmbd.modes(scene, 1, at=found).omega == pytest.approx(np.sqrt(1.5 * 9.81), rel=1e-2)
