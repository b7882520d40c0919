"""Tangents of a field that moves: its stiffness, and that of moving loads, of a viscous law, of a stress foretold.

Loads on the deformed body and a viscous law have a derivative in u. Newton's matrix holds the symmetric half of it.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array
from .viscous import symmetric

if TYPE_CHECKING:
    from .fields import Field


def geometric_change(field: Any, increment: Any) -> Any:
    """Compiled form of what (1) adds to the tangent of a field with a stored energy W(C), for the ``increment`` d of Newton, a
    function: the tangent has the stress that d foretold, in place of that where it led.

    d turns parts of a thin body along straight lines, which stretches them by grad(d)^T grad(d) / 2: a strain of the second
    order that the linear solution does not know of, and that the next increment takes back. Its stress, times the large
    stiffness along the body, is of no use in a tangent: where it presses, the tangent is indefinite, and the iteration is lost.
    With the stress of the linear solution in the geometric part,

        K = int dE : W'' : DE + S(C - grad(d)^T grad(d)) : grad(du)^T grad(dv),    S = 2 dW/dC,    C = F^T F,         (1)

    the iteration converges in about as many increments as one with stresses as unknowns of their own. The forces stay those of
    the configuration.

    An increment changes volumes by the second order too, which a large bulk modulus turns into a pressure. Where the pressure
    is eliminated, C p = b(u), the tangent has that of the linear solution,

        C p = b(u - d) + B d,        B of the tangent that d was found with,                                           (2)

    and the increments are those of an iteration for u and p: its rate does not depend on the bulk modulus.

    Source: Magisano, Leonetti and Garcea, doi:10.1016/j.cma.2016.10.023 (mixed integration points).
    """
    import ufl

    dx, w = field.elastic_measure, field.argument
    density = field.strain_energy
    F = ufl.Identity(field.dim) + ufl.grad(w)
    D = ufl.grad(increment)

    def stress(C: Any) -> Any:
        C = ufl.variable(C)
        return 2.0 * ufl.diff(density(C), C)

    du = ufl.TrialFunction(field.space)
    dv = ufl.TestFunction(field.space)
    change = stress(F.T * F - D.T * D) - stress(F.T * F)
    return compat.form(ufl.inner(change, ufl.sym(ufl.grad(du).T * ufl.grad(dv))) * dx)


class MotionTangent:
    """Takes the tangent of one ``field`` at a state of its motion.

    ``foretells``: whether an increment of Newton foretells a stress, as for bodies with a stored energy.
    """

    def __init__(self, field: Field) -> None:
        self.field = field
        self.foretells = field.strain_energy is not None

    def take(self, t: float, U: Array, Ud: Array, increment: Array | None = None) -> None:
        """:meth:`.Field.linearise` at displacements U with rates Ud (n d,) and time t; collective.

        ``increment`` (n d,) of Newton that led to U: the stress is the one that it foretold, see :func:`geometric_change`.
        """
        field = self.field
        field.loads.at(t)
        field.place(U)
        field.viscous.linearise(Ud)
        moving = () if self._moving is None else (self._moving,)
        if increment is None or not self.foretells:
            field.linearise(U, *moving)
            return

        field.linearise(U, *moving, self._foretold(increment))
        if not np.isfinite(field.stiffness_matrix.norm()):  # too far for a law that has no stress there
            field.linearise(U, *moving)

    @cached_property
    def _moving(self) -> Any:
        """Compiled stiffness of loads on the deformed body and of a viscous law; None without."""
        import ufl

        field = self.field
        parts = [] if field.viscous.law is None else [field.viscous.law]
        if field.loads.moving:
            parts.append(-field.loads.moving_form(field.argument, ufl.TestFunction(field.space)))
        if not parts:
            return None
        return compat.form(symmetric(ufl.derivative(sum(parts), field.argument, ufl.TrialFunction(field.space))))

    def _foretold(self, increment: Array) -> Any:
        """The change of the tangent by the stress that an increment foretold."""
        d, form = self._change
        d.x.array[: len(increment)] = increment
        d.x.scatter_forward()
        return form

    @cached_property
    def _change(self) -> tuple[Any, Any]:
        """The increment as a function, and the compiled form of what it changes."""
        from dolfinx import fem

        d = fem.Function(self.field.space)
        return d, geometric_change(self.field, d)
