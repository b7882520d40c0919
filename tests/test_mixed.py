"""Displacement and pressure: no locking up to nu = 1/2, the same bodies as displacement forms away from it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.mesh.mesh import Mesh
from fmbd_fenicsx.fem.mixed import make_field
from fmbd_fenicsx.materials import linear_elastic, nearly_incompressible, neo_hookean, neo_hookean_mixed
from fmbd_fenicsx.mechanics.elastic.modes import quadratic_fields

ROOT = Path(__file__).resolve().parents[1]

MODULUS, DENSITY = 5e6, 1000.0


def floating(mesh: Any, elastic: Any) -> fmbd.FloatingBody:
    return fmbd.FloatingBody("rod", mesh, density=DENSITY, elastic=elastic)


def pendulum(body: Any) -> fmbd.Scene:
    scene = fmbd.Scene("pendulum", gravity=(0.0, -9.81, 0.0)[: body.dim])
    scene.add(body, fmbd.revolute("pin", body.surface("pin"), fmbd.ground))
    scene.sensor("tip", fmbd.position(body.surface("tip")))
    return scene


def square_error(n: int, nu: float, elastic: Any, degree: int) -> float:
    """H1 error of a divergence-free displacement of the clamped unit square, over its H1 seminorm."""
    import ufl
    from dolfinx import fem, mesh
    from mpi4py import MPI
    from petsc4py import PETSc

    msh = mesh.create_unit_square(MPI.COMM_SELF, n, n)
    body = Mesh(msh, None, {}, "square", "unit square")
    forms = fmbd.FloatingBody("square", body, degree=degree, density=1.0, elastic=elastic).forms()
    field = make_field("square", body, forms)
    x = ufl.SpatialCoordinate(msh)
    pi = np.pi
    exact = ufl.as_vector(
        (ufl.sin(pi * x[0]) ** 2 * ufl.sin(2 * pi * x[1]), -ufl.sin(2 * pi * x[0]) * ufl.sin(pi * x[1]) ** 2)
    )
    mu = 1.0 / (2 * (1 + nu))
    v = ufl.TestFunction(field.space)
    load = fem.assemble_vector(fem.form(ufl.inner(2 * mu * ufl.sym(ufl.grad(exact)), ufl.grad(v)) * ufl.dx))
    msh.topology.create_connectivity(1, 2)
    edge = fem.locate_dofs_topological(field.space, 1, mesh.exterior_facet_indices(msh.topology))
    fixed = (edge[:, None] * 2 + np.arange(2)).ravel().astype(np.int32)
    A = field.combination(0.0, 1.0)
    A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
    y, b = A.createVecs()
    b.array[:] = 0.0
    b.array[: len(load.array)] = load.array
    b.array[fixed] = 0.0
    A.zeroRowsColumns(fixed)
    ksp = PETSc.KSP().create(MPI.COMM_SELF)
    ksp.setOperators(A)
    ksp.setType("preonly")
    ksp.getPC().setType("lu")
    ksp.getPC().setFactorSolverType("mumps")
    ksp.solve(b, y)
    u = fem.Function(field.space)
    u.x.array[:] = y.array[: len(u.x.array)]
    gap = fem.assemble_scalar(fem.form(ufl.inner(ufl.grad(u - exact), ufl.grad(u - exact)) * ufl.dx))
    size = fem.assemble_scalar(fem.form(ufl.inner(ufl.grad(exact), ufl.grad(exact)) * ufl.dx(msh)))
    for obj in (A, y, b, ksp):
        obj.destroy()
    field.destroy()
    return float(np.sqrt(gap / size))


@pytest.mark.serial
def test_no_locking() -> None:
    """The error at nu = 0.4999999 and 0.5 is that at 0.3 (within 10 %), of second order; P2 displacements lose an order."""
    mixed = {
        nu: [square_error(n, nu, nearly_incompressible(1.0, nu), 2) for n in (8, 16)] for nu in (0.3, 0.4999999, 0.5)
    }
    for nu in (0.4999999, 0.5):
        assert mixed[nu][1] <= 1.1 * mixed[0.3][1]
        assert np.log2(mixed[nu][0] / mixed[nu][1]) > 1.9
    displacement = [square_error(n, 0.499999, linear_elastic(1.0, 0.499999), 2) for n in (8, 16)]
    assert np.log2(displacement[0] / displacement[1]) < 1.3
    locked = square_error(16, 0.499999, linear_elastic(1.0, 0.499999), 1)
    assert locked > 0.9


@pytest.mark.smoke
@pytest.mark.mpi
def test_products_and_energy(rod_mesh: Callable[..., Any]) -> None:
    """K u and the energy at nu = 0.3 are close to those of the displacement form, and K is the energy's second derivative."""
    mesh = rod_mesh(dim=2, h=0.1)
    mixed = make_field("rod", mesh, floating(mesh, nearly_incompressible(MODULUS, 0.3)).forms())
    plain = Field("rod", mesh, floating(mesh, linear_elastic(MODULUS, 0.3)).forms())
    x, y = mixed.X.T
    u = np.stack((-2 * x * y, x**2), axis=1).ravel()
    np.testing.assert_allclose(mixed.energy(u), plain.energy(u), rtol=1e-6)
    rng = np.random.default_rng(mixed.comm.rank)
    v = rng.standard_normal(len(u))
    assert mixed.energy(v) <= plain.energy(v)
    np.testing.assert_allclose(
        mixed.total(np.array(v @ mixed.stiffness(u))), mixed.total(np.array(u @ mixed.stiffness(v)))
    )
    mixed.destroy()
    plain.destroy()


@pytest.mark.mpi
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_every_placement(rod_mesh: Callable[..., Any], nu: float) -> None:
    """Floating, reduced and absolute mixed rods swing alike; at nu = 0.3 like the displacement form."""
    mesh = rod_mesh(dim=2, h=0.1)
    rod = floating(mesh, nearly_incompressible(MODULUS, nu))
    large = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=neo_hookean_mixed(MODULUS, nu))
    tips = [fmbd.solve(pendulum(b), t_end=0.05, dt=2.5e-3)["tip"] for b in (rod, rod.reduced(modes=12), large)]
    assert np.abs(tips[1] - tips[0]).max() < 2e-4
    assert np.abs(tips[2] - tips[0]).max() < 1e-3
    if nu == 0.3:
        same = fmbd.solve(pendulum(floating(mesh, linear_elastic(MODULUS, nu))), t_end=0.05, dt=2.5e-3)["tip"]
        assert np.abs(same - tips[0]).max() < 2e-5


def soft_beside_stiff(u: Any, v: Any, dx: Any) -> Any:
    """Half a rod of the modulus, half of a million times that."""
    x = ufl.SpatialCoordinate(dx.ufl_domain())
    modulus = ufl.conditional(x[0] < 0.5, MODULUS, 1e6 * MODULUS)
    return modulus * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(v)) * dx


@pytest.mark.mpi
@pytest.mark.parametrize("law", [nearly_incompressible(MODULUS, 0.5), soft_beside_stiff])
def test_static_modes_where_rayleigh_quotients_are_far_too_high(rod_mesh: Callable[..., Any], law: Any) -> None:
    """A modulus of compression or a stiff part, a million times the rest and more, do not keep static modes from being found."""
    body = floating(rod_mesh(dim=2, h=0.1), law)
    few = body.reduced(basis=fmbd.CraigBampton(("pin", "tip"), 4))
    found = []
    for placed in (body, few, body.with_(frame=fmbd.Attached("pin"), stiffening=True)):
        scene = fmbd.Scene("clamped")
        scene.add(placed, fmbd.fixed("clamp", fmbd.ground, placed.surface("pin")))
        found.append(fmbd.modes(scene, 1).frequencies[0])
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[2] == pytest.approx(found[0], rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_quadratic_trial_bends_and_keeps_its_volume(dim: int) -> None:
    """One of the trials has no strain but that of bending with nu = 1/2, or 1 in the plane: trace and shear vanish."""
    x, e = np.random.default_rng(4).standard_normal((5, dim)), 1e-4
    least = np.inf
    for bent in range(len(list(quadratic_fields(x)))):

        def u(at: np.ndarray, which: int = bent) -> np.ndarray:
            return list(quadratic_fields(at))[which]

        grad = np.stack([(u(x + e * d) - u(x - e * d)) / (2 * e) for d in np.eye(dim)], axis=2)
        strain = 0.5 * (grad + np.swapaxes(grad, 1, 2))
        diagonal = np.einsum("nii->ni", strain)
        off = np.abs(strain - np.einsum("ni,ij->nij", diagonal, np.eye(dim))).max()
        least = min(least, float(np.abs(diagonal.sum(axis=1)).max() + off))
        assert np.abs(strain).max() > 0.1
    assert least < 1e-8


def test_large_strain_limit(rod_mesh: Callable[..., Any]) -> None:
    """Away from 1/2 the eliminated pressure gives the displacement energy up to the projection of J - 1."""
    mesh = rod_mesh(dim=2, h=0.1)
    body = fmbd.AbsoluteBody("rod", mesh, density=DENSITY, energy=neo_hookean_mixed(MODULUS, 0.3))
    mixed = make_field("rod", mesh, body.forms())
    plain = make_field("rod", mesh, body.with_(energy=neo_hookean(MODULUS, 0.3)).forms())
    x, y = mixed.X.T
    u = 0.1 * np.stack((x + 0.3 * x * y, -0.5 * y + x**2), axis=1).ravel()
    np.testing.assert_allclose(mixed.energy(u), plain.energy(u), rtol=1e-3)
    rng = np.random.default_rng(2)
    w, e = rng.standard_normal(len(u)), 1e-6
    slope = (mixed.energy(u + e * w) - mixed.energy(u - e * w)) / (2 * e)
    np.testing.assert_allclose(mixed.internal(u) @ w, slope, rtol=1e-5)
    mixed.destroy()
    plain.destroy()


def test_degree_one_is_refused(rod_mesh: Callable[..., Any]) -> None:
    """P1 displacements with P1 pressure are not stable."""
    body = floating(rod_mesh(dim=2, h=0.25), nearly_incompressible(1.0, 0.5)).with_(degree=1)
    with pytest.raises(InputError, match="degree 2"):
        make_field("rod", body.mesh, body.forms())


@pytest.mark.parametrize("degree, nu, warned", [(1, 0.45, False), (1, 0.47, True), (2, 0.492, False), (2, 0.497, True)])
@pytest.mark.parametrize("dim", [2, 3])
def test_warning_of_locking(
    rod_mesh: Callable[..., Any], caplog: Any, degree: int, nu: float, warned: bool, dim: int
) -> None:
    """Displacement forms near nu = 1/2 are named, with the ratio found from the form; mixed ones are not."""
    mesh = rod_mesh(dim=dim, h=0.5, height=0.2)
    with caplog.at_level("WARNING", logger="fmbd_fenicsx"):
        field = make_field("rod", mesh, floating(mesh, linear_elastic(MODULUS, nu)).with_(degree=degree).forms())
        np.testing.assert_allclose(field.poisson_ratio, nu, rtol=1e-9)
        field.destroy()
        assert ("locks above" in caplog.text) == warned
        caplog.clear()
        make_field("rod", mesh, floating(mesh, nearly_incompressible(MODULUS, nu)).forms()).destroy()
        assert "locks" not in caplog.text


def test_inf_sup_of_displacement_and_pressure() -> None:
    """Taylor-Hood keeps its constant as the mesh is refined; equal degrees have zero modes; the deep check prints it."""
    from fmbd_fenicsx.fem.pressure_stability import infsup_pressure

    outside = ("left", "right", "bottom", "top")
    coarse, fine = (fmbd.read_gmsh(ROOT / "meshes/block.py", cells=n) for n in (4, 8))
    constants = [infsup_pressure(m, 2, clamped=outside)[:2] for m in (coarse, fine)]
    assert constants[0][0] < 1e-6 and constants[1][0] < 1e-6  # the constant pressure
    assert constants[1][1] == pytest.approx(constants[0][1], rel=0.02) and constants[1][1] > 0.3
    assert infsup_pressure(coarse, 2, 2)[0] < 1e-6
    body = fmbd.FloatingBody("rubber", coarse, degree=2, density=1.0, elastic=nearly_incompressible(1e6, 0.5))
    scene = fmbd.Scene("rubber")
    scene.add(body)
    assert any('"rubber": displacement and pressure' in note for note in scene.check(deep=True).notes)
