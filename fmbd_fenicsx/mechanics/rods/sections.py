"""Laws of a rod's cross-section: how its forces and moments follow from the strains.

Section axes: 1 along the tangent of the curve, 2 and 3 across it. Strains e = (gamma_1, gamma_2, gamma_3, kappa_1, kappa_2,
kappa_3): stretch, two shears, twist, two bendings; forces and moments S = (N, Q_2, Q_3, T, M_2, M_3) = dW/de.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...checks import check_fields, number, typed
from ...errors import CallbackError, InputError, require
from ...rotations import Array
from ..cross_sections import Shape, rectangle, ring, shear_modulus
from .relaxation import Arms


class OwnLaw:
    """A law at the Gauss points ``s`` (m, q), m: a UFL expression on an interval mesh with one cell for each point."""

    def __init__(self, energy: Callable[[Any, Any, Any], Any], s: Array) -> None:
        import ufl
        from dolfinx import fem, mesh
        from mpi4py import MPI

        compat.check_versions()
        self.shape, n = s.shape, s.size
        line = mesh.create_interval(MPI.COMM_SELF, n, [0.0, 1.0])
        # one constant value a cell: the cells need no geometry
        vector = fem.functionspace(line, ("DG", 0, (6,)))
        scalar = fem.functionspace(line, ("DG", 0))
        self._e, place = fem.Function(vector), fem.Function(scalar)
        place.x.array[:] = s.ravel()

        e = ufl.variable(self._e)
        gamma = ufl.as_vector([e[0], e[1], e[2]])
        kappa = ufl.as_vector([e[3], e[4], e[5]])

        try:
            W = ufl.as_ufl(energy(gamma, kappa, place))
            if W.ufl_shape:
                raise ValueError(f"found the shape {W.ufl_shape}")
            stress = ufl.diff(W, e)
            expressions = (W, stress, ufl.diff(stress, e))
            middle = np.array([[0.5]])
            self._W, self._S, self._C = (fem.Expression(x, middle) for x in expressions)
        except Exception as error:
            raise InputError(
                "Section: energy(gamma, kappa, s) must return a scalar UFL expression of two vectors and the arc length: "
                f"{type(error).__name__}: {error}"
            ) from error

        self._mesh = line
        self._cells = np.arange(n, dtype=np.int32)
        rest = self.stress(np.zeros((*self.shape, 6)))
        if not np.isfinite(rest).all():
            raise InputError("Section: the stress of energy(gamma, kappa, s) is not finite without strain.")

    def _evaluate(self, expression: Any, e: Array, size: int) -> Array:
        """An expression at all points, (m, q, size)."""
        self._e.x.array[:] = e.ravel()
        found = np.asarray(expression.eval(self._mesh, self._cells)).reshape(*self.shape, size)
        if not np.isfinite(found).all():
            raise CallbackError(
                "The section energy of a rod or its derivative is not finite: strains are too large for it."
            )
        return found

    def energy(self, e: Array) -> Array:
        """W, J/m, (m, q)."""
        return self._evaluate(self._W, e, 1)[..., 0]

    def stress(self, e: Array) -> Array:
        """dW/de, (m, q, 6)."""
        return self._evaluate(self._S, e, 6)

    def tangent(self, e: Array) -> Array:
        """d^2 W/de^2, (m, q, 6, 6)."""
        return self._evaluate(self._C, e, 36).reshape(*self.shape, 6, 6)


@dataclass(frozen=True, eq=False)
class RodSection:
    """Stiffness and inertia of a rod's cross-section.

    Args:
        stiffness: symmetric, positive (6, 6): S = stiffness e; six numbers are a diagonal (EA, GA_2, GA_3, GJ, EI_2, EI_3); or
            a function of s (m) that returns one of them; or
        energy: the user's own W(gamma, kappa, s) in UFL, J/m, with vectors gamma and kappa of three components.
        mass: kg/m, or a function of s.
        inertia: rotary inertia about the curve in section axes, kg m: three numbers or (3, 3), or a function of s. Its first
            entry belongs to spin about the tangent. The centre of mass lies on the curve.
        outline: corners (n, 2) of the section across the curve, m, for pictures.
        relaxation: viscoelastic arms, pairs (C_k, tau_k): after a sudden strain e the section forces are
            (stiffness + sum C_k exp(-t / tau_k)) e. C_k: (6, 6) or six numbers, as the stiffness, zeros allowed, or one number
            that multiplies the stiffness; tau_k in s. A run starts without force in the arms; equilibria have none.
    """

    stiffness: Any = None
    mass: Any = 0.0
    inertia: Any = (0.0, 0.0, 0.0)
    energy: Callable[[Any, Any, Any], Any] | None = None
    outline: Array | None = None
    relaxation: Sequence[tuple[Any, float]] = ()

    def __post_init__(self) -> None:
        require(
            (self.stiffness is None) != (self.energy is None),
            "A section needs either its stiffness, (6,) or (6, 6), or an energy(gamma, kappa, s) in UFL.",
        )
        check_fields(self, "Section")
        self.matrices(np.zeros(1))
        self.masses(np.zeros(1))
        self.inertias(np.zeros(1))
        self.arms(np.zeros((1, 1)))

    @classmethod
    @typed
    def rectangle(
        cls, *, youngs_modulus: float, poisson_ratio: float, density: float, width: float, height: float
    ) -> RodSection:
        """A solid rectangle: ``width`` along axis 2, ``height`` along axis 3 (m).

        Shear factors 5/6; torsion constant by the series of Saint-Venant, to 1e-4.
        """
        what = "RodSection.rectangle"
        shape = rectangle(what, width, height)
        # what pictures show
        corners = 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])
        return cls._of(what, shape, (youngs_modulus, poisson_ratio, density), corners)

    @classmethod
    @typed
    def circle(
        cls, *, youngs_modulus: float, poisson_ratio: float, density: float, radius: float, inner: float = 0.0
    ) -> RodSection:
        """A disc, or a ring with the radius ``inner`` (m); shear factor of Cowper, :func:`.ring`."""
        shape = ring(radius, inner, poisson_ratio)
        # what pictures show
        angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        rim = radius * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        return cls._of("RodSection.circle", shape, (youngs_modulus, poisson_ratio, density), rim)

    @classmethod
    def _of(cls, what: str, shape: Shape, material: tuple[float, float, float], outline: Array) -> RodSection:
        """From a shape with the second moments about axes 2 and 3, and (E, nu, rho)."""
        A, I2, I3, J, factor = shape
        (E, _, rho), G = material, shear_modulus(what, *material)
        # axial, shear in both directions, torsion, bending about both
        stiffness = (E * A, factor * G * A, factor * G * A, G * J, E * I2, E * I3)
        return cls(stiffness, rho * A, (rho * (I2 + I3), rho * I2, rho * I3), outline=outline)

    # -- along the curve ------------------------------------------------------------------------------------------
    @cached_property
    def _constants(self) -> dict[str, Array]:
        """What is constant along the curve, checked once for all rods."""
        return {}

    def _along(self, what: str, s: Array, made: Callable[[Any, float], Array]) -> Array:
        """A constant, or a function of s (m), as it is ``made`` to an array at the places s, (n, ...)."""
        given = getattr(self, what)
        if callable(given):
            return np.array([made(given(at), at) for at in map(float, s)])
        if what not in self._constants:
            self._constants[what] = made(given, float(s[0]))
        return np.repeat(self._constants[what][None], len(s), axis=0)

    def matrices(self, s: Array) -> Array:
        """Stiffness at the places s (n,), (n, 6, 6); checked. Zeros for an energy of the user's own."""
        if self.stiffness is None:
            return np.zeros((len(s), 6, 6))
        return self._along("stiffness", s, lambda x, at: check_matrix(_matrix(x, 6, "stiffness", at), "stiffness", at))

    def masses(self, s: Array) -> Array:
        """kg/m at the places s, (n,)."""
        of = "Section: at s = {:g} m: mass"
        return self._along("mass", s, lambda x, at: np.array(number(of.format(at), x, above=0.0, unit="kg/m"), float))

    def inertias(self, s: Array) -> Array:
        """Rotary inertia at the places s, (n, 3, 3), kg m."""
        return self._along("inertia", s, lambda x, at: _check_inertia(_matrix(x, 3, "inertia", at), at))

    def arms(self, s: Array) -> Arms | None:
        """The viscoelastic arms at the Gauss points s (m, q), m; None without any."""
        if not len(self.relaxation):
            return None
        found = [self._arm(pair, s.ravel()) for pair in self.relaxation]
        C = np.array([x for x, _ in found]).reshape(len(found), *s.shape, 6, 6)
        return Arms(C, np.array([tau for _, tau in found]))

    def _arm(self, pair: Any, s: Array) -> tuple[Array, float]:
        """C_k at the places s, (n, 6, 6), and tau_k; checked."""
        require(
            isinstance(pair, tuple | list) and len(pair) == 2,
            f"Section: relaxation must be pairs (stiffness, time in s), found {pair!r}.",
        )

        given, tau = pair
        number(f"Section: time of the relaxation ({given!r}, {tau!r})", tau, above=0.0, unit="s")

        # one number is a share of the whole stiffness
        if np.ndim(given) == 0:
            share = number("Section: share of the stiffness that relaxes", given, above=0.0)
            require(self.stiffness is not None, "Section: beside an own energy, give arms as six numbers or (6, 6).")
            return share * self.matrices(s), float(tau)

        C = _matrix(given, 6, "relaxing stiffness", float(s[0]))
        check_symmetric(C, "relaxing stiffness", float(s[0]))

        least = float(np.linalg.eigvalsh(C)[0])
        require(
            least >= -1e-12 * np.abs(C).max(), f"Section: relaxing stiffness has the negative eigenvalue {least:g}."
        )
        return np.broadcast_to(C, (len(s), 6, 6)), float(tau)

    def law(self, s: Array) -> LinearLaw | Any:
        """The law at the Gauss points s (m, q), m."""
        if self.energy is None:
            return LinearLaw(self.matrices(s.ravel()).reshape(*s.shape, 6, 6))

        return OwnLaw(self.energy, s)


@dataclass(frozen=True)
class LinearLaw:
    """W = e C e / 2 with C (m, q, 6, 6)."""

    C: Array

    def energy(self, e: Array) -> Array:
        """W, J/m, (m, q)."""
        value: Array = 0.5 * (e * self.stress(e)).sum(-1)
        return value

    def stress(self, e: Array) -> Array:
        """C e, (m, q, 6)."""
        found: Array = (self.C @ e[..., None])[..., 0]
        return found

    def tangent(self, e: Array) -> Array:
        """C."""
        return self.C


def _matrix(given: Any, n: int, what: str, s: float) -> Array:
    """A square matrix from one, or from its diagonal."""
    try:
        found = np.asarray(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise CallbackError(f"Section: {what} at s = {s:g} m is {given!r}, expected numbers.") from None
    found = np.diag(found) if found.shape == (n,) else found
    if found.shape != (n, n) or not np.isfinite(found).all():
        raise InputError(
            f"Section: {what} at s = {s:g} m must be ({n},) or ({n}, {n}) finite numbers, found {given!r}."
        )
    return found


def check_matrix(C: Array, what: str, s: float) -> Array:
    """A matrix, unless it is not symmetric and positive: this is refused."""
    check_symmetric(C, what, s)
    # each entry in units of its own: N and N m^2 are not compared
    size = np.sqrt(np.abs(np.diag(C)))
    if not (size > 0).all() or np.linalg.eigvalsh(C / np.outer(size, size))[0] <= 1e-12:
        raise InputError(
            f"Section: {what} at s = {s:g} m is not positive: eigenvalues {np.round(np.linalg.eigvalsh(C), 12).tolist()}."
        )
    return C


def _check_inertia(J: Array, s: float) -> Array:
    """A rotary inertia, unless no cross-section has it: this is refused."""
    p = np.linalg.eigvalsh(check_matrix(J, "inertia", s))
    if p[0] + p[1] < p[2] * (1 - 1e-9):
        raise InputError(
            f"Section: principal inertias {p} at s = {s:g} m violate J1 + J2 >= J3; no cross-section has them."
        )
    return J


def check_symmetric(C: Array, what: str, s: float) -> None:
    """Refuse a matrix that is not symmetric."""
    skew = np.abs(C - C.T)
    if skew.max() > 1e-9 * np.abs(C).max():
        i, j = np.unravel_index(int(skew.argmax()), C.shape)
        raise InputError(
            f"Section: {what} at s = {s:g} m is not symmetric: entry ({i + 1}, {j + 1}) is {C[i, j]:g}, "
            f"entry ({j + 1}, {i + 1}) is {C[j, i]:g}."
        )
