"""Section energies of the user's own, W(gamma, kappa, s) in UFL: stress and tangent by UFL's derivatives, compiled by FFCx."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...errors import CallbackError, InputError
from ...rotations import Array


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
