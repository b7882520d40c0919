"""What a user says of an elastic body, for a field to be made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..energies import ViscousForm
from .density import Density
from .loads import Load


@dataclass(frozen=True)
class ElasticForms:
    """What a user says of an elastic body: density, degree, Rayleigh damping, and its elasticity.

    Either the bilinear form ``elastic(u, v, dx)``, or an ``energy(u, dx)`` in J, not quadratic in general. ``quadrature`` is the
    degree of the quadrature of both (None: see :mod:`.energy_quadrature`). ``viscous(u, v, dx)`` is the form of Kelvin-Voigt
    damping in the rate u, or a :class:`~fmbd_fenicsx.energies.ViscousForm` of displacement and rate.
    """

    elastic: Callable[[Any, Any, Any], Any] | None
    density: Density
    degree: int
    mass_damping: float = 0.0  # 1/s
    stiffness_damping: float = 0.0  # s
    energy: Callable[..., Any] | None = None
    quadrature: int | None = None
    loads: tuple[Load, ...] = ()
    viscous: Callable[[Any, Any, Any], Any] | ViscousForm | None = None
