"""Elastic bodies against exact solutions and their own refinement: patch test, thin bodies, Cook's membrane, quadrature."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.mesh.mesh import Mesh
from fmbd_fenicsx.fem.mixed import make_field
from fmbd_fenicsx.materials import (
    linear_elastic,
    nearly_incompressible,
    neo_hookean,
    plane_stress,
    saint_venant_kirchhoff,
)
from fmbd_fenicsx.rotations import Array


def sheet(shape: Callable[[Array], Array], nx: int, ny: int, kind: str = "crossed") -> Mesh:
    """The unit square, mapped, of crossed triangles, halved cells or quadrilaterals; surfaces "left" (s = 0), "right" (s = 1)."""
    from dolfinx import mesh
    from mpi4py import MPI

    diagonal = mesh.DiagonalType.crossed if kind == "crossed" else mesh.DiagonalType.right
    cell = mesh.CellType.quadrilateral if kind == "quadrilaterals" else mesh.CellType.triangle
    msh = mesh.create_rectangle(MPI.COMM_SELF, [[0.0, 0.0], [1.0, 1.0]], [nx, ny], cell, diagonal=diagonal)
    ends = [mesh.locate_entities_boundary(msh, 1, lambda x, s=s: np.isclose(x[0], s)) for s in (0.0, 1.0)]
    facets, tags = np.concatenate(ends), np.repeat([1, 2], [len(e) for e in ends]).astype(np.int32)
    order = np.argsort(facets)
    found = mesh.meshtags(msh, 1, facets[order], tags[order])
    msh.geometry.x[:, :2] = shape(msh.geometry.x[:, :2].T).T
    return Mesh(msh, found, {"left": 1, "right": 2}, "sheet", "sheet")


def loaded(mesh: Mesh, elastic: Any, degree: int, at: tuple[float, float]) -> float:
    """Vertical displacement of the node at a point, for a unit vertical force on "right", "left" clamped."""
    from dolfinx import fem
    from petsc4py import PETSc

    body = fmbd.FloatingBody("sheet", mesh, degree=degree, elastic=elastic, density=1.0)
    field = make_field("sheet", mesh, body.forms())
    held = fem.locate_dofs_topological(field.space, 1, mesh.facet_tags.find(1))
    fixed = (held[:, None] * 2 + np.arange(2)).ravel().astype(np.int32)
    A = field.combination(0.0, 1.0)
    A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    y, b = A.createVecs()
    moments = field.moments("right")
    force = np.zeros((field.n, 2))
    force[moments.nodes, 1] = moments.weights[:, 0]
    b.array[:] = 0.0
    b.array[: force.size] = force.ravel()
    b.array[fixed] = 0.0
    A.zeroRowsColumns(fixed)
    ksp = PETSc.KSP().create(field.comm)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    ksp.solve(b, y)
    node = int(np.argmin(np.linalg.norm(field.X_world - np.array(at), axis=1)))
    assert np.linalg.norm(field.X_world[node] - np.array(at)) < 1e-9
    out = float(y.array[2 * node + 1])
    for obj in (A, y, b, ksp):
        obj.destroy()
    field.destroy()
    return out


# -- slender bodies ------------------------------------------------------------------------------------------
def cantilever(height: float, nx: int, ny: int, degree: int) -> float:
    """Tip deflection over that of Timoshenko's beam, E = 1, nu = 0, length 1."""
    mesh = sheet(lambda x: np.stack((x[0], height * (x[1] - 0.5))), nx, ny)
    beam = 4.0 / height**3 + 2.4 / height  # F l^3 / (3 E I) + F l / (5/6 G A)
    return loaded(mesh, plane_stress(1.0, 0.0), degree, (1.0, 0.0)) / beam


@pytest.mark.serial
@pytest.mark.parametrize("height", [0.1, 0.01, 0.001])
def test_slender_bodies(height: float) -> None:
    """P2 stays within half a percent down to 1:1000, first-order cells lose it all.

    At 1:1000 roundoff in K (its condition grows with aspect and cells) is the larger part of the error: 32 cells give 0.6 %.
    """
    thick = cantilever(height, 16, 1, 2)
    assert abs(thick - 1.0) < 5e-3
    assert cantilever(height, 16, 2, 1) < 0.9


@pytest.mark.serial
@pytest.mark.parametrize(("nx", "ny"), [(8, 1), (24, 1), (16, 4), (24, 3)])
@pytest.mark.parametrize("kind", ["crossed", "halved", "quadrilaterals"])
def test_first_order_cells_say_how_much_too_stiff_they_are(caplog: Any, kind: str, nx: int, ny: int) -> None:
    """What is told of a leaf of 1 : 50 is what its deflection shows (an upper bound where inner nodes give); P2 tells nothing."""
    mesh = sheet(lambda x: np.stack((x[0], 0.02 * (x[1] - 0.5))), nx, ny, kind)
    beam = 4.0 / 0.02**3 + 2.4 / 0.02
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        soft = loaded(mesh, plane_stress(1.0, 0.0), 2, (1.0, -0.01)) / beam
        assert not caplog.records
        assert abs(soft - 1.0) < 0.01
        stiff = loaded(mesh, plane_stress(1.0, 0.0), 1, (1.0, -0.01)) / beam
    (told,) = [r.args[1] for r in caplog.records if "too stiff in bending" in r.getMessage()]  # type: ignore[index]
    assert told * stiff > 0.95
    if kind != "crossed":
        assert told * stiff < 1.15


@pytest.mark.serial
def test_compact_and_fine_bodies_of_the_first_order_are_not_warned_of(caplog: Any) -> None:
    for shape, nx, ny in ((1.0, 4, 4), (0.25, 2, 1), (0.1, 80, 8)):
        mesh = sheet(lambda x, h=shape: np.stack((x[0], h * x[1])), nx, ny)
        body = fmbd.FloatingBody("leaf", mesh, degree=1, density=1.0, elastic=plane_stress(1.0, 0.3))
        with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
            make_field("leaf", mesh, body.forms()).destroy()
    assert not caplog.records


# -- patch test ----------------------------------------------------------------------------------------------
@pytest.mark.serial
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", ["linear", "mixed", "large strain"])
def test_constant_strain_on_distorted_cells(degree: int, kind: str) -> None:
    """A homogeneous deformation leaves no force on inner nodes, to 1e-13 of E |u|, the size of what cancels there."""
    if kind == "mixed" and degree == 1:
        pytest.skip("displacement and pressure need degree 2")
    mesh = sheet(lambda x: x, 4, 4)
    x = mesh.dolfinx.geometry.x
    inner = (np.abs(x[:, :2] - 0.5) < 0.49).all(axis=1)
    x[inner, :2] += 0.05 * np.random.default_rng(1).uniform(-1, 1, (inner.sum(), 2))
    options = {"energy": saint_venant_kirchhoff(1.0, 0.3)} if kind == "large strain" else {
        "elastic": (nearly_incompressible if kind == "mixed" else linear_elastic)(1.0, 0.3)
    }  # fmt: skip
    body = fmbd.AbsoluteBody("sheet", mesh, degree=degree, density=1.0, **options)  # type: ignore[arg-type]
    field = make_field("sheet", mesh, body.forms())
    gradient = np.array([[0.02, 0.05], [-0.01, 0.03]])
    U = field.X @ gradient.T
    force = np.abs(field.internal(U.ravel())).reshape(-1, 2)
    edge = (np.abs(field.X_world - 0.5) > 0.5 - 1e-9).any(axis=1)
    assert force[~edge].max() < 1e-13 * np.abs(U).max()
    assert force[edge].max() > 0.01 * np.abs(U).max()
    field.destroy()


# -- Cook's membrane -----------------------------------------------------------------------------------------
def cook(n: int, elastic: Any, degree: int, kind: str = "crossed") -> float:
    """Deflection (up) at the middle of the right edge of the tapered panel of 48 by 44 to 16."""
    mesh = sheet(lambda x: np.stack((48.0 * x[0], 44.0 * x[0] + x[1] * (44.0 - 28.0 * x[0]))), n, n, kind)
    return loaded(mesh, elastic, degree, (48.0, 52.0))


@pytest.mark.serial
def test_cook_in_plane_stress() -> None:
    """P2 on 16 x 16 crossed cells: 23.97 to 0.1 %."""
    assert abs(cook(16, plane_stress(1.0, 1 / 3), 2) / 23.97 - 1) < 1e-3


@pytest.mark.serial
def test_cook_as_the_equilibrium_of_a_scene() -> None:
    """The same panel tied to the ground, 1e-3 of the load: 23.97e-3 to 0.1 %."""
    mesh = sheet(lambda x: np.stack((48.0 * x[0], 44.0 * x[0] + x[1] * (44.0 - 28.0 * x[0]))), 16, 16)
    panel = fmbd.AbsoluteBody("panel", mesh, degree=2, density=1.0, elastic=plane_stress(1.0, 1 / 3))
    scene = fmbd.Scene("cook")
    scene.add(panel, fmbd.tie_surface("clamp", panel.surface("left"), fmbd.ground))
    scene.add(fmbd.force("shear", panel.surface("right"), lambda t: (0.0, 1e-3)))
    found = fmbd.equilibrium(scene)

    ((k, part),) = found.system.fields
    node = int(np.argmin(np.linalg.norm(part.field.X_world - (48.0, 52.0), axis=1)))
    up = found.system.local_q(found.state.q, k).reshape(-1, 2)[node, 1]
    assert abs(up / 23.97e-3 - 1) < 1e-3


@pytest.mark.serial
def test_cook_nearly_incompressible() -> None:
    """nu = 0.4999: displacement and pressure rise monotonously to their own finest result; P1 stays far below.

    (Crossed P1 cells do not lock: their corners have a divergence to spare.)
    """
    mixed = [cook(n, nearly_incompressible(1.0, 0.4999), 2) for n in (4, 8, 16, 32)]
    assert mixed == sorted(mixed)
    assert abs(mixed[1] / mixed[-1] - 1) < 0.02
    assert abs(mixed[2] / mixed[-1] - 1) < 0.005
    assert cook(16, linear_elastic(1.0, 0.4999), 1, kind="halved") < 0.7 * mixed[-1]


# -- quadrature ----------------------------------------------------------------------------------------------
@pytest.mark.mpi
def test_doubling_the_quadrature_degree_changes_nothing(rod_mesh: Callable[..., Any]) -> None:
    """A soft neo-Hookean pendulum: 4 against 8, tip and energy to 1e-6 of their size."""
    found = []
    for degree in (4, 8):
        body = fmbd.AbsoluteBody(
            "rod", rod_mesh(dim=2, h=0.25, height=0.25), density=1e3, energy=neo_hookean(1e6, 0.3), quadrature=degree
        )
        scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81))
        scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
        scene.sensor("tip", fmbd.position(body.surface("tip")))
        run = fmbd.solve(scene, t_end=0.2, dt=0.02)
        found.append((run["tip"], run.energy["elastic"]))
    for a, b in zip(*found, strict=True):
        assert np.abs(a - b).max() < 1e-6 * np.abs(a).max()
    assert found[0][1].max() > 1.0  # J: the rod is strained


def test_an_energy_has_one_rule_of_no_more_than_serves(rod_mesh: Callable[..., Any]) -> None:
    """UFL's estimates of neo-Hookean energy, forces and tangent are 16, 22 and 44: what is left is one rule of degree 4."""
    from fmbd_fenicsx.energies import StoredEnergy

    degrees: list[Any] = []

    class Seen(StoredEnergy):
        def __call__(self, u: Any, dx: Any) -> Any:
            degrees.append(dx.metadata().get("quadrature_degree"))
            return super().__call__(u, dx)

    mesh = rod_mesh(dim=2, h=0.5, height=0.4)
    for law, last in ((neo_hookean(1e6, 0.3), 4), (saint_venant_kirchhoff(1e6, 0.3), None)):
        body = fmbd.AbsoluteBody("rod", mesh, density=1e3, energy=Seen(law.density))
        scene = fmbd.Scene("rule")
        scene.add(body)
        fmbd.solve(scene, t_end=0.01, dt=0.01)
        assert degrees[-1] == last


def test_the_rule_of_an_energy_serves_where_strains_are_large() -> None:
    """A neo-Hookean beam bent by a radian: what its rule leaves is below a hundredth of what half the mesh size changes."""
    law, tips = neo_hookean(1e6, 0.45), []
    for n, quadrature in ((1, None), (1, 10), (2, 10)):
        mesh = fmbd.read_gmsh("meshes/block.py", size=(1.0, 0.2), counts=(5 * n, n))
        pull = fmbd.loads.traction("right", (0.0, -2e4))
        beam = fmbd.AbsoluteBody("beam", mesh, density=1.0, energy=law, loads=[pull], quadrature=quadrature)
        scene = fmbd.Scene("bent")
        scene.add(beam, fmbd.tie_surface("clamp", beam.surface("left"), fmbd.ground))
        scene.sensor("tip", fmbd.position(beam.surface("right")))
        tips.append(np.ravel(fmbd.equilibrium(scene)["tip"]))
    assert tips[1][1] < -0.6
    assert np.abs(tips[0] - tips[1]).max() < 0.01 * np.abs(tips[2] - tips[1]).max()


# -- bad input -----------------------------------------------------------------------------------------------
@pytest.mark.mpi
def test_energy_that_is_not_finite_at_the_start(rod_mesh: Callable[..., Any]) -> None:
    """All points on a line: det F = 0, ln J has no value."""
    body = fmbd.AbsoluteBody(
        "rod",
        rod_mesh(dim=2, h=0.5, height=0.4),
        density=1.0,
        energy=neo_hookean(1e6, 0.3),
        displacement=lambda X: np.stack((0 * X[0], -X[1])),
    )
    scene = fmbd.Scene("flat")
    scene.add(body)
    with pytest.raises(InputError, match='"rod": its elastic energy is .* at the start'):
        scene.build()


@pytest.mark.mpi
def test_interface_without_facets() -> None:
    """A surface that is named in the mesh but lies nowhere on the boundary."""
    from dolfinx import mesh
    from mpi4py import MPI

    msh = mesh.create_rectangle(MPI.COMM_WORLD, [[0.0, 0.0], [1.0, 1.0]], [2, 2])
    none = np.zeros(0, dtype=np.int32)
    empty = Mesh(msh, mesh.meshtags(msh, 1, none, none), {"nose": 7}, "square", "square")
    body = fmbd.FloatingBody("square", empty, density=1.0, elastic=linear_elastic(1.0, 0.3))
    with pytest.raises(InputError, match='"nose".*no facets'):
        _ = body.reduced(basis=fmbd.CraigBampton(("nose",), 2)).constants
