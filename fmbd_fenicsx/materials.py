"""Ready-made elastic forms in UFL; each returns what a user could write out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .errors import require

Form = Callable[[Any, Any, Any], Any]


def lame(youngs_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Lame parameters (mu, lambda) in Pa: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu) (1 - 2 nu)); nu < 1/2."""
    E, nu = youngs_modulus, poisson_ratio
    require(bool(np.isfinite(E)) and E > 0, f"Young's modulus {E} Pa must be positive.")
    require(
        -1.0 < nu < 0.5,
        f"Poisson's ratio {nu} must lie in (-1, 0.5). At 0.5 a displacement form does not exist: "
        "use a mixed displacement-pressure body.",
    )
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def linear_elastic(youngs_modulus: float, poisson_ratio: float) -> Form:
    """a(u, v) = int sigma(u) : eps(v), isotropic; in the plane: plane strain."""
    return _isotropic(*lame(youngs_modulus, poisson_ratio))


def plane_stress(youngs_modulus: float, poisson_ratio: float, thickness: float = 1.0) -> Form:
    """The same for a sheet of the given thickness (m): lambda* = 2 mu lambda / (lambda + 2 mu), times the thickness."""
    mu, lmbda = lame(youngs_modulus, poisson_ratio)
    require(thickness > 0, f"Thickness {thickness} m must be positive.")
    return _isotropic(thickness * mu, thickness * 2 * mu * lmbda / (lmbda + 2 * mu))


def _isotropic(mu: float, lmbda: float) -> Form:
    def elastic(u: Any, v: Any, dx: Any) -> Any:
        from dolfinx import fem
        from ufl import Identity, grad, inner, sym, tr

        domain = dx.ufl_domain()
        m, k = fem.Constant(domain, mu), fem.Constant(domain, lmbda)

        def eps(w: Any) -> Any:
            return sym(grad(w))

        d = u.ufl_shape[0]
        return inner(2 * m * eps(u) + k * tr(eps(u)) * Identity(d), eps(v)) * dx

    return elastic
