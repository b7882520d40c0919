"""Displacement fields of elastic bodies: UFL forms in, constant matrices and nodal forces out.

    K = elastic form a(u, v),      or, of an energy Pi(u),     f_int = dPi/du,   K = d2Pi/du2                    (1)

Inertia and surfaces are those of :mod:`.nodal_field`. K of a linear form is assembled once, that of an energy where it is
linearised.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..energies import StoredEnergy
from ..errors import InputError
from ..rotations import Array
from .assembly import NodalVector, product
from .elastic_forms import ElasticForms
from .energy_quadrature import elastic_measure, integrated
from .field_checks import check_field
from .given_numbers import GivenNumbers
from .loads import AppliedLoads
from .nodal_field import NodalField
from .viscous import RestDamping, Viscous


class Field(NodalField):
    """Elasticity of a displacement field: its forms, its stiffness, and the forces of its nodes; collective to build.

    Attributes: ``K`` the stiffness, ``tangents`` how often it was assembled since the first time, ``D`` the matrix of the viscous
    form (None without one), ``loads``, ``viscous``.
    """

    mixed = False  # whether a pressure belongs to the displacements
    indefinite = False  # whether a tangent of it was found to be so: compressed bodies
    carried = False  # whether that pressure is an unknown of its own
    keeps_volume: bool = False  # whether that pressure keeps J = 1
    loads: AppliedLoads
    viscous: Viscous
    _w: Any = None  # the displacements in an energy
    _energy_form: Any = None
    kept_factors: dict[float, Any] | None = None  # of K + s M by s, where several bases are computed with one field

    def __init__(self, name: str, mesh: Any, forms: ElasticForms) -> None:
        import dolfinx.fem.petsc as fp

        super().__init__(name, mesh, forms)

        # elasticity, without stress to begin with
        self.elastic_measure = elastic_measure(mesh.dx, forms.degree, forms.quadrature)
        self._elastic_form(self.elastic_measure)
        self.K = fp.create_matrix(self.stiffness_form, "baij")
        self.tangents = -1
        self._with_extra: Any = None
        self.rest_damping: RestDamping | None = None  # beside a tangent
        self._unstressed: Any = None  # K of the body without stress, where stiffness_damping has to know it
        self.linearise(None)

        self._work = [self.K.createVecRight(), self.K.createVecLeft()]
        check_field(self)
        self.loads = AppliedLoads(self, forms.loads)
        self.viscous = Viscous(self, forms.viscous)
        self.D = self.viscous.matrix

        elastic = self.stiffness_form if self._energy_form is None else self._energy_form
        given = self.scalar_mass, elastic, *self.loads.forms, *self.viscous.forms
        self.numbers = GivenNumbers(self.comm, given, (self._w, self.pressure_argument, self.viscous.rate))

    @property
    def argument(self) -> Any:
        """The function of the displacements in the forms of an energy."""
        return self._w

    @property
    def pressure_argument(self) -> Any:
        """The function of the pressure in them, None without one."""
        return None

    @property
    def strain_energy(self) -> Callable[[Any], Any] | None:
        """The energy as a UFL function W(C), C = F^T F, where it is known as one."""
        energy = self.forms.energy
        return energy.density(self.elastic_measure.ufl_domain()) if isinstance(energy, StoredEnergy) else None

    @property
    def nonlinear(self) -> bool:
        """Whether the internal forces come from an energy."""
        return self.forms.energy is not None

    def _elastic_form(self, dx: Any) -> None:
        """Compile the stiffness form, and for an energy Pi(u) the residual dPi/du and Pi itself."""
        import ufl
        from dolfinx import fem

        u = ufl.TrialFunction(self.space)
        v = ufl.TestFunction(self.space)
        what = "elastic(u, v, dx) did not give a bilinear UFL form"
        try:
            if self.forms.energy is None:
                assert self.forms.elastic is not None
                a = self.forms.elastic(u, v, dx)
                if not isinstance(a, ufl.Form) or len(a.arguments()) != 2:
                    raise TypeError(f"found {a!r:.80}; integrate over dx, once linear in u and once in v")
                self.stiffness_form = compat.form(a)
                return
            # an energy: its forces and its tangent are derivatives, by one rule
            what = "energy(u, dx) did not give a UFL form of rank 0"
            self._w = fem.Function(self.space)
            density = self.forms.energy
            energy, self.elastic_measure = integrated(lambda dx: density(self._w, dx), dx, degree=self.forms.degree)
            residual = ufl.derivative(energy, self._w, v)
            self._energy_form, self._residual = compat.form(energy), NodalVector(compat.form(residual))
            self.stiffness_form = compat.form(ufl.derivative(residual, self._w, u))
        except Exception as error:
            raise InputError(f'Body "{self.name}": {what}: {type(error).__name__}: {error}') from error

    def stress_form(self, u: Any, v: Any) -> tuple[Any, Any]:
        """Work of the linear stress of u on grad v, UFL, and the pressure in it as a function (None without one)."""
        assert self.forms.elastic is not None
        return self.forms.elastic(u, v, self.elastic_measure), None

    def pressure_of(self, U: Array) -> Any:
        """The pressure that belongs to displacements U, as a dolfinx function: only bodies with a pressure have one."""
        raise NotImplementedError

    def linearise(self, U: Array | None, *extra: Any) -> None:
        """Assemble K, for an energy at the displacements U (n d,) (None: zero), plus ``extra`` compiled forms; collective."""
        import dolfinx.fem.petsc as fp
        from petsc4py import PETSc

        if self.nonlinear:
            self.place(np.zeros(self.n * self.dim) if U is None else U)

        if self.tangents < 0 or self.nonlinear:
            self.K.zeroEntries()
            fp.assemble_matrix(self.K, self.stiffness_form)
            self.K.assemble()
        # damping by stiffness is that of the body without stress
        if self.tangents < 0 and self.nonlinear and (self.carried or self.forms.stiffness_damping > 0):
            self._unstressed = self.K.copy()
            if self.forms.stiffness_damping:
                self.rest_damping = RestDamping(self, self._unstressed)

        # what the tangent of moving loads adds stands in a matrix of its own: K stays that of the energy
        if extra:
            if self._with_extra is None:
                self._with_extra = self._with_places()
            self._with_extra.zeroEntries()
            for form in extra:
                fp.assemble_matrix(self._with_extra, form)
            self._with_extra.assemble()
            self._with_extra.axpy(1.0, self.K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self._extra = extra
        self.tangents += 1

    def _with_places(self) -> Any:
        """A matrix with the places of the stiffness; collective."""
        import dolfinx.fem.petsc as fp

        out = fp.create_matrix(self.stiffness_form, "baij")
        fp.assemble_matrix(out, self.stiffness_form)  # places that nothing is put into at first are lost
        out.assemble()
        return out

    def stiffness_at(self, U: Array, into: Any = None) -> Any:
        """The stiffness at displacements U (n d,) in a matrix of its own, made where none is given; collective."""
        import dolfinx.fem.petsc as fp

        self.place(U)
        into = self._with_places() if into is None else into
        into.zeroEntries()
        fp.assemble_matrix(into, self.stiffness_form)
        into.assemble()
        return into

    def holding(self, pressure: Array | None) -> AbstractContextManager[None]:
        """Displacements are placed with this pressure for a while: bodies without one have nothing to do."""
        return nullcontext()

    def place(self, U: Array) -> None:
        """Nodal values of the energy's argument, ghosts included; collective."""
        nodal = self._w.x
        nodal.array[: len(U)] = U
        nodal.scatter_forward()

    def stiffness(self, U: Array) -> Array:
        """K U, (n d,) -> (n d,), or of columns (n d, k)."""
        return self._times(self.K, U)

    def stiffness_at_rest(self, U: Array) -> Array:
        """K_0 U with the stiffness of the body without stress, what stiffness_damping acts by, (n d,) -> (n d,)."""
        return self.stiffness(U) if self._unstressed is None else self._times(self._unstressed, U)

    def dampings(self) -> list[tuple[float, Any]]:
        """What stands at cd in :meth:`combination`, with factors: the viscous form, K_0 beside a tangent."""
        own, rest = [] if self.D is None else [(1.0, self.D)], self.rest_damping
        return own if rest is None else [*own, (rest.beta, rest.matrix)]

    def damping_in_tangent(self, U: Array) -> Array:
        """The matrix at cd of :meth:`combination` times U, (n d,) or columns (n d, k)."""
        return sum((c * self._times(A, U) for c, A in self.dampings()), np.zeros_like(U))

    @property
    def extended(self) -> bool:
        """Whether the stiffness of :meth:`combination` is more than K, by :meth:`linearise`, or changes with the motion."""
        return bool(self.nonlinear or self._extra)

    def tangent(self, U: Array) -> Array:
        """K U with the extra form of :meth:`linearise`: the matrix that :meth:`combination` holds, (n d,) or (n d, k)."""
        return self._times(self.stiffness_matrix, U)

    @property
    def stiffness_matrix(self) -> Any:
        """K of :meth:`combination`, which the field keeps."""
        return self._with_extra if self._extra else self.K

    @property
    def stiffness_without_stress(self) -> Any:
        """The matrix that stiffness_damping acts by, which the field keeps; K where no one asks for it."""
        return self.K if self._unstressed is None else self._unstressed

    def _times(self, A: Any, U: Array) -> Array:
        return product(A, U, self._work)

    def internal(self, U: Array) -> Array:
        """Internal forces K U, or dPi/du, (n d,) -> (n d,); collective."""
        if not self.nonlinear:
            return self.stiffness(U)
        self.place(U)
        return self._residual.assembled()

    @property
    def residual_form(self) -> Any:
        """The compiled form of dPi/du."""
        return self._residual.form

    def energy(self, U: Array) -> float:
        """Elastic energy in J; collective."""
        if not self.nonlinear:
            return float(self.total(np.array(0.5 * U @ self.stiffness(U))))
        from dolfinx import fem

        self.place(U)
        return float(self.total(np.array(fem.assemble_scalar(self._energy_form))))

    def damping(self, U: Array) -> Array:
        """D U, (n d,) -> (n d,); zero without a viscous form."""
        return np.zeros_like(U) if self.D is None else self._times(self.D, U)

    def combination(self, cm: float, ck: float, cd: float = 0.0) -> Any:
        """The PETSc matrix cm M + cd D + ck K (symmetric, aij) of those that are held; collective. The caller destroys it."""
        from petsc4py import PETSc

        held = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
        if self.redistributed:  # neighbours of neighbours
            held = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        E = self.stiffness_matrix.convert("aij", PETSc.Mat())
        E.scale(ck)
        E.axpy(cm, self.mass_matrix(), structure=held)
        for c, A in self.dampings() if cd else ():
            D = A.convert("aij", PETSc.Mat())
            E.axpy(c * cd, D, structure=held)
            D.destroy()
        return E

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for factor in (self.kept_factors or {}).values():
            factor.destroy()
        own = (A for A in (self._with_extra, self.rest_damping, self._unstressed, self.D) if A is not None)
        for x in (self.K, *self._work, *own):
            x.destroy()
        super().destroy()
