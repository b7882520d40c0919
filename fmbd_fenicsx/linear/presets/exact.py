"""The multipliers' Schur complement itself as a preconditioner: for tests, and for few multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import scipy.sparse as sp

from ..saddle.precondition import Group
from ..saddle.saddle import SaddlePoint
from .multiplier_schur import Schur


@dataclass(frozen=True)
class Exact:
    """S itself (dense, needs inertia): three MINRES iterations whatever the system (Murphy, Golub and Wathen,
    doi:10.1137/S1064827599355153). For tests of signs and transposes, and for few multipliers.
    """

    def groups(self, saddle: SaddlePoint) -> list[Group]:
        """One group for all ties; collective."""
        solver = Schur(limit=saddle.n_multipliers).solver(saddle, "exact_")
        S = sp.csr_matrix(solver.complement)
        solver.destroy()
        return [("multipliers", list(range(len(saddle.ties))), S)]
