"""Geometric stiffening: the stress of the forces on a floating body acts on its small displacements.

A body that is held by a surface, accelerated by a, turned with L = w'~ + w~ w~ and loaded by nodal forces f carries, to first
order, the stress of

    K u_0 + C mu = f - M (a + L X),     C^T u_0 = 0                                                          (1)

with C the mean motion of that surface: the surface of an attached frame, or one that the user names.
Displacements u then work against this stress on the nonlinear part of the strain,

    K_g(u_0)(w, v) = int sigma(u_0) : sym(grad w^T grad v)                                                   (2)

It is linear in (a, L, f): d + d^2 constant fields for inertia, d^2 for each load of ``fem.loads``, and one for each unit
force and moment on every other surface, which joints, springs and forces act on
(``mechanics.elastic.foreshortening``). Loads that are carried along with the material turn with it, too
(:class:`TurnedLoads`). Thermal stress is left out.
a and L are those of the mean motion of the body, and second-order displacements have inertia, too
(``mechanics.elastic.second_order``). (2) is made from the user's own elastic form a(u, v): in a(u_0, v) each
grad(v) becomes grad(w)^T grad(v). Without (2) a beam that spins faster
than its first bending frequency (in the plane of rotation) has no stable linear solution.

Source: Wallrapp and Schwertassek, doi:10.1002/nme.1620320818.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...fem.assembly import times_columns
from ...fem.fields import Field
from ...fem.loads import Load, with_gradients
from ...fem.viscous import symmetric
from ...rotations import Array, axial
from ..frames import polar
from .foreshortening import Shortening, rigid_ports
from .second_order import DisplacementMoments, SecondOrder, load_moment

NOTHING = 1e-12  # nodal forces in one direction below this share of the largest are roundoff of normals


def resultant_columns(field: Field, surface: str) -> Array:
    """Nodal forces (n d, d + n_rot) of a unit force and a unit moment on a surface, as its marker puts them there."""
    moments = field.moments(surface)
    m = field.motions
    d = field.dim
    F = moments.reference[1:].T[None]
    # how the surface's rotation answers to its moments, at rest
    Z = polar(F)[1][0]

    out = np.zeros((field.n, d, d + m.n_rot))
    out[moments.nodes[:, None], range(d), range(d)] = moments.weights[:, :1]
    for k in range(m.n_rot):
        out[moments.nodes, :, d + k] = moments.weights[:, 1:] @ m.spin(Z[k : k + 1], np.eye(d))
    return out.reshape(-1, d + m.n_rot)


def products(matrices: Sequence[Any], d: int, U: Array) -> Array:
    """Columns A U (n d, count) of scalar PETSc matrices that act on each of d components alike, the first of them not None: those
    that are None are zero; collective.
    """
    out = np.zeros((len(U) // d, d, len(matrices)))
    x, y = matrices[0].createVecs()
    for c in range(d):
        x.array[:] = U[c::d]
        for k, A in enumerate(matrices):
            if A is not None:
                A.mult(x, y)
                out[:, c, k] = y.array
    x.destroy()
    y.destroy()
    return out.reshape(len(U), len(matrices))


class TurnedLoads:
    """What displacements of one ``field`` add to the nodal forces b of loads that are carried along with its material,

        s(t) B u,     B u = dL(0; v)[u],                                                                     (3)

    to first order: a pressure turns with its surface and acts on the stretched one. Collective to build and to use.
    """

    def __init__(self, field: Field) -> None:
        import dolfinx.fem.petsc as fp
        from dolfinx import fem

        self.field = field
        self.loads = [(load, b) for load, b in field.loads.fixed if load.carried]
        forms = [field.loads.turning_form(load) for load, _ in self.loads]
        self._factors = [fem.Constant(field.mesh.dolfinx, 0.0) for _ in forms]
        self._matrices = [fp.assemble_matrix(compat.form(form)) for form in forms]
        for A in self._matrices:
            A.assemble()
        # the symmetric half of their stiffness
        stiffness = [-symmetric(factor * form) for factor, form in zip(self._factors, forms, strict=True)]
        self.matrix_forms = [compat.form(sum(stiffness[1:], stiffness[0]))] if stiffness else []

    def set_time(self, t: float) -> None:
        """Take the factors of :attr:`matrix_forms` at time t."""
        for (load, _), factor in zip(self.loads, self._factors, strict=True):
            factor.value = load.factor(t, self.field.name)

    @property
    def matrices(self) -> list[tuple[Load, Any]]:
        """Each load with its B."""
        return [(load, A) for (load, _), A in zip(self.loads, self._matrices, strict=True)]

    def columns(self, U: Array) -> list[tuple[Load, Array, Array]]:
        """Of each load for columns of displacements U (n d, k): B U (n d, k), and the rows of the frame (n_twist, k) by it and by
        the ways of b.
        """
        f, d = self.field, self.field.dim
        found = []
        for (load, b), A in zip(self.loads, self._matrices, strict=True):
            more = times_columns(A, U)
            turned, moved = (x.reshape(f.n, d, U.shape[1]) for x in (more, U))
            moment = [axial(f.X.T @ turned[:, :, k] + moved[:, :, k].T @ b) for k in range(U.shape[1])]
            frame = np.concatenate((turned.sum(0), np.reshape(moment, (U.shape[1], -1)).T))
            found.append((load, more, np.asarray(f.total(frame))))
        return found

    def rows(self, t: float, U: Array) -> tuple[Array, Array]:
        """What displacements U (n d,) add to the forces of all loads, on the frame (n_twist,) and on the nodes (n d,)."""
        frame, nodal = np.zeros(self.field.motions.n_twist), np.zeros(len(U))
        for load, more, on_frame in self.columns(U[:, None]):
            factor = load.factor(t, self.field.name)
            frame += factor * on_frame[:, 0]
            nodal += factor * more[:, 0]
        return frame, nodal


class Stiffening:
    """(1), (2) for one field; collective to build and to use.

    ``surfaces``: those whose forces stiffen the body, beside inertia and loads; the one that holds it is not among them.
    """

    def __init__(self, field: Field, conditions: Array, surfaces: Sequence[str] = ()) -> None:
        import ufl
        from dolfinx import fem

        from .modes import ConditionedBody

        self.field = field
        d = field.dim
        body = ConditionedBody(field, conditions)

        def static(loads: Any) -> Array:
            """u_0 (n d, k) of nodal forces; those that are zero, but for roundoff beside the others, cost nothing."""
            found = np.stack([f.ravel() for f in loads], axis=1)
            sizes = field.total(np.abs(found).sum(axis=0))
            acts = sizes > NOTHING * sizes.max()
            out = np.zeros_like(found)
            out[:, acts] = body.solve_static(found[:, acts])
            return out

        # inertia forces of a rigid motion: unit accelerations e_c, and e_i x_j for each entry of L
        pairs = [(i, j) for i in range(d) for j in range(d)]
        inertia = [np.tile(e, (field.n, 1)) for e in np.eye(d)] + [
            np.outer(field.X[:, j], np.eye(d)[i]) for i, j in pairs
        ]
        self.columns = static([-field.mass(X) for X in inertia])  # (n d, d + d^2): u_0 for unit a_c and unit L_ij

        self.loads = [(load, b) for load, b in field.loads.fixed if not load.internal]
        self.turned = TurnedLoads(field)
        self.load_columns = [static([np.outer(b[:, i], np.eye(d)[j]) for i, j in pairs]) for _, b in self.loads]
        self.section_columns = {s: static(resultant_columns(field, s).T) for s in surfaces}
        body.destroy()

        self._all = np.concatenate([self.columns, *self.load_columns], axis=1)
        self._of_surfaces: list[Any] = []  # K_g of unit forces and moments on surfaces in use, likewise
        self._u0 = fem.Function(field.space)

        u = ufl.TrialFunction(field.space)
        v = ufl.TestFunction(field.space)
        stress, self._p0 = field.stress_form(self._u0, v)
        self.matrix_form = compat.form(with_gradients(stress, v, lambda slope: ufl.dot(ufl.grad(u).T, slope))[0])

    def coefficients(self, inertia: Array, t: float, R: Array) -> Array:
        """Of inertia (a, L), (d + d^2,), and of the loads at time t in the axes R."""
        axes = np.eye(self.field.dim)
        factors = [f.factor(t, self.field.name) * (axes if f.follower else R).ravel() for f, _ in self.loads]
        return np.concatenate((inertia, *factors))

    def shortening(self, surfaces: Sequence[str], first: int, n_port: int) -> Shortening | None:
        """(1) of ``mechanics.elastic.foreshortening`` for the ports of surfaces in this order, the first at number
        ``first``.
        """
        m = self.field.motions
        d = self.field.dim
        f = self.field
        G = self._of_surfaces
        blocks: list[Array] = []
        for i, s in enumerate(surfaces):
            if s in self.section_columns:
                # ports of this surface alone, among those of all
                own = rigid_ports(m, f.moments(s).reference)
                block = np.zeros((n_port, own.shape[1]))
                block[first + i * len(own) : first + (i + 1) * len(own)] = own
                blocks.append(block)
                G += [self._scalar(u) for u in self.section_columns[s].T]

        if not G:
            return None

        return Shortening(partial(products, G, d), np.concatenate(blocks, axis=1), f.total)

    def of_trace(self, B: Any, surface: str, count: int) -> Array:
        """What (1) of ``mechanics.elastic.foreshortening`` does to ports B u of a surface, (rows, ``count``); collective."""
        f, m = self.field, self.field.motions
        each = m.dim + m.n_rot
        out = np.zeros((B.shape[0], count))
        if surface in self.section_columns:
            # the surface goes and turns as one about its centroid
            rigid = m.rigid(f.X - f.moments(surface).reference[0]).reshape(-1, each)
            first = each * list(self.section_columns).index(surface)
            out[:, first : first + each] = f.total(B @ rigid)
        return out

    @cached_property
    def _matrices(self) -> list[Any]:
        """K_g for each of :meth:`coefficients` on one component, None where nothing acts; collective."""
        acts = self.field.total(np.abs(self._all).sum(axis=0)) > 0
        return [self._scalar(u) if some else None for u, some in zip(self._all.T, acts, strict=True)]

    def bent(self, U: Array) -> Array:
        """Columns K_g U (n d, :attr:`count`) for each of :meth:`coefficients`; collective."""
        return products(self._matrices, self.field.dim, U)

    @cached_property
    def entries(self) -> tuple[Any, Array]:
        """The matrices of inertia, of :meth:`shortening` and of loads, on one rank: their common pattern, a sparse matrix of
        nodes, and the values of its entries (entries, matrices).
        """
        import scipy.sparse as sp

        d, n = self.field.dim, self.field.n
        first, nothing = d + d * d, (np.zeros(n + 1, int), np.zeros(0, int), np.zeros(0))
        every = (*self._matrices[:first], *self._of_surfaces, *self._matrices[first:])
        found = [nothing if A is None else A.getValuesCSR() for A in every]
        places = [np.repeat(np.arange(n) * n, np.diff(start)) + columns for start, columns, _ in found]
        known = np.unique(np.concatenate(places))
        values = np.zeros((len(known), len(found)))
        for k, (place, (_, _, x)) in enumerate(zip(places, found, strict=True)):
            values[np.searchsorted(known, place), k] = x
        return sp.csr_matrix((np.ones(len(known)), (known // n, known % n)), shape=(n, n)), values

    @cached_property
    def second(self) -> SecondOrder:
        """Inertia of the second-order displacements; collective."""
        f = self.field
        MX = self.first[:, f.dim :].reshape(f.n, f.dim, f.dim, f.dim)[:, 0, :, 0]
        return SecondOrder(f.mass_total, f.total(MX.T @ np.ones((f.n, 1)))[:, 0], f.total(MX.T @ f.X))

    @cached_property
    def first(self) -> Array:
        """Columns (n d, d + d^2) of int rho p and of int rho X p^T, as functions of nodal p."""
        f, d = self.field, self.field.dim
        one, MX = f.mass(np.ones((f.n, d)))[:, :1], f.mass(f.X)
        weights = np.concatenate((one, MX), axis=1)
        return np.einsum("nk,ce->nekc", weights, np.eye(d)).reshape(-1, (1 + d) * d)

    def moments(self, bent: Array, local: Sequence[Array]) -> DisplacementMoments:
        """Of ``mechanics.elastic.second_order`` and their rates, from :meth:`bent` of the first of local; collective."""
        d = self.field.dim
        k = d + d * d
        stacked = np.stack(local, axis=1)
        z = bent[:, :k].T @ stacked
        z[:, 0] *= 0.5
        if len(local) > 2:
            z[:, 2] += products(self._matrices[:k], d, local[1]).T @ local[1]
        stacked[:, 0] += self.field.X.ravel()
        both = self.field.total(np.stack((self.first.T @ stacked, z)))
        return DisplacementMoments.of(both[0], both[1], d)

    def load_moment(self, coefficients: Array, bent: Array, U: Array) -> Array:
        """Moment (n_rot,) in body axes of dead loads on the second-order displacements; collective."""
        d = self.field.dim
        k = d + d * d
        axes = coefficients[k:].reshape(-1, d, d)
        twice = self.field.total(bent[:, k:].T @ U).reshape(-1, d, d)
        out = np.zeros(self.field.motions.n_rot)
        for (load, _), A, z in zip(self.loads, axes, twice, strict=True):
            if not load.carried:
                out += load_moment(A, z)
        return out

    def _scalar(self, u: Array) -> Any:
        """K_g(u) on one component, a PETSc matrix like the scalar mass: (2) acts on each component alike."""
        import dolfinx.fem.petsc as fp
        from petsc4py import PETSc

        self._hold(u)
        A = fp.assemble_matrix(self.matrix_form)
        A.assemble()
        low, _ = A.getOwnershipRange()
        # every d-th row and column
        rows = PETSc.IS().createStride(self.field.n, low, self.field.dim, A.comm)
        out = A.createSubMatrix(rows, rows)
        A.destroy()
        rows.destroy()
        return out

    def _place(self, function: Any, U: Array) -> None:
        function.x.array[: len(U)] = U
        function.x.scatter_forward()

    def _hold(self, U: Array) -> None:
        """Take U as u_0, with its pressure where the body has one."""
        self._place(self._u0, U)
        if self._p0 is not None:
            self._p0.x.array[:] = self.field.pressure_of(U).x.array

    def tangent_forms(self, t: float, coefficients: Array, pull: Array | None = None) -> list[Any]:
        """Compiled forms of what stiffens at time t, for :meth:`coefficients` and forces ``pull`` on the surfaces."""
        U = self._all @ coefficients
        if pull is not None:
            U = U + np.concatenate(list(self.section_columns.values()), axis=1) @ pull
        self._hold(U)
        self.turned.set_time(t)
        return [self.matrix_form, *self.turned.matrix_forms]

    def modal(self, phi: Array, columns: Array) -> Array:
        """phi^T K_g phi for every column u_0, (columns, m, m); collective."""
        import dolfinx.fem.petsc as fp

        f, m = self.field, phi.shape[1]
        out = np.zeros((columns.shape[1], m, m))
        A = fp.create_matrix(self.matrix_form)
        x, y = A.createVecs()
        for k in range(len(out)):
            if not f.total(np.array(np.abs(columns[:, k]).sum())):
                continue
            # loads that are zero strain nothing
            self._hold(columns[:, k])
            A.zeroEntries()
            fp.assemble_matrix(A, self.matrix_form)
            A.assemble()
            for j in range(m):
                x.array[:] = phi[:, j]
                A.mult(x, y)
                out[k, :, j] = phi.T @ y.array
        for obj in (A, x, y):
            obj.destroy()
        return np.asarray(f.total(out))
