"""Geometric stiffening: the initial stress of the inertia forces acts on the small displacements of a floating body.

A body that is held by a surface, accelerated by a and turned with L = w'~ + w~ w~ carries, to first order, the stress of

    K u_0 + C mu = -M (a + L X),     C^T u_0 = 0                                                             (1)

with C the mean motion of that surface: the surface of an attached frame, or one that the user names.
Displacements u then work against this stress on the nonlinear part of the strain,

    K_g(u_0)(w, v) = int sigma(u_0) : sym(grad w^T grad v)                                                   (2)

It is linear in (a, L), so u_0 is a sum of d + d^2 constant fields. (2) is made from the user's own elastic form a(u, v): in
a(u_0, v) each grad(v) becomes grad(w)^T grad(v). Without (2) a beam that spins faster than its first bending frequency (in
the plane of rotation) has no stable linear solution.

Source: Wallrapp and Schwertassek, doi:10.1002/nme.1620320818.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..rotations import Array
from ..traces.fields import Field


def geometric_form(form: Any, v: Any, w: Any) -> Any:
    """``form`` with every grad(v) replaced by grad(w)^T grad(v), v its test function."""
    import ufl
    from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
    from ufl.algorithms.apply_derivatives import apply_derivatives
    from ufl.algorithms.map_integrands import map_integrand_dags
    from ufl.corealg.multifunction import MultiFunction

    class Replace(MultiFunction):  # type: ignore[misc]
        expr = MultiFunction.reuse_if_untouched

        def grad(self, o: Any) -> Any:
            return ufl.dot(ufl.transpose(ufl.grad(w)), o) if o.ufl_operands[0] is v else o

    return map_integrand_dags(Replace(), apply_derivatives(apply_algebra_lowering(form)))


class Stiffening:
    """(1), (2) for one field; collective to build and to use."""

    def __init__(self, field: Field, conditions: Array) -> None:
        import ufl
        from dolfinx import fem

        from .. import dolfinx_compat as compat
        from .modes import ConditionedBody

        self.field = field
        d = field.dim
        body = ConditionedBody(field, conditions)
        columns = []
        for X in [np.tile(e, (field.n, 1)) for e in np.eye(d)] + [
            np.outer(field.X[:, j], np.eye(d)[i]) for i in range(d) for j in range(d)
        ]:
            columns.append(body.solve_static(-field.mass(X).ravel()))
        body.destroy()
        self.columns = np.stack(columns, axis=1)  # (n d, d + d^2): u_0 for unit a_c and unit L_ij
        self._u0, self._w = fem.Function(field.space), fem.Function(field.space)
        u, v = ufl.TrialFunction(field.space), ufl.TestFunction(field.space)
        stress, self._p0 = field.stress_form(self._u0, v)
        self._force_form = compat.form(geometric_form(stress, v, self._w))
        self.matrix_form = compat.form(geometric_form(stress, v, u))

    def _place(self, function: Any, U: Array) -> None:
        function.x.array[: len(U)] = U
        function.x.scatter_forward()

    def _hold(self, U: Array) -> None:
        """Take U as u_0, with its pressure where the body has one."""
        self._place(self._u0, U)
        if self._p0 is not None:
            self._p0.x.array[:] = self.field.pressure_of(U).x.array

    def set_load(self, coefficients: Array) -> None:
        """Take u_0 for (a, L) as a flat array (d + d^2,)."""
        self._hold(self.columns @ coefficients)

    def force(self, coefficients: Array, U: Array) -> Array:
        """K_g U, (n d,); collective."""
        from dolfinx import fem, la

        self.set_load(coefficients)
        self._place(self._w, U)
        b = fem.assemble_vector(self._force_form)
        b.scatter_reverse(la.InsertMode.add)
        return np.array(b.array[: len(U)])

    def modal(self, phi: Array) -> Array:
        """phi^T K_g phi for every unit load, (d + d^2, m, m); collective."""
        import dolfinx.fem.petsc as fp

        f, m = self.field, phi.shape[1]
        out = np.zeros((self.columns.shape[1], m, m))
        A = fp.create_matrix(self.matrix_form)
        x, y = A.createVecs()
        for k in range(len(out)):
            self._hold(self.columns[:, k])
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
