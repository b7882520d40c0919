"""The multipliers' Schur complement itself as a preconditioner: for tests, and for few multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import scipy.sparse as sp

from .precondition import to_petsc
from .presets import Schur
from .saddle import SaddlePoint


@dataclass(frozen=True)
class Exact:
    """S itself (dense, needs inertia): three MINRES iterations whatever the system (Murphy, Golub and Wathen,
    doi:10.1137/S1064827599355153). For tests of signs and transposes, and for few multipliers.
    """

    def matrices(self, saddle: SaddlePoint) -> list[tuple[str, list[int], Any]]:
        """One group for all ties; collective."""
        solver = Schur().solver(saddle, "exact_")
        S = sp.csr_matrix(solver.complement)
        solver.destroy()
        return [("multipliers", list(range(len(saddle.ties))), to_petsc(S, saddle, [t.rows for t in saddle.ties]))]
