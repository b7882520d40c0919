"""Kelvin-Voigt damping in the rate of the Green-Lagrange strain, and the tangents of forces that move with the body."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ufl import Identity, SpatialCoordinate, as_vector, grad, inner, sym

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.fem.fields import Field
from fmbd_fenicsx.fem.motion_tangent import MotionTangent
from fmbd_fenicsx.materials import kelvin_voigt, linear_elastic, saint_venant_kirchhoff

ROOT = Path(__file__).resolve().parents[1]
QUIET = fmbd.Output(progress=False)


def rod(mesh: Any, **changes: Any) -> fmbd.AbsoluteBody:
    return fmbd.AbsoluteBody("rod", mesh, density=1.0, energy=saint_venant_kirchhoff(1e3, 0.3), quadrature=4, **changes)


def the_field(body: fmbd.AbsoluteBody) -> Field:
    scene = fmbd.Scene("one")
    scene.add(body)
    return scene.build()[0].fields[0][1].field


def smooth(field: Field, seed: int) -> Any:
    """A displacement with strains of 0.3, (n d,), the same on any number of ranks."""
    random = np.random.default_rng(seed)
    X, d = field.X_world, field.dim
    linear, bent = random.uniform(-0.3, 0.3, (2, d, d))
    return (X @ linear + np.sin(2 * X) @ bent).ravel()


def turned(field: Field, seed: int) -> tuple[Any, Any, Any]:
    """Displacements and rates of a rigid motion over any angle, and its rotation."""
    random, d, m = np.random.default_rng(seed), field.dim, field.motions
    R = np.linalg.qr(random.normal(size=(d, d)))[0]
    R *= np.linalg.det(R) if d == 3 else 1.0
    R[:, 0] *= np.sign(np.linalg.det(R))
    x = field.X @ R.T
    w = random.normal(size=(1, m.n_rot))
    return (x - field.X).ravel(), (m.spin(w, x) + random.normal(size=d)).ravel(), R


@pytest.mark.mpi
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_rigid_motion_is_free_and_momenta_are_kept(rod_mesh: Callable[..., Any], dim: int, seed: int) -> None:
    """No force on a rigid motion; of any other motion no resultant, no moment, and the power eta E' : E' + zeta (tr E')^2."""
    from dolfinx import fem
    from ufl import Measure, tr

    field = the_field(rod(rod_mesh(dim=dim, h=0.5, height=0.2), viscous=kelvin_voigt(3.0, 2.0)))
    U, rate, _ = turned(field, seed)
    strained = field.viscous.force(U, smooth(field, seed + 10))
    size = np.sqrt(field.total(np.array(strained @ strained)))
    alone = field.viscous.force(U, rate)
    assert np.sqrt(field.total(np.array(alone @ alone))) < 1e-12 * size
    U, rate = smooth(field, seed), smooth(field, seed + 20)
    f = field.viscous.force(U, rate).reshape(-1, dim)
    x = field.X_world + U.reshape(-1, dim)
    sums = field.total(np.concatenate((f.sum(0), field.motions.moment(x, f).sum(0))))
    assert np.abs(sums).max() < 1e-12 * size
    E = sym((Identity(dim) + grad(field.argument)).T * grad(field.viscous.rate))
    power = (3.0 * inner(E, E) + 2.0 * tr(E) ** 2) * Measure("dx", field.mesh.dolfinx)(
        metadata={"quadrature_degree": 4}
    )
    found = field.total(np.array([f.ravel() @ rate, fem.assemble_scalar(fem.form(power))]))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)


@pytest.mark.mpi
def test_tangents_are_derivatives(rod_mesh: Callable[..., Any]) -> None:
    """Stiffness and damping of pressure and viscous law against differences of the forces, the symmetric half."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    loads = [fmbd.pressure(s, 70.0, time=lambda t: 2 * t) for s in mesh.surface_names]
    field = the_field(rod(mesh, viscous=kelvin_voigt(3.0), loads=loads))
    U, rate = smooth(field, 1), smooth(field, 2)
    MotionTangent(field).take(0.5, U, rate)
    v, w = smooth(field, 3), smooth(field, 4)

    def force(s: float, r: float, d: Any) -> Any:
        out = field.internal(U + s * d) - field.loads.nodal(0.5, np.eye(2), U + s * d)[0].ravel()
        return out + field.viscous.force(U + s * d, rate + r * d)

    def work(a: Any, b: Any) -> float:
        return float(field.total(np.array(a @ b)))

    for by_u, matrix in ((True, field.tangent), (False, field.damping)):

        def slope(d: Any, on: Any, by_u: bool = by_u) -> float:
            s, r = (1e-6, 0.0) if by_u else (0.0, 1e-6)
            return work(on, force(s, r, d) - force(-s, -r, d)) / 2e-6

        found = work(w, matrix(v))
        np.testing.assert_allclose(found, 0.5 * (slope(v, w) + slope(w, v)), rtol=1e-6)
    np.testing.assert_allclose(work(w, field.stiffness(v)), work(v, field.stiffness(w)), rtol=1e-10)
    assert abs(work(w, field.tangent(v)) - work(w, field.stiffness(v))) > 1e-3 * abs(work(w, field.tangent(v)))


def ring_under_pressure() -> tuple[float, float, float]:
    """Newton's iterations, factorisations and the largest displacement of a thin ring that is pulled outwards by 2 kPa."""

    def form(v: Any, dx: Any, ds: Any) -> Any:
        x = SpatialCoordinate(dx.ufl_domain())
        return inner(as_vector((x[0], -x[1])), v) * ds("outer")

    def ramp(t: float) -> float:
        return min(t / 10, 1.0)

    mesh = fmbd.read_gmsh(ROOT / "meshes/ring.py", h=0.2, width=0.1)
    loads = [fmbd.Load(form, time=lambda t: 20 * ramp(t)), fmbd.pressure("outer", -2000.0, time=ramp)]
    energy = saint_venant_kirchhoff(1e6, 0.3)
    scene = fmbd.Scene("ring")
    scene.add(fmbd.AbsoluteBody("ring", mesh, density=1000.0, energy=energy, quadrature=4, loads=loads))
    run = fmbd.solve(scene, t_end=10.0, dt=1.0, scheme=fmbd.GeneralizedAlpha(0.2), output=QUIET)
    return run.counters["newton_iterations"], run.counters["factorisations"], float(np.abs(run.state.q).max())


@pytest.mark.serial
def test_stiffness_of_a_pressure_keeps_newton_fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """With it a third of the iterations and half of the tangents are saved, or more; the motion is the same."""
    count, factors, moved = ring_under_pressure()
    monkeypatch.setattr(MotionTangent, "take", lambda self, t, U, *_: self.field.linearise(U))
    without, more, same = ring_under_pressure()
    assert count < 0.7 * without and factors < 0.6 * more, (count, without, factors, more)
    np.testing.assert_allclose(moved, same, rtol=1e-4)


def flying(mesh: Any, viscous: Any, h: float) -> fmbd.Run:
    body = rod(mesh, viscous=viscous, velocity=(0.3, 0.1), angular_velocity=3.0,
               displacement_rate=lambda X: np.array([0.3 * np.sin(np.pi * X[0]), 0 * X[1]]))  # fmt: skip
    scene = fmbd.Scene("flying")
    scene.add(body)
    wanted = fmbd.Output(progress=False, snapshots=2)
    return fmbd.solve(scene, t_end=0.4, dt=h, scheme=fmbd.GeneralizedAlpha(0.9), output=wanted)


def test_flight_under_generalized_alpha(rod_mesh: Callable[..., Any]) -> None:
    """A spinning rod rings down: momenta stay, energy falls, with second order to that of energy-momentum."""
    mesh, law = rod_mesh(dim=2, h=0.5, height=0.2), kelvin_voigt(1.0)
    runs = [flying(mesh, law, h) for h in (0.01, 0.005, 0.0025)]
    ends = []
    for run in runs:
        (p0, spin0), (p, spin) = run.momenta(run.snapshots[0]), run.momenta()
        np.testing.assert_allclose(p, p0, rtol=1e-9)
        np.testing.assert_allclose(spin, spin0, rtol=5e-3)
        energy = sum(run.energy.values())
        assert np.diff(energy).max() < 0.01 * (energy[0] - energy[-1]) and energy[-1] < 0.992 * energy[0]
        ends.append(energy[-1])
    assert abs(ends[2] - ends[1]) < 0.4 * abs(ends[1] - ends[0])
    exact = fmbd.solve(runs[0].scene, t_end=0.4, dt=0.0025, scheme=fmbd.EnergyMomentum(), output=QUIET)
    np.testing.assert_allclose(sum(exact.energy.values())[-1], ends[2], rtol=1e-3)
    free = flying(mesh, None, 0.0025)
    assert sum(free.energy.values())[-1] > 1.005 * ends[2]


def test_own_law(rod_mesh: Callable[..., Any]) -> None:
    """A form of the user's own, written out, gives the same run."""
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)

    def form(u: Any, rate: Any, v: Any, dx: Any) -> Any:
        F = Identity(2) + grad(u)
        return 2.0 * inner(sym(F.T * grad(rate)), sym(F.T * grad(v))) * dx

    own, ready = (flying(mesh, law, 0.01) for law in (fmbd.ViscousForm(form), kelvin_voigt(2.0)))
    np.testing.assert_allclose(own.state.q, ready.state.q, atol=1e-9)


def test_refusals(rod_mesh: Callable[..., Any]) -> None:
    mesh = rod_mesh(dim=2, h=0.5, height=0.2)
    with pytest.raises(InputError, match="not negative"):
        kelvin_voigt(-1.0)
    for kind in (fmbd.FloatingBody, fmbd.AbsoluteBody):
        with pytest.raises(InputError, match="needs an AbsoluteBody with an energy"):
            kind("rod", mesh, density=1.0, elastic=linear_elastic(1e3, 0.3), viscous=kelvin_voigt(1.0))
    with pytest.raises(InputError, match="did not give a UFL form"):
        the_field(rod(mesh, viscous=fmbd.ViscousForm(lambda u, rate, v, dx: 1.0)))
