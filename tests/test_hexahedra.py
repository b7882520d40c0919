"""Faces of hexahedra: traces of quadrilaterals, ties and contact on them, beside those of tetrahedra."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_traces import ROOT

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.mixed import make_field
from fmbd_fenicsx.fem.traces.multipliers import Continuous, Dual
from fmbd_fenicsx.fem.traces.quadrilaterals import skew_of, unskewed
from fmbd_fenicsx.fem.traces.tie_stability import infsup_refined
from fmbd_fenicsx.fem.traces.traces import surface_trace

BLOCK = ROOT / "meshes/block.py"
PRISM = '''
def build(gmsh, h, z=0.0, radius=0.0, lift=0.0):
    """Unstructured quadrilaterals of a square or a disc, drawn along z to hexahedra; surfaces "low", "high"."""
    occ = gmsh.model.occ
    base = occ.addDisk(0, 0, z, radius, radius) if radius else occ.addRectangle(-0.5, -0.5, z, 1, 1)
    made = occ.extrude([(2, base)], 0, 0, 0.5, [2], recombine=True)
    occ.synchronize()
    gmsh.option.setNumber("Mesh.RecombineAll", 1)
    gmsh.option.setNumber("Mesh.Algorithm", 8)
    gmsh.option.setNumber("Mesh.MeshSizeMin", h)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.addPhysicalGroup(3, [tag for dim, tag in made if dim == 3], name="prism")
    gmsh.model.addPhysicalGroup(2, [base], name="low")
    gmsh.model.addPhysicalGroup(2, [made[0][1]], name="high")
    gmsh.model.mesh.generate(3)
    if lift:  # one node of each face out of its plane
        tags, x, _ = gmsh.model.mesh.getNodes(2, made[0][1])
        gmsh.model.mesh.setNode(tags[0], [x[0], x[1], x[2] + lift], [])
'''


@pytest.fixture
def prism(tmp_path: Path) -> Path:
    path = tmp_path / "prism.py"
    path.write_text(PRISM)
    return path


def block(
    quads: bool, counts: tuple[int, ...], x: float = 0.0, *, size: tuple[float, ...] = (1.0, 0.5, 0.5)
) -> fmbd.Mesh:
    return fmbd.read_gmsh(BLOCK, size=size, counts=counts, quads=quads, origin=(x, 0.0, 0.0)[: len(size)])


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("regular", [True, False])
def test_integrals_on_a_face(degree: int, regular: bool, prism: Path) -> None:
    """Areas, int grad y . grad y and int y^2 of y, and the nodes of the border of a square."""
    mesh = block(True, (1, 3, 4), size=(1.0, 1.0, 1.0)) if regular else fmbd.read_gmsh(prism, h=0.2)
    t = surface_trace(mesh, "right" if regular else "high", degree)
    y = t.points[:, 1]
    assert bool(t.skew.any()) is not regular
    assert t.sizes.sum() == pytest.approx(1.0, rel=1e-12)
    assert y @ (t.stiffness() @ y) == pytest.approx(1.0, rel=1e-10)
    assert y @ (t.mass() @ y) == pytest.approx(1 / 3 if regular else 1 / 12, rel=1e-10)
    on_edge = np.isclose(np.abs(t.points[:, 1:] - 0.5) if regular else np.abs(t.points[:, :2]), 0.5).any(axis=1)
    np.testing.assert_array_equal(t.border, np.flatnonzero(on_edge))


def test_places_in_a_quadrilateral() -> None:
    """(xi, eta) of points of a strongly distorted one, nearly a triangle."""
    corners = np.array([[[0.0, 0.0], [1.0, 0.1], [0.2, 1.0], [0.63, 0.58]]])
    rng = np.random.default_rng(1)
    xi, eta = (rng.random((2, 50)) * 0.5)[:, None]
    a, b = skew_of(corners)[0]
    found = unskewed(np.stack((xi + a * xi * eta, eta + b * xi * eta), axis=2), np.array([[a, b]]))
    np.testing.assert_allclose(found, np.stack((xi, eta), axis=2), atol=1e-12)


def strains(a: Any, b: Any, ends: tuple[str, str], axis: int, degree: int) -> float:
    """A bar of two tied parts under a uniform stress: the largest error of the strains at both sides, over the strain."""
    modulus, pull = 3.0, 0.3
    one = fmbd.FloatingBody("one", a, degree=degree, density=1.0, elastic=fmbd.materials.linear_elastic(modulus, 0.25))
    stress = pull * np.eye(3)[axis]
    two = one.with_(name="two", mesh=b, loads=[fmbd.loads.traction(ends[1], stress)])
    scene = fmbd.Scene("bar")
    tie = fmbd.tie_surface("tie", *fmbd.finer_first(one.surface(ends[1]), two.surface(ends[0])))
    scene.add(one, two, tie, fmbd.fixed("clamp", fmbd.ground, one.surface(ends[0])))
    near = 1.0 if axis == 0 else 0.5
    for body, off in ((one, -0.03), (two, 0.02)):
        point = np.array([0.07, 0.11, 0.13])
        point[axis] = near + off
        scene.sensor(body.name, fmbd.sensors.strain(body, point=point))
    found = fmbd.equilibrium(scene)
    exact = pull / modulus * np.concatenate((np.where(np.arange(3) == axis, 1.0, -0.25), np.zeros(3)))
    return max(float(np.abs(np.ravel(found[name]) - exact).max()) for name in ("one", "two")) * modulus / pull


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kinds", [(True, True), (True, False), (False, True)], ids=["hex-hex", "hex-tet", "tet-hex"])
def test_patch_of_meshes_that_do_not_match(kinds: tuple[bool, bool], degree: int) -> None:
    a, b = block(kinds[0], (3, 2, 2)), block(kinds[1], (4, 3, 3), 1.0)
    assert strains(a, b, ("left", "right"), 0, degree) < 1e-11


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
def test_patch_of_unstructured_quadrilaterals(degree: int, prism: Path) -> None:
    a, b = fmbd.read_gmsh(prism, h=0.2), fmbd.read_gmsh(prism, h=0.28, z=0.5)
    assert strains(a, b, ("low", "high"), 2, degree) < 1e-11


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_stiffness_takes_as_many_points_as_serve(degree: int) -> None:
    """p + 1 in each direction: those of parallelepipeds are exact. The map had one more, 2.4 times the time for p = 2."""
    law, found = fmbd.materials.linear_elastic(1e6, 0.3), []
    for quadrature in (None, 2 * degree + 4):
        body = fmbd.AbsoluteBody(
            "b", block(True, (2, 1, 1)), degree=degree, density=1.0, elastic=law, quadrature=quadrature
        )
        field = make_field("b", body.mesh, body.forms())
        found.append(field.K.getValuesCSR()[2])
        if quadrature is None:
            assert field.elastic_measure.metadata()["quadrature_degree"] == 2 * degree + 1
    assert np.abs(found[0] - found[1]).max() < 1e-13 * np.abs(found[0]).max()


def test_patch_of_distorted_quadrilaterals(prism: Path) -> None:
    # where functions are no polynomials quadrature is not exact: cells of a disc with (a, b) up to 0.58
    a, b = (fmbd.read_gmsh(prism, h=0.3, radius=0.5, z=z) for z in (0.0, 0.5))
    assert np.abs(surface_trace(a, "high").skew).max() > 0.5
    assert strains(a, b, ("low", "high"), 2, 2) < 1e-6


@pytest.mark.parametrize(("degree", "least"), [(1, 0.5), (2, 0.85), (3, 0.75)])
def test_default_spaces_are_stable(degree: int, least: float) -> None:
    found = [
        fmbd.infsup((block(True, (n, n, n), size=(1.0, 1.0, 1.0)), "right"), degree=degree).constant for n in (2, 4)
    ]
    assert min(found) > least


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
def test_a_deep_check_refines_them(dim: int) -> None:
    law = fmbd.materials.linear_elastic(1e6, 0.3)
    body = fmbd.AbsoluteBody("b", block(True, (3, 2, 2)[:dim], size=(1.0, 0.5, 0.5)[:dim]), density=1.0, elastic=law)
    scene = fmbd.Scene("clamped")
    scene.add(body, fmbd.tie_surface("clamp", body.surface("left"), fmbd.ground))
    scene.check(deep=True)
    tie = scene.ties["clamp"]
    found = infsup_refined(tie)
    assert found.stable
    assert found.fine.h == pytest.approx(0.5 * found.coarse.h)


@pytest.mark.mpi
def test_a_field_clamp_of_a_cantilever_in_time() -> None:
    """A floating beam in hexahedra and in tetrahedra, clamped by fields: the same motion of the tip."""
    ends = []
    for quads, degree in ((True, 2), (False, 3)):
        body = fmbd.FloatingBody(
            "beam",
            block(quads, (8, 2, 2), size=(1.0, 0.1, 0.1)),
            degree,
            density=1e3,
            elastic=fmbd.materials.linear_elastic(1e7, 0.3),
        )
        scene = fmbd.Scene("beam", gravity=(0, 0, -9.81))
        scene.add(body, fmbd.tie_surface("clamp", body.surface("left"), fmbd.ground))
        scene.sensor("tip", fmbd.position(body.surface("right")))
        ends.append(fmbd.solve(scene, t_end=0.2, dt=2e-3)["tip"])
    sag = np.ptp(ends[0], axis=0).max()
    assert np.abs(ends[0] - ends[1]).max() < 5e-3 * sag


@pytest.mark.mpi
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kinds", [(True, True), (True, False)], ids=["hex-hex", "hex-tet"])
def test_contact_passes_a_uniform_pressure(degree: int, kinds: tuple[bool, bool]) -> None:
    law = fmbd.materials.linear_elastic(1e6, 0.0)
    low = fmbd.AbsoluteBody("low", block(kinds[0], (3, 2, 2)), degree=degree, density=1e3, elastic=law)
    up = low.with_(name="up", mesh=block(kinds[1], (3, 3, 3), 1.0), loads=[fmbd.loads.traction("right", (-1e3, 0, 0))])
    scene = fmbd.Scene("pressed")
    scene.add(low, up, fmbd.fixed("clamp", fmbd.ground, low.surface("left")))
    scene.add(fmbd.prismatic("guide", fmbd.ground, up.surface("right"), axis=(1, 0, 0)))
    scene.add(fmbd.contact("touch", up.surface("left"), low.surface("right")))
    scene.sensor("force", fmbd.contact_force("touch"))
    scene.sensor("end", fmbd.position(up.surface("right")))
    found = fmbd.equilibrium(scene)
    assert np.abs(found["force"]) == pytest.approx((250.0, 0.0, 0.0), rel=1e-8, abs=1e-6)
    assert found["end"][0] == pytest.approx(2.0 - 2e-3, rel=1e-9)


@pytest.mark.mpi
def test_faces_that_are_refused(prism: Path) -> None:
    warped = fmbd.read_gmsh(prism, h=0.3, lift=0.01)
    with pytest.raises(InputError, match='surface "high".*curved or warped .nodes are up to 0.0.*tetrahedra'):
        surface_trace(warped, "high")
    with pytest.raises(InputError, match=r'surface "right".*dual multipliers.*Continuous\(1\)'):
        Dual().on(surface_trace(block(True, (1, 2, 2)), "right"))
    assert Continuous(1).on(surface_trace(block(True, (1, 2, 2)), "right")).n == 1
