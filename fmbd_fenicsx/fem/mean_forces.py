"""Forces of a field over a step as difference quotients of its energy, in every quadrature point.

    f_dg . w = int F_m S : grad w,      F_m = (F_0 + F_1) / 2,     C_m = (C_0 + C_1) / 2,     dC = C_1 - C_0
    S = 2 W'(C_m) + 2 (W(C_1) - W(C_0) - W'(C_m) : dC) / (dC : dC) dC                                          (1)

S : dC / 2 = W(C_1) - W(C_0), so energy is conserved for any step, and F_m S with symmetric S keeps the momenta. W must be
given as a function of C = F^T F (:class:`~fmbd_fenicsx.energies.StoredEnergy`); linear forms act on (u_0 + u_1) / 2.

A viscous law acts at (u_0 + u_1) / 2 with the rate (u_1 - u_0) / h; there sym(F_m^T grad u') = (E_1 - E_0) / h, so its work
is that of the strain that has changed, and a rigid rotation over any angle does none. The work of a pressure is that of its
mean over the way from u_0 to u_1 (two points: exact).

Source: Gonzalez, doi:10.1016/S0045-7825(00)00189-4; Simo and Tarnow, doi:10.1007/BF00913408.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

from .. import dolfinx_compat as compat
from ..energies import StoredEnergy, ViscousForm
from ..rotations import Array
from .assembly import NodalVector

if TYPE_CHECKING:
    from .fields import Field

TINY = 1e-9  # dC : dC below which the correction in (1), of the third order in dC, is lost in roundoff
POINTS = (0.5 - 1 / 12**0.5, 0.5 + 1 / 12**0.5)  # of Gauss's rule from u_0 to u_1


class MeanForces:
    """Elastic and viscous forces, and those of loads on the deformed body, from displacements u_0 to u_1 in h (s)."""

    def __init__(self, field: Field) -> None:
        """Collective."""
        import ufl
        from dolfinx import fem

        self.field = field
        self.u0 = fem.Function(field.space)
        self.u1 = fem.Function(field.space)
        self.h = fem.Constant(field.mesh.dolfinx, 1.0)
        self.form = self._forces(ufl.TestFunction(field.space))

    @cached_property
    def _vector(self) -> NodalVector:
        """Of all of them, compiled."""
        return NodalVector(compat.form(self.form))

    def tangent(self) -> Any:
        """Compiled d/du_1 of the balance of a step, 2 M / h^2 + d f_dg / d u_1; collective."""
        import ufl

        v, du = ufl.TestFunction(self.field.space), ufl.TrialFunction(self.field.space)
        inertia = 2 * self.field.rho / self.h**2 * ufl.inner(du, v) * self.field.mesh.dx
        return compat.form(inertia + ufl.derivative(self.form, self.u1, du))

    def _forces(self, v: Any) -> Any:
        """UFL form of all of them."""
        import ufl

        field, forms = self.field, self.field.forms
        dx = field.elastic_measure
        rate = (self.u1 - self.u0) / self.h

        force = self._material(rate, v)
        if forms.viscous is not None and not isinstance(forms.viscous, ViscousForm):
            force += forms.viscous(rate, v, dx)

        if forms.mass_damping:
            force += forms.mass_damping * field.rho * ufl.inner(rate, v) * field.mesh.dx
        if forms.stiffness_damping:
            assert forms.elastic is not None  # an energy is refused by the scheme
            force += forms.stiffness_damping * forms.elastic(rate, v, dx)
        if field.loads.moving:
            force -= self._on_the_way(field.loads.moving_form, v)
        return force

    def _material(self, rate: Any, v: Any) -> Any:
        """Elasticity, and a viscous law at a rate."""
        mean, viscous = 0.5 * (self.u0 + self.u1), self.field.forms.viscous
        force = self._elastic(mean, v)
        return force + viscous(mean, rate, v, self.field.elastic_measure) if isinstance(viscous, ViscousForm) else force

    def _on_the_way(self, form: Callable[[Any, Any], Any], v: Any) -> Any:
        """A load that follows the body, form(u, v): its mean over the way from u_0 to u_1."""
        return sum(0.5 * form((1 - x) * self.u0 + x * self.u1, v) for x in POINTS)

    @cached_property
    def rate(self) -> Any:
        """The function of (u_1 - u_0) / h in :meth:`parts`."""
        from dolfinx import fem

        return fem.Function(self.field.space)

    def parts(self) -> list[tuple[Any, Any]]:
        """Compiled forms of u_0, u_1 and their rate: of loads that follow the body, with these and without factors, and, with
        None, of what is not linear beside them; collective.
        """
        import ufl

        v, loads = ufl.TestFunction(self.field.space), self.field.loads
        made = [(load, self._on_the_way(loads.form_of(load), v)) for load, _, _ in loads.moving]
        return [(load, compat.form(form)) for load, form in [(None, self._material(self.rate, v)), *made]]

    def _elastic(self, mean: Any, v: Any) -> Any:
        """(1), or the linear form at the mean."""
        import ufl

        field = self.field
        stored = field.forms.energy
        if stored is None and not field.mixed:
            return field.stress_form(mean, v)[0]
        assert isinstance(stored, StoredEnergy)  # others are refused by the scheme

        eye = ufl.Identity(field.dim)
        F0 = eye + ufl.grad(self.u0)
        F1 = eye + ufl.grad(self.u1)
        C0, C1 = F0.T * F0, F1.T * F1
        Cm = ufl.variable(0.5 * (C0 + C1))
        dC = C1 - C0

        W = stored.density(field.mesh.dolfinx)
        # 2 W' is symmetric only with the symmetric part of the derivative
        slope = ufl.diff(W(Cm), Cm)
        slope = 0.5 * (slope + slope.T)

        # the correction of (1), where dC is no roundoff
        square = ufl.inner(dC, dC)
        rest = (W(C1) - W(C0) - ufl.inner(slope, dC)) / ufl.max_value(square, TINY)
        rest = ufl.conditional(ufl.gt(square, TINY), rest, 0.0)

        S = 2 * (slope + rest * dC)
        return ufl.inner(0.5 * (F0 + F1) * S, ufl.grad(v)) * field.elastic_measure

    def place(self, t: float, ends: tuple[Array, Array], h: float) -> None:
        """Take a step from t (s) to t + h: displacements (n d,) at both ends, ghosts included; collective."""
        self.h.value = h
        self.field.loads.at(t + 0.5 * h)
        for function, U in zip((self.u0, self.u1), ends, strict=True):
            function.x.array[: len(U)] = U
            function.x.scatter_forward()

    def force(self) -> Array:
        """The forces on the nodes over the step that was taken, (n d,); collective."""
        return self._vector.assembled()
