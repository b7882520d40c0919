"""The system: blocks of unknowns side by side, balance of forces, constraints.

    balance      M(q) a + h(q, v, t) + G(q, t)^T lambda = 0                                     (1)
    constraints  g(q, t) = 0,    G v + g_t = 0,    G a + gamma(q, v, t) = 0                     (2)

What stands where is told by :mod:`.layout`, how long it is by :mod:`.lengths`; here is what a system does: increments of
configurations, evaluations of states.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..fem.given_numbers import GivenNumbers, refuse_changed
from ..rotations import Array
from . import configurations
from .evaluation import Evaluation
from .evaluation_batch import EvaluationBatch
from .evaluator import Evaluator, NumPyEvaluator
from .lengths import Measured

CHANGES_ON_THE_WAY = (
    "What changes in time is the factor time=... of a load (internal=True: a strain of its own). For another stiffness end the "
    "run by an event, set the value, and go on with run.next_scene()."
)


class System(Measured):
    """All bodies, constraints and forces of a scene, which evaluates their states; see the module for the equations."""

    # -- geometry of the configuration space, see :mod:`.configurations` ----------------------------------------------
    def compose(self, q: Array, xi: Array) -> Array:
        """Configuration after the increment xi (as v: body-axes rotation increments), q o exp(xi); leading axes broadcast."""
        return q + xi if configurations.flat(self) else self.evaluator.compose(q, xi)

    def difference(self, q0: Array, q1: Array, *, near: Array | None = None) -> Array:
        """The increment xi with compose(q0, xi) = q1: of all rotations the smallest, or the one nearest to that of ``near``."""
        return q1 - q0 if configurations.flat(self) else self.evaluator.difference(q0, q1, near)

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of local coordinates q o exp(xi) for the velocity v."""
        return v if self.motions.dim == 2 or not self.n_frames else self.evaluator.rate(xi, v)

    # -- evaluation ---------------------------------------------------------------------------------------------------
    @cached_property
    def evaluator(self) -> Evaluator:
        """Who evaluates states: NumPy, unless a run has asked for compiled code (:mod:`.compiled.states.evaluation`)."""
        return NumPyEvaluator(self)

    def evaluate_by(self, evaluator: Evaluator) -> Evaluator:
        """Let another one evaluate states from now on."""
        self.__dict__["evaluator"] = evaluator
        return evaluator

    def at(self, t: float, q: Array, v: Array | None = None) -> Evaluation:
        """The system in one configuration (and velocity); collective."""
        return self.evaluator.at(t, q, v)

    def batch(self, t: float | Array, q: Array, v: Array) -> EvaluationBatch:
        """The system in many configurations q (k, n_q), v (k, n_v) at the times t, (k,) or one for all; collective."""
        times = t if isinstance(t, np.ndarray) else np.array([t] * len(q), dtype=float)
        return self.evaluator.batch(times, q, v)

    def refuse_changed_forms(self) -> None:
        """Refuse other numbers in the forms of bodies than they were assembled with; collective.

        Raises:
            InputError: a constant or a function of the user's has changed.
        """
        refuse_changed(self._given_numbers, "the scene was built", CHANGES_ON_THE_WAY)

    @cached_property
    def _given_numbers(self) -> dict[str, GivenNumbers]:
        return {part.name: part.numbers for part in self.parts if part.numbers is not None}
