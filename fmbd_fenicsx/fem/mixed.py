"""Displacement and pressure: bodies that are nearly or fully incompressible (Taylor-Hood).

    Pi(u, p),  quadratic in p:      dPi/du = f_int,     dPi/dp = 0   gives   C p = b(u)                        (1)

for instance Pi = int mu eps(u) : eps(u) + p div u - p^2 / (2 lambda). The displacements are Lagrange of degree k, the pressure
of degree k - 1, which is stable for k >= 2. The pressure is eliminated exactly by (1) wherever forces are evaluated, and
is a block of its own, [cm M + ck A, ck B^T; ck B, -ck C], where the step's matrix is factored. So a mixed body has the
coordinates of any other body: displacements. nu = 1/2 is allowed: the ready-made materials
limit lambda to 1e8 mu (1e3 mu for large strains), so the volume changes by a share of 1e-8 (1e-3) of the shear strains.

A ``carried`` pressure (large strain, nu up to 1/2) is an unknown beside u. Newton's increment solves

    [ A   B^T ] [ du ]   [ -f(u, p)         ]         eliminated:   (A + B^T C^-1 B) du = -f(u, p) - B^T C^-1 r       (2)
    [ B   -C  ] [ dp ] = [ -r,  r = dPi/dp  ]                       dp = C^-1 (B du + r)

with the factor of (1): r (:meth:`MixedField.volume_gap`) is a further load of the step and p moves with each increment
(:meth:`MixedField.move_pressure`). The rate does not depend on lambda. At nu = 1/2, r = b(u) has no part in p, and C, with
lambda = 1e8 mu, is in the matrix only.

Source: Boffi, Brezzi and Fortin, Mixed Finite Element Methods, doi:10.1007/978-3-642-36519-5, section 8.8.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..energies import MixedEnergy
from ..errors import InputError
from ..rotations import Array
from .assembly import NodalVector
from .elastic_forms import ElasticForms
from .energy_quadrature import integrated
from .factors.factor import factored
from .fields import Field

if TYPE_CHECKING:
    from .numbering import Numbering


def _volume(C: Any) -> Any:
    """J of C = F^T F."""
    import ufl

    return ufl.sqrt(ufl.det(C))


class MixedField(Field):
    """A displacement field whose pressure is eliminated by (1); the same interface as :class:`.Field`."""

    mixed = True
    _held: Array | None = None  # the pressure that displacements are placed with, where it is not their own

    @property
    def nonlinear(self) -> bool:
        """Whether the energy is other than quadratic in u."""
        return not self._energy.linear

    def _elastic_form(self, dx: Any) -> None:
        import ufl
        from dolfinx import fem

        self._energy: MixedEnergy = self.forms.energy or self.forms.elastic  # type: ignore[assignment]
        degree = self.forms.degree
        if degree < 2:
            raise InputError(
                f'Body "{self.name}": displacement and pressure need degree 2 or more, found {degree}: P1 with P1 is not stable.'
            )

        Q = self.mesh.space(degree - 1)
        self.pressure = Q
        self._w, self._p = fem.Function(self.space), fem.Function(Q)
        u = ufl.TrialFunction(self.space)
        v = ufl.TestFunction(self.space)
        p = ufl.TrialFunction(Q)
        q = ufl.TestFunction(Q)

        try:
            energy, self.elastic_measure = integrated(lambda dx: self._energy(self._w, self._p, dx), dx, degree=degree)

            force = ufl.derivative(energy, self._w, v)
            balance = ufl.derivative(energy, self._p, q)
            self._energy_form, self.balance_form = (compat.form(x) for x in (energy, balance))
            self._balance_rows = NodalVector(self.balance_form)
            self._residual = NodalVector(compat.form(force))
            self.stiffness_form = compat.form(ufl.derivative(force, self._w, u))
            self._coupling_form = compat.form(ufl.derivative(balance, self._w, u))
            self._compliance_form = compat.form(ufl.derivative(balance, self._p, p))
        except Exception as error:
            raise InputError(
                f'Body "{self.name}": energy(u, p, dx) did not give a UFL form of rank 0: {type(error).__name__}: {error}'
            ) from error

        self.n_pressure = Q.dofmap.index_map.size_local
        self.carried = self._energy.carried
        self.keeps_volume = self.carried and self._energy.incompressible
        self._balance = balance
        self._make_compliance()

    def _make_compliance(self) -> None:
        """Factor C, which does not depend on u."""
        import dolfinx.fem.petsc as fp

        C = fp.assemble_matrix(self._compliance_form)
        C.assemble()
        C.scale(-1.0)
        self._solve_p = factored(C, True)
        self._px, self._pb = C.createVecs()
        self._C = C
        self._B: Any = None

    def linearise(self, U: Array | None, *extra: Any) -> None:
        """Assemble the blocks at the displacements U (None: zero); collective."""
        import dolfinx.fem.petsc as fp

        self.place(np.zeros(self.n * self.dim) if U is None else U)
        super().linearise(U, *extra)
        first = self._B is None
        if first:
            self._B = fp.create_matrix(self._coupling_form)
            self._bu, self._bp = self._B.createVecs()
        self._B.zeroEntries()
        fp.assemble_matrix(self._B, self._coupling_form)
        self._B.assemble()

    def place(self, U: Array) -> None:
        """Displacements and the pressure that belongs to them, ghosts included; collective."""
        super().place(U)
        if self._held is not None:
            self.pressure_values = self._held
        elif not self.carried:
            self._take_pressure_of_law()

    @contextmanager
    def holding(self, pressure: Array | None) -> Iterator[None]:
        """Displacements are placed with this pressure (n_pressure,) for a while, None: with their own."""
        self._held = pressure
        try:
            yield
        finally:
            self._held = None

    def foretold_pressure(self, U: Array, dU: Array | None) -> Array:
        """(2) of :func:`.geometric_change` for an increment dU, in the axes of the tangent, from displacements U on; None: the
        pressure there. Collective.
        """
        self.place(U)
        if dU is not None:
            self.move_pressure(dU, np.zeros(self.n_pressure))
        return self.pressure_values

    @property
    def strain_energy(self) -> Callable[[Any], Any] | None:
        """As :meth:`Field.strain_energy`, at the pressure as it is."""
        of_strain = self._energy.of_strain
        if of_strain is None:
            return None
        density = of_strain(self.elastic_measure.ufl_domain())
        return lambda C: density(C, _volume(C), self._p)

    def _take_pressure_of_law(self) -> None:
        """The pressure that belongs to the displacements that are placed: C p = b, the balance at p = 0."""
        self._p.x.array[:] = 0.0
        self._pb.array[:] = self._balance_rows.assembled()
        self._solve_p.solve(self._pb, self._px)
        self._p.x.array[: self.n_pressure] = self._px.array
        self._p.x.scatter_forward()

    @property
    def pressure_argument(self) -> Any:
        """The function of the pressure in the forms of an energy."""
        return self._p

    # -- a pressure that is an unknown --------------------------------------------------------------------------
    def volume_gap(self, U: Array) -> Array:
        """r of (2) at displacements U (n d,), int q (J - 1) for a body that keeps its volume; collective."""
        self.place(U)
        gap = self._balance_rows.assembled()
        if self._energy.incompressible:
            self._px.array[:] = self._p.x.array[: self.n_pressure]
            self._C.mult(self._px, self._pb)
            gap += self._pb.array
        return gap

    def volume_push(self, gap: Array) -> Array:
        """B^T C^-1 gap in the axes of the tangent, (n d,); collective."""
        self._pb.array[:] = gap
        self._solve_p.solve(self._pb, self._px)
        self._B.multTranspose(self._px, self._bu)
        return np.array(self._bu.array)

    def pressure_force(self) -> float:
        """Largest nodal force B^T p of the pressure, N; collective."""
        self._px.array[:] = self._p.x.array[: self.n_pressure]
        self._B.multTranspose(self._px, self._bu)
        return float(max(self.comm.allgather(np.abs(self._bu.array).max(initial=0.0))))

    def volume_rate(self, V: Array) -> Array:
        """B v of velocities (n d,), where the field is linearised; collective."""
        self._bu.array[:] = V
        self._B.mult(self._bu, self._pb)
        return np.array(self._pb.array)

    @cached_property
    def _bias(self) -> tuple[NodalVector, Any, Any]:
        """Second rate of the volume, and the functions that hold velocity and acceleration."""
        import ufl
        from dolfinx import fem

        V, A = fem.Function(self.space), fem.Function(self.space)
        first = ufl.derivative(self._balance, self._w, V)
        second = ufl.derivative(first, self._w, V) + ufl.derivative(self._balance, self._w, A)
        return NodalVector(compat.form(second)), V, A

    def volume_bias(self, U: Array, V: Array, A: Array | None = None) -> Array:
        """B a + d/dt(B) v at displacements U, velocities V, accelerations A (n d,), None: zero; collective."""
        bias, *functions = self._bias
        super().place(U)
        for function, values in zip(functions, (V, np.zeros_like(V) if A is None else A), strict=True):
            function.x.array[: len(V)] = values
            function.x.scatter_forward()
        return bias.assembled()

    def coupling_matrix(self) -> Any:
        """B where the field is linearised; the caller destroys it."""
        return self._B.copy()

    @property
    def compliance_factor(self) -> Any:
        """The factor of C as PETSc's matrix, which the field keeps."""
        return self._solve_p.getPC().getFactorMatrix()

    def compliance_matrix(self) -> Any:
        """C; the caller destroys it."""
        return self._C.copy()

    def constitutive_pressure(self, U: Array) -> Array:
        """The pressure that the law gives for displacements U, nu below 1/2; collective."""
        self.place(U)
        self._take_pressure_of_law()
        return self.pressure_values

    def move_pressure(self, dU: Array, gap: Array) -> None:
        """p + dp of (2) for the increment dU (n d,) in the axes of the tangent, where r = ``gap``; collective."""
        # p moves by C^-1 (gap + B du), as the eliminated row says
        self._bu.array[:] = dU
        self._B.mult(self._bu, self._pb)
        self._pb.array[:] += gap
        self._solve_p.solve(self._pb, self._px)
        self.pressure_values = self.pressure_values + self._px.array

    @property
    def pressure_values(self) -> Array:
        """Values of a carried pressure that this rank owns, Pa."""
        return np.array(self._p.x.array[: self.n_pressure])

    @pressure_values.setter
    def pressure_values(self, p: Array) -> None:
        self._p.x.array[: self.n_pressure] = p
        self._p.x.scatter_forward()

    @property
    def pressure_array(self) -> Array:
        """The same where it stands, not a copy, with ghosts behind them: for compiled code."""
        return self._p.x.array  # type: ignore[no-any-return]

    def stiffness(self, U: Array) -> Array:
        """A U + B^T C^-1 B U, (n d,), or of columns: the pressure follows the volume; with a pressure of its own A U of the
        stress-free body.
        """
        if U.ndim > 1:
            return np.stack([self.stiffness(u) for u in U.T], axis=1) if U.shape[1] else U.copy()
        if self.carried:
            return self._times(self._unstressed, U)
        volume = self.volume_push(self.volume_rate(U))
        return self._times(self.K, U) + volume

    def stiffness_at(self, U: Array, into: Any = None) -> Any:
        """As :meth:`Field.stiffness_at`: A of the body without pressure."""
        held = self.pressure_values
        with self.holding(np.zeros_like(held)):
            into = super().stiffness_at(U, into)
        self.pressure_values = held
        return into

    def stress_form(self, u: Any, v: Any) -> tuple[Any, Any]:
        """Work of the stress of u and of its pressure on grad v, and the pressure."""
        import ufl
        from dolfinx import fem

        p = fem.Function(self.pressure)
        return ufl.derivative(self._energy(u, p, self.elastic_measure), u, v), p

    def tangent(self, U: Array) -> Array:
        """The matrix of :meth:`combination` with its pressure eliminated, times U."""
        out = self.stiffness(U)
        return out + self._times(self._with_extra, U) - self._times(self.K, U) if self._extra else out

    def combination(self, cm: float, ck: float, cd: float = 0.0) -> Any:
        """[cm M + ck A, ck B^T; ck B, -ck C] as one PETSc matrix (aij); collective. The caller destroys it."""
        from petsc4py import PETSc

        E = super().combination(cm, ck, cd)
        # bordered by displacement and pressure: [E, ck B^T; ck B, -ck C]
        B, C = self._B.copy(), self._C.copy()
        B.scale(ck)
        C.scale(-ck)
        BT = B.transpose(PETSc.Mat())

        nest = PETSc.Mat().createNest([[E, BT], [B, C]], comm=self.comm)
        out = nest.convert("aij", PETSc.Mat())
        for x in (nest, E, B, BT, C):
            x.destroy()
        return out

    def pressure_of(self, U: Array) -> Any:
        """The pressure that belongs to displacements U (n d,), as a dolfinx function (carried: the present one); collective."""
        self.place(U)
        return self._p

    @cached_property
    def pressure_numbering(self) -> Numbering:
        """As :attr:`numbering`, of the pressure; collective."""
        from .numbering import Numbering

        return Numbering(self.pressure)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for x in (self._B, self._bu, self._bp, self._px, self._pb, self._C, self._solve_p):
            x.destroy()
        super().destroy()


def make_field(name: str, mesh: Any, forms: ElasticForms) -> Field:
    """The field that fits the description of elasticity; collective."""
    mixed = isinstance(forms.energy, MixedEnergy) or isinstance(forms.elastic, MixedEnergy)
    return (MixedField if mixed else Field)(name, mesh, forms)
