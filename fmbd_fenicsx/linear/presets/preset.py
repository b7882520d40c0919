"""What every preset says: how linear systems are solved, of statics and of the steps of a scene."""

from __future__ import annotations

from typing import Any

from ...fem.fields import Field
from ..core import TIE_LIMIT
from ..saddle.saddle import SaddlePoint, SaddleSolver


class Preset:
    """A way to solve linear systems, of statics by :meth:`solver` and of the steps of a scene by the others.

    ``limit``: multipliers of surface ties in a scene that its dense core takes. ``multiplier``: the preconditioner with which
    more of them are iterated on to the relative residual ``rtol``; None refuses them.
    """

    limit: int = TIE_LIMIT
    multiplier: Any = None
    rtol: float = 0.0

    def solver(self, saddle: SaddlePoint, prefix: str = "fmbd_") -> SaddleSolver:
        """Set up for a saddle point; collective."""
        raise NotImplementedError

    def block(self, field: Field, weights: tuple[float, float, float], prefix: str) -> Any:
        """The solver of cm M + cd D + ck K, weights (cm, cd, ck), of one body in a scene; collective."""
        raise NotImplementedError

    def split(self, system: Any, prefix: str) -> Any:
        """The solver of the whole matrix of a scene's step; None where fields are eliminated one by one. Collective."""
        return None
