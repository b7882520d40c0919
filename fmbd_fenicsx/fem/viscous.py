"""Damping of a displacement field: Kelvin-Voigt's, and that by the stiffness without stress.

Kelvin-Voigt's is a constant matrix, or a law of displacement and rate with its tangent: the first f = D u' with D from
viscous(u', v, dx), the second f(u, u') . w = form(u, u', w, dx) of a :class:`~fmbd_fenicsx.energies.ViscousForm` with D the
symmetric half of df/du' where the field is linearised.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..energies import ViscousForm
from ..errors import InputError
from ..rotations import Array
from .assembly import NodalVector

if TYPE_CHECKING:
    from .fields import Field


def symmetric(a: Any) -> Any:
    """(a(u, v) + a(v, u)) / 2 of a bilinear UFL form."""
    import ufl

    return 0.5 * (a + ufl.adjoint(a))


class Viscous:
    """Damping of one field; collective to build. ``matrix``: D, or None; ``form``: its compiled form; ``law``: the UFL form
    of a :class:`.ViscousForm` at (field.argument, rate), or None, and ``residual`` what is compiled of it.
    """

    def __init__(self, field: Any, viscous: Any) -> None:
        import dolfinx.fem.petsc as fp
        import ufl
        from dolfinx import fem

        self.field = field
        self.law: Any = None
        self.matrix: Any = None
        self.rate: Any = None
        self.forms: tuple[Any, ...] = ()  # what was given, compiled
        if viscous is None:
            return
        u = ufl.TrialFunction(field.space)
        v = ufl.TestFunction(field.space)
        dx = field.elastic_measure
        try:
            if isinstance(viscous, ViscousForm):
                self.rate = fem.Function(field.space)
                self._linearised: Array = np.zeros(field.n * field.dim)
                self.law = viscous(field.argument, self.rate, v, dx)
                # the force is the law's own; Newton's matrix its symmetric part
                self.residual = NodalVector(compat.form(self.law))
                self.form = compat.form(symmetric(ufl.derivative(self.law, self.rate, u)))
                self.forms = (self.residual.form,)
            else:
                self.form = compat.form(viscous(u, v, dx))
                self.forms = (self.form,)
            self.matrix = fp.create_matrix(self.form, "baij")
        except Exception as error:
            raise InputError(
                f'Body "{field.name}": viscous did not give a UFL form, (u, v, dx) bilinear or a ViscousForm of (u, rate, v, dx) '
                f"linear in v: {type(error).__name__}: {error}"
            ) from error
        self._assemble()

    def _assemble(self) -> None:
        import dolfinx.fem.petsc as fp

        self.matrix.zeroEntries()
        fp.assemble_matrix(self.matrix, self.form)
        self.matrix.assemble()

    def linearise(self, rate: Array) -> None:
        """Take D of a law at the field's argument and a rate (n d,); collective."""
        if self.law is not None:
            self._linearised = rate
            # forces evaluated since have put other rates in place
            self.restore()
            self._assemble()

    def restore(self) -> None:
        """Put the rate back to where D was taken; collective."""
        if self.law is not None:
            self._place(self._linearised)

    def _place(self, rate: Array) -> None:
        self.rate.x.array[: len(rate)] = rate
        self.rate.x.scatter_forward()

    def force(self, U: Array, rate: Array) -> Array:
        """Nodal forces (n d,) at displacements U and rates (n d,); collective."""
        if self.law is None:
            return np.asarray(self.field.damping(rate))
        argument = self.field.argument
        argument.x.array[: len(U)] = U
        argument.x.scatter_forward()
        self._place(rate)
        return self.residual.assembled()


SAME_TURN = 1e-3  # rad: a stiffness turned by less is as good for Newton's rate


class RestDamping:
    """Damping of bodies with an energy by the stiffness K_0 without stress, force beta R K_0 R^T u'; collective to turn and to
    destroy.

    R is the mean rotation of a body in world axes, one in a floating frame and to begin with. Newton's matrix holds R K_0 R^T
    beside the tangent K(u), with the R of the last tangent: with beta K(u) instead a strained body does not converge once beta
    is of the size of the step. With a pressure, K_0 is the stiffness at constant pressure: parts that turn against R would be
    braked by lambda otherwise.
    """

    def __init__(self, field: Field, K: Any) -> None:
        self.field, self.beta, self.at_rest = field, field.forms.stiffness_damping, K
        self.matrix = K
        self._R: Array = np.eye(field.dim)

    def turn(self, R: Array) -> None:
        """Take R (d, d), the turn of the body: its stiffness at this rotation is R K_0 R^T."""
        if np.abs(R - self._R).max() < SAME_TURN:
            return
        self._R = R
        into = None if self.matrix is self.at_rest else self.matrix
        self.matrix = self.field.stiffness_at((self.field.X @ R.T - self.field.X).ravel(), into)

    def destroy(self) -> None:
        """Free the matrix, where it is another than K_0."""
        if self.matrix is not self.at_rest:
            self.matrix.destroy()
