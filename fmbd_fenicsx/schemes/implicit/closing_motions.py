"""The motions N that close the constraints of implicit steps with elastic fields, see (1) of :mod:`.field_stages`.

G N = 1, and of all such motions N c is least in the metric of the matrix that the step is solved with.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.serialisation import Remembering, plain
from ..consistent import MASS

COLUMNS = 64  # multipliers for which N is kept as a matrix


class ClosingMotions(Remembering):
    """N of one step, in its ``metric``; collective."""

    keeps: ClassVar = {"metric": plain(Weights)}

    def __init__(self, solver: StepSolver) -> None:
        self.solver = solver
        self.metric = MASS
        self._begun: State | None = None
        self._at: Evaluation | None = None
        self._known: tuple[Evaluation, Weights, Array] | None = None  # N, and what it is taken for

    def begin(self, state: State) -> None:
        """N is that of the state at which a step begins."""
        self._begun, self._at = state, None

    def take(self, ev: Evaluation) -> None:
        """N is that of where derivatives are taken."""
        self._at = ev

    def _taken(self) -> Evaluation:
        if self._at is None:
            assert self._begun is not None
            self._at = self.solver.system.at(self._begun.t, self._begun.q)
        return self._at

    @property
    def columns(self) -> Array:
        """N, (n_v, n_lam), solved for once."""
        ev, known = self._taken(), self._known
        if known is None or known[0] is not ev or known[1] != self.metric:
            self.solver.prepare_once(ev, self.metric)
            self._known = known = ev, self.metric, self.solver.closing(np.eye(self.solver.system.n_lam))
        return known[2]

    def times(self, slips: Array) -> Array:
        """N c of slips (k, n_lam), (k, n_v); complex ones by their parts."""
        if slips.shape[1] <= COLUMNS:
            return slips @ self.columns.T

        self.solver.prepare_once(self._taken(), self.metric)
        closing = self.solver.closing
        if np.iscomplexobj(slips):
            return np.asarray(closing(slips.real.T).T + 1j * closing(slips.imag.T).T)
        return closing(slips.T).T
