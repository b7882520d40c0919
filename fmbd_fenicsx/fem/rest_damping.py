"""Damping by the stiffness K_0 of the body without stress, for bodies with an energy: force beta R K_0 R^T u'.

R is the mean rotation of a body in world axes, one in a floating frame. Newton's matrix holds R K_0 R^T beside the tangent K(u),
with the R of the last tangent: with beta K(u) instead a strained body does not converge once beta is of the size of the step.
With a pressure, K_0 is the stiffness at constant pressure: parts that turn against R would be braked by lambda otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..rotations import Array

if TYPE_CHECKING:
    from .fields import Field

SAME_TURN = 1e-3  # rad: a stiffness turned by less is as good for Newton's rate


class RestDamping:
    """R K_0 R^T of a field, K_0 to begin with; collective to turn and to destroy."""

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
