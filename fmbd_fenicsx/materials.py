"""Ready-made elastic forms in UFL; each returns what a user could write out.

Young's modulus is a number (Pa), or a function of the place x (m), where the body lies at
the start, that gives a UFL expression: ``lambda x: 1e9 * (1 + x[0])``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .checks import function, number
from .energies import Grade, Hooke, MixedEnergy, SheetEnergy, StoredEnergy, ViscousForm, graded
from .errors import require

__all__ = [
    "kelvin_voigt",
    "lame",
    "linear_elastic",
    "nearly_incompressible",
    "neo_hookean",
    "neo_hookean_incompressible",
    "neo_hookean_mixed",
    "plane_strain",
    "plane_stress",
    "saint_venant_kirchhoff",
    "sheet_saint_venant_kirchhoff",
]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


Form = Callable[[Any, Any, Any], Any]
Modulus = float | Callable[[Any], Any]


def lame(youngs_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Lame parameters (mu, lambda) in Pa: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu)); nu < 1/2."""
    E, nu = youngs_modulus, poisson_ratio
    number("Young's modulus", E, above=0.0, unit="Pa")
    number("Poisson's ratio", nu)
    require(
        -1.0 < nu < 0.5,
        f"Poisson's ratio {nu} must lie in (-1, 0.5). At 0.5 a displacement form does not exist: "
        "use a mixed displacement-pressure body.",
    )
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def _lame_of(youngs_modulus: Modulus, poisson_ratio: float) -> tuple[float, float, Grade]:
    """mu and lambda in Pa; where the modulus is a function of the place, those of 1 Pa, and the function."""
    E, grade = _graded_modulus(youngs_modulus)
    return *lame(E, poisson_ratio), grade


def _graded_modulus(youngs_modulus: Modulus) -> tuple[float, Grade]:
    """A number in Pa, and the function of the place that it is multiplied by."""
    if not callable(youngs_modulus):
        return youngs_modulus, None
    function("Young's modulus", youngs_modulus, "x", named="the place x, m")
    return 1.0, youngs_modulus


def linear_elastic(youngs_modulus: Modulus, poisson_ratio: float) -> Hooke:
    """Hooke's law, isotropic, small strains: a(u, v) = int sigma(u) : eps(v), sigma = 2 mu eps + lambda tr(eps) 1.

    In the plane this is plane strain, of a slice of 1 m; reports say so.

    Args:
        youngs_modulus: Pa. poisson_ratio: below 1/2; from 0.45 on linear displacements bend too stiffly.
    """
    mu, lmbda, grade = _lame_of(youngs_modulus, poisson_ratio)
    return Hooke("linear_elastic", mu, lmbda, in_plane="plane strain", grade=grade)


def plane_stress(youngs_modulus: Modulus, poisson_ratio: float, thickness: float = 1.0) -> Hooke:
    """Hooke's law of a plane sheet that may strain across: :func:`linear_elastic` with lambda* = 2 mu lambda / (lambda + 2 mu),
    times the thickness.

    Args:
        youngs_modulus: Pa. poisson_ratio: below 1/2. thickness: m; the body's density is then per area, kg/m^2.
    """
    mu, lmbda, grade = _lame_of(youngs_modulus, poisson_ratio)
    number("Thickness", thickness, above=0.0, unit="m")
    reduced = 2 * mu * lmbda / (lmbda + 2 * mu)
    return Hooke("plane_stress", thickness * mu, thickness * reduced, in_plane="plane stress", sheet=True, grade=grade)


def plane_strain(youngs_modulus: Modulus, poisson_ratio: float, thickness: float = 1.0) -> Hooke:
    """Hooke's law of a plane sheet that cannot strain across: :func:`linear_elastic` times the thickness.

    Args:
        youngs_modulus: Pa. poisson_ratio: below 1/2. thickness: m; the body's density is then per area, kg/m^2.
    """
    mu, lmbda, grade = _lame_of(youngs_modulus, poisson_ratio)
    number("Thickness", thickness, above=0.0, unit="m")
    return Hooke("plane_strain", thickness * mu, thickness * lmbda, in_plane="plane strain", sheet=True, grade=grade)


def saint_venant_kirchhoff(youngs_modulus: Modulus, poisson_ratio: float) -> StoredEnergy:
    """Pi(u) = int mu E : E + lambda/2 (tr E)^2 with E = (F^T F - 1) / 2, F = 1 + grad u: large rotations, small strains."""
    return _energy(_of_green_strain, *_lame_of(youngs_modulus, poisson_ratio))


def sheet_saint_venant_kirchhoff(youngs_modulus: Modulus, poisson_ratio: float, thickness: float = 1.0) -> SheetEnergy:
    """The same for a sheet in plane stress: lambda* = 2 mu lambda / (lambda + 2 mu), times the thickness (m)."""
    mu, lmbda, grade = _lame_of(youngs_modulus, poisson_ratio)
    number("Thickness", thickness, above=0.0, unit="m")
    energy = _energy(_of_green_strain, thickness * mu, thickness * 2 * mu * lmbda / (lmbda + 2 * mu), grade)
    return SheetEnergy(energy.density, "sheet_saint_venant_kirchhoff")


def neo_hookean(youngs_modulus: Modulus, poisson_ratio: float) -> StoredEnergy:
    """Pi(u) = int mu/2 (tr F^T F - d - 2 ln J) + lambda/2 (J - 1)^2, J = det F > 0; its linear limit is Hooke's law.

    In the plane: plane strain. The term in ln J keeps cells from turning inside out.
    """
    mu, lmbda, grade = _lame_of(youngs_modulus, poisson_ratio)

    def density(C: Any, m: Any, k: Any) -> Any:
        from ufl import det, ln, sqrt, tr

        J = sqrt(det(C))
        return 0.5 * m * (tr(C) - C.ufl_shape[0] - 2 * ln(J)) + 0.5 * k * (J - 1) ** 2

    return _energy(density, mu, lmbda, grade)


def kelvin_voigt(viscosity: float, volume_viscosity: float = 0.0) -> ViscousForm:
    """Viscous stress of the rate of the Green-Lagrange strain, S_v = eta E' + zeta tr(E') 1, E' = sym(F^T grad u'); Pa s.

    To be given as ``viscous`` to an absolute body with an energy. Rigid motion of any size is not damped, momenta are kept,
    and the power eta E' : E' + zeta (tr E')^2 is never negative. In the plane: times the thickness, as the energy.
    """
    number("kelvin_voigt: viscosity", viscosity, least=0.0, unit="Pa s")
    number("kelvin_voigt: volume_viscosity", volume_viscosity, least=0.0, unit="Pa s")

    def form(u: Any, rate: Any, v: Any, dx: Any) -> Any:
        from dolfinx import fem
        from ufl import Identity, grad, inner, sym, tr

        eta = fem.Constant(dx.ufl_domain(), viscosity)
        zeta = fem.Constant(dx.ufl_domain(), volume_viscosity)
        one = Identity(u.ufl_shape[0])
        F = one + grad(u)
        strain_rate = sym(F.T * grad(rate))
        return inner(F * (eta * strain_rate + zeta * tr(strain_rate) * one), grad(v)) * dx

    return ViscousForm(form)


STIFFEST = 1e8  # lambda over mu of a linear body that counts as incompressible
STIFFEST_LARGE = 1e3  # of a body with large strains: its pressure follows every iterate of Newton's method


def _moduli(youngs_modulus: Modulus, nu: float, limit: float = STIFFEST) -> tuple[float, float, Grade]:
    """As :func:`_lame_of`, for nu up to and including 1/2: lambda is at most ``limit`` mu."""
    E, grade = _graded_modulus(youngs_modulus)
    number("Young's modulus", E, above=0.0, unit="Pa")
    number("Poisson's ratio", nu)
    require(-1.0 < nu <= 0.5, f"Poisson's ratio {nu} must lie in (-1, 0.5].")
    require(nu != 0.0, "At Poisson's ratio 0 there is no pressure of its own: take linear_elastic or neo_hookean.")
    mu = E / (2 * (1 + nu))
    return mu, mu * min(2 * nu / max(1 - 2 * nu, 1e-300), limit), grade


def nearly_incompressible(youngs_modulus: Modulus, poisson_ratio: float) -> MixedEnergy:
    """Hooke's law with a pressure of its own: int mu eps : eps + p div u - p^2 / (2 lambda); any nu up to 1/2.

    To be given as ``elastic``. In the plane: plane strain.
    """
    mu, lmbda, grade = _moduli(youngs_modulus, poisson_ratio)

    def density(u: Any, p: Any, dx: Any) -> Any:
        from ufl import div, grad, inner, sym

        m, k = graded(dx.ufl_domain(), (mu, lmbda), grade)
        e = sym(grad(u))
        return (m * inner(e, e) + p * div(u) - p * p / (2 * k)) * dx

    return MixedEnergy(density, linear=True)


def neo_hookean_mixed(youngs_modulus: Modulus, poisson_ratio: float) -> MixedEnergy:
    """Neo-Hookean with a pressure of its own: int mu/2 (tr F^T F - d - 2 ln J) + p (J - 1) - p^2 / (2 lambda); nu up to 1/2.

    To be given as ``energy``. In the plane: plane strain. lambda is limited to 1e3 mu (nu = 0.4995):
    beyond it take :func:`neo_hookean_incompressible`.
    """
    return _neo_hookean_of_pressure(_moduli(youngs_modulus, poisson_ratio, STIFFEST_LARGE))


def neo_hookean_incompressible(youngs_modulus: Modulus, poisson_ratio: float = 0.5) -> MixedEnergy:
    """The energy of :func:`neo_hookean_mixed` with the pressure as one more unknown; any nu in (0, 1/2], large strains.

    At nu = 1/2 the volume is kept, J = 1 in the mean over each function of the pressure's space. p in Pa is positive in
    tension. For absolute bodies, as ``energy``, with ``GeneralizedAlpha`` and ``settle``. In the plane: plane strain.
    """
    number("Poisson's ratio", poisson_ratio)
    require(
        0.0 < poisson_ratio <= 0.5, f"Poisson's ratio {poisson_ratio} must lie in (0, 0.5] for a pressure of its own."
    )
    mu, lmbda, grade = _moduli(youngs_modulus, poisson_ratio)
    return _neo_hookean_of_pressure((mu, lmbda, grade), carried=True, incompressible=lmbda >= STIFFEST * mu)


def _neo_hookean_of_pressure(moduli: tuple[float, float, Grade], **how: bool) -> MixedEnergy:
    """mu/2 (tr C - d - 2 ln J) + p (J - 1) - p^2 / (2 lambda)."""
    mu, lmbda, grade = moduli

    def of_strain(domain: Any) -> Callable[[Any, Any, Any], Any]:
        from ufl import ln, tr

        m, k = graded(domain, (mu, lmbda), grade)
        return lambda C, J, p: 0.5 * m * (tr(C) - C.ufl_shape[0] - 2 * ln(J)) + p * (J - 1) - p * p / (2 * k)

    def density(u: Any, p: Any, dx: Any) -> Any:
        from ufl import Identity, det, grad

        F = Identity(u.ufl_shape[0]) + grad(u)
        return of_strain(dx.ufl_domain())(F.T * F, det(F), p) * dx

    return MixedEnergy(density, of_strain=of_strain, **how)


def _of_green_strain(C: Any, m: Any, k: Any) -> Any:
    """m E : E + k/2 (tr E)^2 with E = (C - 1) / 2, per volume."""
    from ufl import Identity, inner, tr

    E = 0.5 * (C - Identity(C.ufl_shape[0]))
    return m * inner(E, E) + 0.5 * k * tr(E) ** 2


def _energy(density: Callable[[Any, Any, Any], Any], mu: float, lmbda: float, grade: Grade) -> StoredEnergy:
    def of(domain: Any) -> Callable[[Any], Any]:
        m, k = graded(domain, (mu, lmbda), grade)
        return lambda C: density(C, m, k)

    return StoredEnergy(of)
