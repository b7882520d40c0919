"""Loads on elastic bodies as UFL forms: tractions, pressure, body forces, thermal strain, anything linear in v.

A load is L(v) times a function of time; its nodal vector b is assembled once. A *dead* load keeps its direction in space, a
*follower* turns with the body's frame, an *internal* one (thermal strain) acts on the elastic coordinates alone:

    dead, follower   translation  sum_n b_n,     rotation  sum_n P_n x b_n,     elastic rows  b                (1)

with b turned into body axes where it is dead. Loads that are carried along with the material (pressures, follower forces)
have the moment  sum_n X_n x b_n  instead: a linear body leaves out how displacements turn b, so it leaves out how they shift b,
too. With the one alone a body under pressure from all sides would begin to spin. Bodies with stiffening have both, to first
order (``mechanics.elastic.stiffening``). The same load acts on floating, reduced and
absolute bodies. On a body with an energy, whose displacements are of any size, followers and internal loads are forms of the
deformed body, F = 1 + grad u:

    pressure  -p J F^-T N . v,     follower f  |f| F f / |F f| . v,     stress S of a thermal strain  S : sym(F^T grad v)      (2)

The stiffness of such loads, -dL(u; v)[du], is part of the body's tangent by its symmetric half. That of S is symmetric; the
other half of a pressure's comes from the surface's edges and vanishes where these are held or the surface is closed
(Schweizerhof and Ramm, doi:10.1016/0045-7949(84)90161-5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..checks import check_fields, number, typed, vector
from ..errors import CallbackError, InputError, named, require
from ..rotations import Array
from .assembly import NodalVector

Time = Callable[[float], float]

BALANCED = 1e-9  # a resultant below this share of the sum of its parts is roundoff


def steady(t: float) -> float:
    """Full load from the start."""
    return 1.0


@dataclass(frozen=True, eq=False)
class Load:
    """L(v) = ``form(v, dx, ds)`` times ``time(t)``; ``ds("tip")`` is the measure of a named surface.

    ``follower``: fixed in the body's frame. ``internal``: a stress S in the body, S : grad(v), which turns with it and has no
    resultant on the frame. ``deformed``: form(u, v, dx, ds) used instead by bodies with an energy, evaluated at the current u;
    by default S : F^T grad(v) of a stress. Those in absolute coordinates, which have no frame, need it of other followers.
    """

    form: Callable[[Any, Any, Any], Any]
    time: Time = steady
    follower: bool = False
    internal: bool = False
    deformed: Callable[[Any, Any, Any, Any], Any] | None = None
    surface: str | None = None
    value: Any = None  # (d,) of a traction or body force, for messages and checks

    def __post_init__(self) -> None:
        check_fields(self)
        # the frame is the only axes that a load within a body can have
        object.__setattr__(self, "follower", self.follower or self.internal)

    @property
    def carried(self) -> bool:
        """Whether it is carried along with the material."""
        return self.follower and not self.internal and self.deformed is not None

    def check(self, body: Any) -> None:
        """Refuse a load on a surface that the body does not have, or of another dimension."""
        if self.surface is not None:
            body.surface(self.surface)
        if self.value is not None:
            vector(f'Body "{body.name}": the value of a load', self.value, size=body.dim)

    def factor(self, t: float, body: str) -> float:
        """The checked value of ``time`` at t."""
        value = named("The function of time of a load on body", body, self.time, to_end=True)(t)
        try:
            return number("a factor", value)
        except InputError as error:
            raise CallbackError(
                f'A load on body "{body}": its function of time returned {value!r} at t = {t:g} s, expected a number.'
            ) from error


@typed
def traction(surface: str, value: Sequence[float], *, time: Time = steady, follower: bool = False) -> Load:
    """Force per area on a surface: f . v integrated over it, f = time(t) value.

    Args:
        surface: its name in the mesh.
        value: in Pa, in the plane in N/m, (d,), world axes.
        time: factor over time (s); by default the full load from the start. Jumps need small steps.
        follower: the force turns with the body's frame, ``value`` in its axes; with an energy or stiffening, with the material.
    """
    return _uniform("traction", value, time, follower, surface)


@typed
def body_force(value: Sequence[float], *, time: Time = steady, follower: bool = False) -> Load:
    """Force per volume of a body: f . v integrated over it, f = time(t) value.

    Args:
        value: in N/m^3, in the plane in N/m^2, (d,), world axes.
        time: factor over time (s); by default the full load from the start.
        follower: the force turns with the body's frame, ``value`` in its axes; with an energy or stiffening, with the material.
    """
    return _uniform("body_force", value, time, follower)


def _uniform(what: str, value: Sequence[float], time: Time, follower: bool, surface: str | None = None) -> Load:
    """f . v integrated over a surface, None: over the body, for one f = time(t) value."""
    vector(f"{what}: value", value)

    def form(v: Any, dx: Any, ds: Any) -> Any:
        import ufl

        f = _constant(vector(f"{what}: value", value, size=v.ufl_shape[0]), dx)
        return ufl.inner(f, v) * (dx if surface is None else ds(surface))

    def deformed(u: Any, v: Any, dx: Any, ds: Any) -> Any:
        return _carried(value, u, v, dx) * (dx if surface is None else ds(surface))

    return Load(form, time, follower, deformed=deformed if follower else None, surface=surface, value=value)


@typed
def pressure(surface: str, value: float, *, time: Time = steady) -> Load:
    """Pressure against the outward normal of a surface, -p n . v integrated over it, turning with the surface.

    Args:
        surface: its name in the mesh.
        value: p in Pa, in the plane in N/m; positive pushes inwards.
        time: factor over time (s); by default the full pressure from the start.
    """

    def form(v: Any, dx: Any, ds: Any) -> Any:
        import ufl

        return -_constant(value, dx) * ufl.inner(ufl.FacetNormal(dx.ufl_domain()), v) * ds(surface)

    def deformed(u: Any, v: Any, dx: Any, ds: Any) -> Any:
        import ufl

        F = ufl.Identity(len(u)) + ufl.grad(u)
        normal = ufl.det(F) * ufl.dot(ufl.inv(F).T, ufl.FacetNormal(dx.ufl_domain()))
        return -_constant(value, dx) * ufl.inner(normal, v) * ds(surface)

    return Load(form, time, follower=True, deformed=deformed, surface=surface)


@typed
def thermal_stress(stress: Callable[[Any], Any], *, time: Time = steady) -> Load:
    """Stress (Pa) of a thermal strain, ``stress(x)`` with x the material point: L(v) = int stress : sym grad v.

    With an energy it is the second Piola-Kirchhoff stress, which turns with the material: int stress : sym(F^T grad v).
    For a rise dT of an isotropic body: E alpha dT / (1 - 2 nu) times the identity; of a sheet in plane stress of thickness t:
    t E alpha dT / (1 - nu).
    """

    def form(v: Any, dx: Any, ds: Any) -> Any:
        import ufl

        return ufl.inner(stress(ufl.SpatialCoordinate(dx.ufl_domain())), ufl.sym(ufl.grad(v))) * dx

    return Load(form, time, internal=True)


def with_gradients(form: Any, v: Any, change: Callable[[Any], Any]) -> tuple[Any, bool]:
    """``form`` with ``change(grad(v))`` in place of every grad(v), v its test function; and whether there was any."""
    from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    from ufl.algorithms.apply_derivatives import apply_derivatives
    from ufl.algorithms.map_integrands import map_integrand_dags
    from ufl.corealg.multifunction import MultiFunction

    found = []

    class Replace(MultiFunction):  # type: ignore[misc]
        expr = MultiFunction.reuse_if_untouched

        def grad(self, o: Any) -> Any:
            if o.ufl_operands[0] is not v:
                return o
            found.append(o)
            return change(o)

    return map_integrand_dags(Replace(), apply_derivatives(apply_algebra_lowering(form))), bool(found)


def _carried(value: Any, u: Any, v: Any, dx: Any) -> Any:
    """Power on v of a force that is carried along with the material, |f| F f / |F f|; f may be zero."""
    import ufl

    f = _constant(value, dx)
    carried = f + ufl.grad(u) * f
    nothing = _constant(1e-100, dx)
    return ufl.sqrt((ufl.inner(f, f) + nothing) / (ufl.inner(carried, carried) + nothing)) * ufl.inner(carried, v)


def _constant(value: Any, dx: Any) -> Any:
    """The value of a load as a constant of its form: a number in it would make each value a form of its own, to be compiled,
    and a value of zero none at all.
    """
    from dolfinx import fem

    return fem.Constant(dx.ufl_domain(), np.asarray(value, dtype=float))


def turned_virial(C: Array) -> Array:
    """What the turn of loads that are carried along with the material adds to their part C = sum b X^T (d, d) of the mean stress
    that slopes work on: nothing along the axis that they press along, the opposite of what presses across it. So a pressure
    from all sides adds up to none (the effective tension of pipes).
    """
    d = len(C)
    return (C - np.trace(C) * np.eye(d)) / (d - 1)


@dataclass(frozen=True, eq=False)
class SurfaceMeasure:
    """``ds`` of a load's form: ``ds("tip")`` is the measure of a surface of the field's mesh."""

    field: Any
    measure: Any

    def __call__(self, surface: str) -> Any:
        """The measure of a surface."""
        return self.measure(self.field.mesh.surface_tag(surface))

    def __rmul__(self, integrand: Any) -> Any:
        named = self.field.mesh.surface_names
        raise InputError(
            f'A load on body "{self.field.name}" integrates over ds, which is to have the name of a surface: '
            f'ds("{named[0] if named else "tip"}"). This mesh has {", ".join(named) or "none"}.'
        )


class AppliedLoads:
    """The loads of one field; collective to build.

    ``fixed``: those whose forms do not change, with their nodal vectors (n, d). ``moving``: those on the deformed body, with
    their present factors and forms.
    """

    def __init__(self, field: Any, loads: Sequence[Load]) -> None:
        import ufl
        from dolfinx import fem

        self.field = field
        msh = field.mesh.dolfinx
        measure = ufl.Measure("ds", domain=msh, subdomain_data=field.mesh.facet_tags)

        self._measures = field.mesh.dx, SurfaceMeasure(field, measure)

        v = ufl.TestFunction(field.space)
        self.fixed: list[tuple[Load, Array]] = []
        self.moving: list[tuple[Load, Any, NodalVector]] = []
        self.loads: list[Load] = []
        self.forms: list[Any] = []  # of each, compiled
        for given in loads:
            try:
                load, form, stress = self._formed(given, v)
                rows = NodalVector(compat.form(form))
            except InputError:
                raise
            except Exception as error:
                raise InputError(
                    f'A load on body "{field.name}" is not a linear UFL form in v: {type(error).__name__}: {error}'
                ) from error
            self.loads.append(load)
            self.forms.append(rows.form)
            if load.deformed is not None and field.nonlinear:
                self.moving.append((load, fem.Constant(msh, 0.0), rows))
                continue
            b = rows.assembled().reshape(-1, field.dim)
            require(
                load.internal or not stress or not self._balanced(b),
                f'A load on body "{field.name}" is a stress, a form of grad(v) without a resultant, and would keep its direction '
                "in space where the body turns. Give Load(..., internal=True), whose stress turns with the body.",
            )
            self.fixed.append((load, b))

    def _formed(self, load: Load, v: Any) -> tuple[Load, Any, bool]:
        """The load as its body takes it, its form, and whether that has gradients of v."""
        import ufl

        # a load that follows a nonlinear body is a form on it; others are vectors once and for all
        if load.deformed is not None and self.field.nonlinear:
            return load, load.deformed(self.field.argument, v, *self._measures), False

        form = load.form(v, *self._measures)
        if not isinstance(form, ufl.Form) or len(form.arguments()) != 1:
            raise TypeError(f"found {form!r:.80}; integrate over dx or ds, once linear in v")
        stress = with_gradients(form, v, lambda slope: slope)[1]
        if not (load.internal and stress and self.field.nonlinear):
            return load, form, stress

        def deformed(u: Any, v: Any, dx: Any, ds: Any) -> Any:
            F = ufl.Identity(len(u)) + ufl.grad(u)
            return with_gradients(load.form(v, dx, ds), v, lambda slope: ufl.dot(F.T, slope))[0]

        return self._formed(replace(load, deformed=deformed), v)

    def _balanced(self, b: Array) -> bool:
        """Whether nodal forces (n, d) have neither a resultant nor a moment; collective."""
        arms = np.concatenate([np.ones((len(b), 1)), self.field.X], axis=1)
        found = self.field.total(arms.T @ b)
        found[1:] -= found[1:].T.copy()
        size = self.field.total(np.abs(arms).T @ np.abs(b)).sum(axis=1)
        return bool(
            np.abs(found[0]).max() <= BALANCED * size[0] and np.abs(found[1:]).max() <= BALANCED * size[1:].max()
        )

    def moving_form(self, u: Any, v: Any) -> Any:
        """UFL form of all loads on the deformed body, L(u; v) times the factors of :meth:`at`; 0 without such loads."""
        return sum(factor * self.form_of(load)(u, v) for load, factor, _ in self.moving)

    def form_of(self, load: Load) -> Callable[[Any, Any], Any]:
        """L(u; v) of a load on the deformed body, UFL."""
        return lambda u, v: load.deformed(u, v, *self._measures)  # type: ignore[misc]

    def turning_form(self, load: Load) -> Any:
        """dL(u; v)[w] / du of a load on the deformed body at u = 0, UFL of trial function w and test function v."""
        import ufl
        from dolfinx import fem

        undeformed = fem.Function(self.field.space)
        form = self.form_of(load)(undeformed, ufl.TestFunction(self.field.space))
        return ufl.derivative(form, undeformed, ufl.TrialFunction(self.field.space))

    def at(self, t: float) -> None:
        """Set the factors of :meth:`moving_form` to those at time t."""
        for load, factor, _ in self.moving:
            factor.value = load.factor(t, self.field.name)

    def constant(self, t: float, R: Array) -> tuple[Array, Array]:
        """Nodal forces (n, d) in the axes R at time t of the loads that do not depend on the deformation: those that act on
        the frame too, and the internal ones.
        """
        outer, inner = np.zeros((2, self.field.n, self.field.dim))
        for load, b in self.fixed:
            factor = load.factor(t, self.field.name)
            if load.internal:
                inner += factor * b
            else:
                # dead loads stand in the world: into the axes R
                outer += factor * (b if load.follower else b @ R)
        return outer, inner

    def carried(self, t: float) -> Array:
        """Nodal forces (n, d) of those of :meth:`constant` that are carried along with the material."""
        found: Array = np.zeros((self.field.n, self.field.dim))
        for load, b in self.fixed:
            if load.carried:
                found += load.factor(t, self.field.name) * b
        return found

    def nodal(self, t: float, R: Array, U: Array) -> tuple[Array, Array]:
        """As :meth:`constant`, of all loads, for displacements U (n d,); collective."""
        outer, inner = self.constant(t, R)
        if self.moving:
            argument = self.field.argument
            argument.x.array[: len(U)] = U
            argument.x.scatter_forward()
        for load, _, rows in self.moving:
            outer += load.factor(t, self.field.name) * rows.assembled().reshape(-1, self.field.dim)
        return outer, inner
