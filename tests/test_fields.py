"""Displacement fields: mass and stiffness of known shapes, symmetric and positive forms, the Cholesky
factor.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from motion import elastic_rod

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import CallbackError, InputError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.motion_tangent import MotionTangent

pytestmark = pytest.mark.mpi


def field_of(mesh: Any, **options: Any) -> Field:
    """The field of a rod on a mesh."""
    return Field("rod", mesh, elastic_rod(mesh, **options).forms())


@pytest.mark.smoke
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_mass_centre_and_inertia_of_a_box(dim: int, degree: int, rod_mesh: Callable[..., Any]) -> None:
    L, H, rho = 1.0, 0.4, 1000.0
    f = field_of(rod_mesh(dim=dim, h=0.5, height=H), degree=degree)
    m = rho * L * H ** (dim - 1)
    assert abs(f.mass_total / m - 1) < 1e-13
    assert np.abs(f.center - [0.5, 0, 0][:dim]).max() < 1e-13
    if degree == 1:
        return  # X x X is quadratic: exact from degree 2
    J = m / 12 * np.array([2 * H * H, L * L + H * H, L * L + H * H])
    expected = J[2:].reshape(1, 1) if dim == 2 else np.diag(J)
    assert np.abs(f.inertia - expected).max() < 1e-12 * m


@pytest.mark.parametrize("dim", [2, 3])
def test_rigid_displacements_have_no_elastic_force(dim: int, rod_mesh: Callable[..., Any]) -> None:
    f = field_of(rod_mesh(dim=dim, h=0.5, height=0.4))
    for k in range(f.motions.n_twist):
        if k < dim:
            U = np.tile(np.eye(dim)[k], (f.n, 1))
        else:
            U = f.motions.spin(np.eye(f.motions.n_rot)[k - dim][None], f.X)
        force = f.total(np.array(np.abs(f.stiffness(U.ravel())).max(initial=0.0)))
        assert force < 1e-9 * 5e6


def test_columns_of_rigid_momentum(rod_mesh: Callable[..., Any]) -> None:
    """Q^T of a rigid velocity is (m v, J w)."""
    f = field_of(rod_mesh(dim=3, h=0.5, height=0.4))
    v, w = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.7, -1.1])
    U = v + np.cross(w, f.X)
    found = f.total(f.Q.T @ U.ravel())
    assert np.abs(found - np.concatenate((f.mass_total * v, f.inertia @ w))).max() < 1e-11


@pytest.mark.smoke
def test_uniaxial_strain_has_the_energy_of_the_continuum(rod_mesh: Callable[..., Any]) -> None:
    L, H, e = 1.0, 0.4, 1e-3
    f = field_of(rod_mesh(dim=3, h=0.5, height=H))
    U = np.zeros((f.n, 3))
    U[:, 0] = e * f.X[:, 0]
    mu, lmbda = fmbd.materials.lame(5e6, 0.3)
    energy = float(f.total(np.array(0.5 * U.ravel() @ f.stiffness(U.ravel()))))
    assert abs(energy / (0.5 * (2 * mu + lmbda) * e * e * L * H * H) - 1) < 1e-11


@pytest.mark.smoke
def test_combination_is_the_sum(rod_mesh: Callable[..., Any]) -> None:
    f = field_of(rod_mesh(dim=2, h=0.5, height=0.4))
    E = f.combination(3.0, 1e-6)
    U = np.random.default_rng(f.comm.rank).standard_normal((f.n, 2))
    x, y = E.createVecs()
    x.array[:] = U.ravel()
    E.mult(x, y)
    expected = 3.0 * f.mass(U).ravel() + 1e-6 * f.stiffness(U.ravel())
    assert np.abs(y.array - expected).max(initial=0.0) < 1e-12 * f.mass_total
    for thing in (E, x, y):
        thing.destroy()


@pytest.mark.mpi
def test_factors_assemble_nothing(rod_mesh: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """The matrix of a size of step is made of those that are held: of the last tangent, whatever was evaluated since."""
    import dolfinx.fem.petsc as fp

    law = {"energy": fmbd.materials.saint_venant_kirchhoff(5e6, 0.3), "loads": [fmbd.loads.pressure("tip", 1e3)]}
    body = fmbd.AbsoluteBody("rod", rod_mesh(dim=2, h=0.5, height=0.4), density=1000.0, **law)
    scene = fmbd.Scene("one")
    scene.add(body)
    f = scene.build()[0].fields[0][1].field
    bent, rest, dU = 1e-2 * np.random.default_rng(f.comm.rank).standard_normal((3, f.n * 2))

    assembled = []
    original = fp.assemble_matrix
    monkeypatch.setattr(fp, "assemble_matrix", lambda *given: assembled.append(1) or original(*given))
    MotionTangent(f).take(0.0, bent, 0.0 * bent, dU)
    assert len(assembled) == 3  # the energy's, that of the pressure, that of the stress foretold

    f.internal(rest)
    E = f.combination(0.0, 1e-3)
    assert len(assembled) == 3
    x, y = E.createVecs()
    x.array[:] = rest
    E.mult(x, y)
    expected = 1e-3 * f.tangent(rest)
    assert np.abs(y.array - expected).max(initial=0.0) < 1e-12 * np.abs(expected).max(initial=1e-300)
    for thing in (E, x, y):
        thing.destroy()


# -- input ---------------------------------------------------------------------------------------------------
def unsymmetric(u: Any, v: Any, dx: Any) -> Any:
    """A form whose stress is not that of a symmetric gradient."""
    from ufl import grad, inner

    return inner(grad(u)[0, 1], grad(v)[1, 1]) * dx + inner(grad(u), grad(v)) * dx


def negative(u: Any, v: Any, dx: Any) -> Any:
    """A form of negative energy."""
    from ufl import grad, inner

    return -inner(grad(u), grad(v)) * dx


@pytest.mark.parametrize(
    "elastic, words",
    [
        (unsymmetric, "not symmetric"),
        (negative, "not positive"),
        (lambda u, v, dx: np.nan * u[0] * v[0] * dx, "a number in it is nan"),
        (lambda u, v, dx: 1.0, "bilinear"),
        (lambda u, v, dx: u[0] * dx, "bilinear"),
        (lambda u, v, dx: None, "bilinear"),
        (lambda u, v: None, "elastic must be a function of 3 arguments"),
    ],
)
def test_unusable_elastic_forms_are_refused(elastic: Any, words: str, rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match=f'"rod".*{words}'):
        field_of(rod_mesh(dim=2, h=0.5, height=0.4), elastic=elastic)


def test_a_form_of_the_gradient_is_told_of(rod_mesh: Callable[..., Any], caplog: pytest.LogCaptureFixture) -> None:
    """It resists rotations: a pendulum of it hangs from its pin like a cantilever. Initial stress of less is meant."""

    def gradient(u: Any, v: Any, dx: Any) -> Any:
        return ufl.inner(ufl.grad(u), ufl.grad(v)) * dx

    law = fmbd.materials.plane_stress(5e6, 0.3)
    field_of(rod_mesh(dim=2, h=0.5, height=0.4), elastic=lambda u, v, dx: law(u, v, dx) + 1e4 * gradient(u, v, dx))
    assert not caplog.messages
    field_of(rod_mesh(dim=2, h=0.5, height=0.4), elastic=lambda u, v, dx: 1e6 * gradient(u, v, dx))
    assert ["sym(grad(u)), not grad(u)" in message for message in caplog.messages] == [True]


def test_a_foundation_is_no_form_of_a_body_in_a_frame(rod_mesh: Callable[..., Any]) -> None:
    """It would hold the displacement in the frame; in absolute coordinates it carries the weight, rho g A / k."""
    law = fmbd.materials.plane_stress(5e6, 0.3)
    mesh = rod_mesh(dim=2, h=0.5, height=0.4)

    def bedded(u: Any, v: Any, dx: Any) -> Any:
        return law(u, v, dx) + 2e5 * u[1] * v[1] * dx

    kept = fmbd.AbsoluteBody("rod", mesh, density=1000.0, elastic=bedded)
    scene = fmbd.Scene("bedded", gravity=(0.0, -10.0))
    scene.add(kept, fmbd.prismatic("guide", fmbd.ground, kept.surface("pin"), axis=(0, 1)))
    scene.sensor("tip", fmbd.position(kept.surface("tip")))
    assert fmbd.equilibrium(scene)["tip"][1] == pytest.approx(-1000.0 * 10.0 / 2e5, rel=1e-6)

    floating = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=bedded)
    for body in (floating, floating.reduced(modes=2)):
        scene = fmbd.Scene("bedded")
        scene.add(body)
        with pytest.raises(InputError, match='"rod".*resists rigid motion'):
            scene.build()


def test_displacements_of_a_lower_degree_than_curved_cells_are_refused(shared_tmp: Path) -> None:
    """They hold no linear functions, so that no turn would be free of strain."""
    disc = Path(__file__).parents[1] / "meshes/disc.py"
    script = shared_tmp / "curved.py"
    made = f"runpy.run_path({str(disc)!r})['build'](gmsh, h=0.8)"
    script.write_text(f"import runpy\n\n\ndef build(gmsh):\n    {made}\n    gmsh.model.mesh.setOrder(2)\n")
    mesh = fmbd.read_gmsh(script)
    body = fmbd.FloatingBody("disc", mesh, degree=1, density=1.0, elastic=fmbd.materials.plane_stress(1e6, 0.3))
    with pytest.raises(InputError, match='"disc".*degree 1 on curved cells of order 2.*degree=2'):
        Field("disc", mesh, body.forms())
    Field("disc", mesh, body.with_(degree=2).forms()).destroy()


@pytest.mark.parametrize("density", [0.0, -1.0, np.nan, np.inf])
def test_density_must_be_positive(density: float, rod_mesh: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match='"rod".*density.*(positive|finite)'):
        elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4), density=density)


@pytest.mark.parametrize(
    "E, nu, words",
    [
        (0.0, 0.3, "Young"),
        (-5e6, 0.3, "Young"),
        (np.nan, 0.3, "Young"),
        (5e6, 0.5, "Poisson"),
        (5e6, 0.7, "Poisson"),
        (5e6, -1.0, "Poisson"),
        (5e6, np.nan, "Poisson"),
    ],
)
@pytest.mark.parametrize("form", [fmbd.materials.linear_elastic, fmbd.materials.plane_stress])
def test_moduli_out_of_range_are_refused(form: Any, E: float, nu: float, words: str) -> None:
    with pytest.raises(InputError, match=words):
        form(E, nu)


@pytest.mark.parametrize(
    "function, words",
    [(lambda x: np.zeros(3), "shape"), (lambda x: np.full_like(x, np.nan), "finite")],
)
@pytest.mark.parametrize("what", ["displacement", "displacement_rate"])
def test_unusable_initial_fields_are_named(what: str, function: Any, words: str, rod_mesh: Callable[..., Any]) -> None:
    rod = elastic_rod(rod_mesh(dim=2, h=0.5, height=0.4), **{what: function})
    scene = fmbd.Scene("start")
    scene.add(rod)
    with pytest.raises(CallbackError, match=f'"rod".*{what}.*{words}'):
        scene.build()


@pytest.mark.parametrize("words", ["shape", "finite", "failed"])
def test_initial_field_that_fails_on_one_rank_ends_all(words: str, rod_mesh: Callable[..., Any]) -> None:
    """The last rank alone gets an unusable value; every rank raises the same error."""
    from mpi4py import MPI

    comm = MPI.COMM_WORLD

    def start(x: Any) -> Any:
        if comm.rank == comm.size - 1:
            return {"shape": lambda: np.zeros(3), "finite": lambda: x * np.nan, "failed": lambda: 1 / 0}[words]()
        return 0 * x

    scene = fmbd.Scene("start")
    scene.add(elastic_rod(rod_mesh(dim=2, h=0.2, height=0.4), displacement=start))
    with pytest.raises(CallbackError, match=words):
        scene.build()


def test_every_rank_is_told_why_a_form_does_not_compile(rod_mesh: Callable[..., Any]) -> None:
    from ufl import bessel_J, inner

    rod = elastic_rod(rod_mesh(h=0.5), elastic=lambda u, v, dx: inner(bessel_J(2, inner(u, u)) * u, v) * dx)
    with pytest.raises(InputError, match="bilinear UFL form.*nonlinear operator BesselJ"):
        Field("rod", rod.mesh, rod.forms())
