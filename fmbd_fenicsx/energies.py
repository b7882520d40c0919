"""Elastic energies as data: W(C) of the strain, energies of displacement and pressure; and viscous forms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from .checks import check_fields
from .errors import InputError

Grade = Callable[[Any], Any] | None  # what moduli are multiplied by from place to place


def of_place(what: str, given: Callable[[Any], Any], domain: Any) -> Any:
    """What a function of the place x (m) gives, as a UFL expression of the mesh's coordinates.

    Raises:
        InputError: it fails, or gives no number at each place.
    """
    from ufl import SpatialCoordinate, as_ufl

    try:
        found = as_ufl(given(SpatialCoordinate(domain)))
    except Exception as error:
        why = f"{type(error).__name__}: {str(error).rstrip('.')}"
        hint = "It takes UFL's coordinates: ufl.exp(x[0]), not np.exp(x[0])."
        raise InputError(f"{what}(x) failed: {why}. {hint}") from error
    if found.ufl_shape:
        raise InputError(f"{what}(x) has the shape {found.ufl_shape}, expected one number at each place.")
    return found


def graded(domain: Any, moduli: Sequence[float], grade: Grade) -> list[Any]:
    """Moduli as coefficients of forms: constants, times what the ``grade`` gives at a place."""
    from dolfinx import fem

    constants = [fem.Constant(domain, value) for value in moduli]
    if grade is None:
        return constants
    factor = of_place("Young's modulus", grade, domain)
    return [c * factor for c in constants]


def _refuse_space(name: str, u: Any) -> None:
    """A law of sheets does not know how a solid strains."""
    if u.ufl_shape[0] != 2:
        raise InputError(
            f"materials.{name} is a law of sheets in the plane; this body is in space. Use materials.linear_elastic or an energy "
            "such as materials.neo_hookean."
        )


@dataclass(frozen=True)
class Hooke:
    """Hooke's law a(u, v) = int (2 mu eps(u) + lambda tr eps(u) 1) : eps(v); mu, lambda in Pa, of sheets in N/m.

    ``name`` of the law in :mod:`fmbd_fenicsx.materials`, ``in_plane``: the state that it means in the plane, ``sheet``: it is a
    law of the plane only, ``grade``: a function of the place that both moduli are multiplied by.
    """

    name: str
    mu: float
    lmbda: float
    in_plane: str
    sheet: bool = False
    grade: Grade = None

    def __call__(self, u: Any, v: Any, dx: Any) -> Any:
        """The form."""
        from ufl import Identity, grad, inner, sym, tr

        if self.sheet:
            _refuse_space(self.name, u)
        m, k = graded(dx.ufl_domain(), (self.mu, self.lmbda), self.grade)

        def eps(w: Any) -> Any:
            return sym(grad(w))

        return inner(2 * m * eps(u) + k * tr(eps(u)) * Identity(u.ufl_shape[0]), eps(v)) * dx


@dataclass(frozen=True)
class MixedEnergy:
    """An energy Pi(u, p, dx) in J of displacement and pressure, quadratic in p; ``linear``: quadratic in u too.

    ``carried``: p is an unknown of its own beside u instead of being eliminated (absolute bodies, see ``fem.mixed``).
    ``incompressible``: the part quadratic in p serves the tangent only, so that J = 1 holds without it.
    ``of_strain(domain)``: the same as a UFL function (C, J, p) -> J/m^3, where it is one of C = F^T F; None: it is not known.
    """

    density: Callable[[Any, Any, Any], Any]
    linear: bool = False
    carried: bool = False
    incompressible: bool = False
    of_strain: Callable[[Any], Callable[[Any, Any, Any], Any]] | None = None

    def __post_init__(self) -> None:
        check_fields(self)

    def __call__(self, u: Any, p: Any, dx: Any) -> Any:
        """The form of the density."""
        return self.density(u, p, dx)


@dataclass(frozen=True)
class StoredEnergy:
    """Pi(u) = int W(C), C = F^T F, F = 1 + grad u: an energy that does not see rotations.

    ``density(domain)`` returns the UFL function C -> W in J/m^3; ``domain`` serves for constants.
    """

    density: Callable[[Any], Callable[[Any], Any]]

    def __call__(self, u: Any, dx: Any) -> Any:
        """The form of the density of C = F^T F."""
        from ufl import Identity, grad

        F = Identity(u.ufl_shape[0]) + grad(u)
        return self.density(dx.ufl_domain())(F.T * F) * dx


@dataclass(frozen=True)
class SheetEnergy(StoredEnergy):
    """An energy of sheets in the plane. ``name`` of the law in :mod:`fmbd_fenicsx.materials`."""

    name: str

    def __call__(self, u: Any, dx: Any) -> Any:
        """The form of the density of C = F^T F."""
        _refuse_space(self.name, u)
        return super().__call__(u, dx)


@dataclass(frozen=True)
class ViscousForm:
    """A law of Kelvin-Voigt damping as a form(u, rate, v, dx), linear in v, not linear in the displacements u in general.

    To be given as ``viscous`` to an :class:`~fmbd_fenicsx.AbsoluteBody` with an energy. Its power is
    form(u, rate, rate, dx) >= 0; a law F S_v(E') : grad v with E' = sym(F^T grad rate) and a symmetric S_v leaves rigid
    motions and momenta alone.
    """

    form: Callable[[Any, Any, Any, Any], Any]

    def __post_init__(self) -> None:
        check_fields(self)

    def __call__(self, u: Any, rate: Any, v: Any, dx: Any) -> Any:
        """The form."""
        return self.form(u, rate, v, dx)
