"""Tangents of a field that moves: its stiffness, and that of moving loads, of a viscous law, of a stress foretold.

Loads on the deformed body and a viscous law have a derivative in u. Newton's matrix holds the symmetric half of it.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import dolfinx_compat as compat
from ..rotations import Array
from .foretold_stress import geometric_change
from .viscous import symmetric

if TYPE_CHECKING:
    from .fields import Field


class MotionTangent:
    """Takes the tangent of one ``field`` at a state of its motion.

    ``foretells``: whether an increment of Newton foretells a stress, as for bodies with a stored energy.
    """

    def __init__(self, field: Field) -> None:
        self.field = field
        self.foretells = field.strain_energy is not None

    def take(self, t: float, U: Array, Ud: Array, increment: Array | None = None) -> None:
        """:meth:`.Field.linearise` at displacements U with rates Ud (n d,) and time t; collective.

        ``increment`` (n d,) of Newton that led to U: the stress is the one that it foretold, see :mod:`.foretold_stress`.
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
