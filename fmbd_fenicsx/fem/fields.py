"""Displacement fields of elastic bodies: UFL forms in, constant matrices and nodal arrays out.

For displacements u in V_h (Lagrange, any degree) with nodal values U and material points X, in body axes,

    M_ij = int rho phi_i phi_j,   K = elastic form a(u, v),   Q = [M 1_k, M (e_k x X)]                       (1)

and, for every surface in use, the moments b_0, b_k of ``mechanics.frames`` as rows T of weights on its nodes. All of it is
assembled once. Arrays hold the nodes that this rank owns; sums over all ranks are made in a fixed order, so that
replicated numbers are equal on all ranks to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..energies import StoredEnergy
from ..errors import InputError
from ..ranks import together
from ..rotations import Array, motions
from .assembly import NodalVector, on_components
from .density import density_on, mean_density
from .elastic_forms import ElasticForms
from .energy_quadrature import integrated
from .field_checks import check_field
from .loads import AppliedLoads
from .rest_damping import RestDamping
from .rigid_constants import RigidConstants
from .surfaces import Moments
from .viscous import Viscous, symmetric

if TYPE_CHECKING:
    from .numbering import Numbering


def rank_sum(comm: Any, x: Array) -> Array:
    """Sum over ranks in the order of ranks: the same bits everywhere; collective."""
    if comm.size == 1:
        return x
    return np.sum(comm.allgather(x), axis=0)


class Field:
    """Matrices and nodal data of one displacement field on one mesh; collective to build.

    Attributes: ``X`` (n, d) owned nodes (m, relative to the centre of mass), ``mass_total`` (kg), ``center`` (d,),
    ``inertia`` (n_rot, n_rot) about the centre of mass, ``Q`` (n d, n_twist), ``n`` owned nodes.
    """

    mixed = False  # whether a pressure belongs to the displacements
    indefinite = False  # whether a tangent of it was found to be so: compressed bodies
    carried = False  # whether that pressure is an unknown of its own
    keeps_volume: bool = False  # whether that pressure keeps J = 1
    loads: AppliedLoads
    kept_factors: dict[float, Any] | None = None  # of K + s M by s, where several bases are computed with one field

    def __init__(self, name: str, mesh: Any, forms: ElasticForms) -> None:
        import dolfinx.fem.petsc as fp
        import ufl
        from dolfinx import fem

        compat.check_versions()
        self.name, self.forms, self.mesh = name, forms, mesh
        self.redistributed = False
        msh = mesh.dolfinx
        self.comm = msh.comm
        self.dim = d = mesh.dim
        self.motions = motions(d)

        # one numbering of nodes for displacements and for what has one component
        self.space = fem.functionspace(msh, ("Lagrange", forms.degree, (d,)))
        self.n = self.space.dofmap.index_map.size_local
        self.n_global = self.space.dofmap.index_map.size_global * d
        self.scalar_space = scalar = fem.functionspace(msh, ("Lagrange", forms.degree))
        same = np.array_equal(self.space.dofmap.list, scalar.dofmap.list)
        together(self.comm, None if same else RuntimeError("DOLFINx numbered scalar and vector spaces differently"))

        # inertia: the same of every component
        dx = mesh.dx
        p, q = ufl.TrialFunction(scalar), ufl.TestFunction(scalar)
        self.rho = density_on(mesh, forms.density)
        self.M = fp.assemble_matrix(compat.form(self.rho * p * q * dx))
        self.M.assemble()

        # elasticity, without stress to begin with
        self.elastic_measure = dx if forms.quadrature is None else dx(metadata={"quadrature_degree": forms.quadrature})
        self._elastic_form(self.elastic_measure)
        self.K = fp.create_matrix(self.stiffness_form, "baij")
        self.tangents = -1
        self._with_extra: Any = None
        self.rest_damping: RestDamping | None = None  # beside a tangent
        self._unstressed: Any = None  # K of the body without stress, where stiffness_damping has to know it
        self.linearise(None)

        # vectors to work in, and what all this says of the body
        self._work = [self.M.createVecRight(), self.M.createVecLeft()]
        self._big = [self.K.createVecRight(), self.K.createVecLeft()]
        self._rigid_properties()
        check_field(self)
        self.loads = AppliedLoads(self, forms.loads)
        self.viscous = Viscous(self, forms.viscous)
        self.D = self.viscous.matrix

    @property
    def argument(self) -> Any:
        """The function of the displacements in the forms of an energy."""
        return self._w

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
            energy, self.elastic_measure = integrated(
                lambda dx: density(self._w, dx), dx, degree=self.forms.degree, chosen=self.forms.quadrature is not None
            )
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
            self._place(np.zeros(self.n * self.dim) if U is None else U)

        if self.tangents < 0 or self.nonlinear:
            self.K.zeroEntries()
            fp.assemble_matrix(self.K, self.stiffness_form)
            self.K.assemble()
        # damping by stiffness is that of the body without stress
        if self.tangents < 0 and self.nonlinear and (self.carried or self.forms.stiffness_damping > 0):
            self._unstressed = self.K.copy()
            if not self.mixed:
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

        self._place(U)
        into = self._with_places() if into is None else into
        into.zeroEntries()
        fp.assemble_matrix(into, self.stiffness_form)
        into.assemble()
        return into

    def _place(self, U: Array) -> None:
        """Nodal values of the energy's argument, ghosts included; collective."""
        nodal = self._w.x
        nodal.array[: len(U)] = U
        nodal.scatter_forward()

    # -- products -----------------------------------------------------------------------------------------------
    def mass(self, A: Array) -> Array:
        """M A for nodal vectors, (n, d) -> (n, d)."""
        x, y = self._work
        out = np.empty_like(A)
        for k in range(self.dim):
            x.array[:] = A[:, k]
            self.M.mult(x, y)
            out[:, k] = y.array
        return out

    def stiffness(self, U: Array) -> Array:
        """K U, (n d,) -> (n d,)."""
        return self._times(self.K, U)

    def stiffness_at_rest(self, U: Array) -> Array:
        """K_0 U with the stiffness of the body without stress, what stiffness_damping acts by, (n d,) -> (n d,)."""
        return self.stiffness(U) if self._unstressed is None else self._times(self._unstressed, U)

    def dampings(self) -> list[tuple[float, Any]]:
        """What stands at cd in :meth:`combination`, with factors: the viscous form, K_0 beside a tangent."""
        own, rest = [] if self.D is None else [(1.0, self.D)], self.rest_damping
        return own if rest is None else [*own, (rest.beta, rest.matrix)]

    def damping_in_tangent(self, U: Array) -> Array:
        """The matrix at cd of :meth:`combination` times U, (n d,) -> (n d,)."""
        return sum((c * self._times(A, U) for c, A in self.dampings()), np.zeros_like(U))

    @property
    def extended(self) -> bool:
        """Whether the stiffness of :meth:`combination` is more than K, by :meth:`linearise`, or changes with the motion."""
        return bool(self.nonlinear or self._extra)

    def tangent(self, U: Array) -> Array:
        """K U with the extra form of :meth:`linearise`: the matrix that :meth:`combination` holds."""
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
        x, y = self._big
        x.array[:] = U
        A.mult(x, y)
        return y.array.copy()

    def internal(self, U: Array) -> Array:
        """Internal forces K U, or dPi/du, (n d,) -> (n d,); collective."""
        if not self.nonlinear:
            return self.stiffness(U)
        self._place(U)
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

        self._place(U)
        return float(self.total(np.array(fem.assemble_scalar(self._energy_form))))

    @cached_property
    def moving_tangent(self) -> Any:
        """Compiled stiffness of loads on the deformed body and of a nonlinear viscous law, symmetric half; None without."""
        import ufl

        parts = [self.viscous.law] if self.viscous.law is not None else []
        if self.loads.moving:
            parts.append(-self.loads.moving_form(self._w, ufl.TestFunction(self.space)))
        if not parts:
            return None
        return compat.form(symmetric(ufl.derivative(sum(parts), self._w, ufl.TrialFunction(self.space))))

    def linearise_motion(self, t: float, U: Array, Ud: Array, increment: Array | None = None) -> None:
        """:meth:`linearise` at displacements U with rates Ud (n d,), moving loads and viscous law included; collective.

        ``increment`` (n d,) of Newton that led to U: the stress is the one that it foretold, see :mod:`.foretold_stress`.
        """
        self.loads.at(t)
        self._place(U)
        self.viscous.linearise(Ud)
        moving = () if self.moving_tangent is None else (self.moving_tangent,)
        if increment is None or not self.foretells:
            self.linearise(U, *moving)
            return
        self.linearise(U, *moving, self._foretold(increment))
        if not np.isfinite(self._with_extra.norm()):  # too far for a law that has no stress there
            self.linearise(U, *moving)

    @property
    def foretells(self) -> bool:
        """Whether an increment foretells a stress: bodies with a stored energy."""
        return isinstance(self.forms.energy, StoredEnergy)

    def _foretold(self, increment: Array) -> Any:
        """The change of the tangent by the stress that an increment foretold."""
        self._increment.x.array[: len(increment)] = increment
        self._increment.x.scatter_forward()
        return self._geometric_change

    @cached_property
    def _increment(self) -> Any:
        from dolfinx import fem

        return fem.Function(self.space)

    @cached_property
    def _geometric_change(self) -> Any:
        from .foretold_stress import geometric_change

        return geometric_change(self, self._increment)

    def damping(self, U: Array) -> Array:
        """D U, (n d,) -> (n d,); zero without a viscous form."""
        return np.zeros_like(U) if self.D is None else self._times(self.D, U)

    def total(self, x: Array) -> Array:
        """Sum of a rank-local contribution over the ranks."""
        return rank_sum(self.comm, x)

    def points(self, U: Array) -> Array:
        """P = X + U, (n, d)."""
        return self.X + U.reshape(-1, self.dim)

    @cached_property
    def mass_form(self) -> Any:
        """The compiled form of M on vectors."""
        import ufl

        u, v = ufl.TrialFunction(self.space), ufl.TestFunction(self.space)
        return compat.form(self.rho * ufl.inner(u, v) * self.mesh.dx)

    @cached_property
    def mean_density(self) -> float:
        """Mass over volume, kg/m^3; collective."""
        return mean_density(self)

    def combination(self, cm: float, ck: float, cd: float = 0.0) -> Any:
        """The PETSc matrix cm M + cd D + ck K (symmetric, aij) of those that are held; collective. The caller destroys it."""
        from petsc4py import PETSc

        held = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
        if self.redistributed:  # neighbours of neighbours
            held = PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN
        E = self.stiffness_matrix.convert("aij", PETSc.Mat())
        E.scale(ck)
        M = self.mass_matrix()
        E.axpy(cm, M, structure=held)
        M.destroy()
        for c, A in self.dampings() if cd else ():
            D = A.convert("aij", PETSc.Mat())
            E.axpy(c * cd, D, structure=held)
            D.destroy()
        return E

    def mass_matrix(self) -> Any:
        """The scalar mass matrix on each component of vectors (aij); collective. The caller destroys it."""
        return on_components(self.M, self.dim)

    def replace_mass(self, M: Any) -> None:
        """Use another scalar mass matrix with the same layout from now on (see ``mechanics.contact.mass``); collective."""
        self.M.destroy()
        self.M, self.redistributed = M, True
        self._rigid_properties()

    # -- constants ----------------------------------------------------------------------------------------------
    def _rigid_properties(self) -> None:
        """What (1) says of the field as a rigid body; collective."""
        self.X_world = self.space.tabulate_dof_coordinates()[: self.n, : self.dim]
        found = RigidConstants.of(self.X_world, self.mass, self.total, self.motions, self.comm)
        self.mass_total, self.center, self.inertia, self.size = found.mass, found.center, found.inertia, found.size
        self.X, self.Q = found.X, found.Q

    @cached_property
    def moments(self) -> Callable[[str], Moments]:
        """Moments of a named surface, assembled at first use: ``field.moments("pin")``; collective."""

        def of(surface: str) -> Moments:
            known = self.known_moments
            if surface not in known:
                known[surface] = Moments(self.scalar_space, self.mesh, surface, self.center, self.n)
            return known[surface]

        return of

    @cached_property
    def known_moments(self) -> dict[str, Moments]:
        """Those assembled so far, by surface; another field of the same body may take them."""
        return {}

    @cached_property
    def numbering(self) -> Numbering | None:
        """Numbers of the nodes that do not depend on the ranks; None for fields that every rank holds whole. Collective."""
        from .numbering import Numbering

        return Numbering(self.space)

    def destroy(self) -> None:
        """Free the PETSc objects; collective."""
        for factor in (self.kept_factors or {}).values():
            factor.destroy()
        own = (A for A in (self._with_extra, self.rest_damping, self._unstressed, self.D) if A is not None)
        for x in (self.M, self.K, *self._work, *self._big, *own):
            x.destroy()
