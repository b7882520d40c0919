"""Who evaluates the states of a system: NumPy, or compiled code where a run has asked for it and knows all of the system.

A system has one evaluator; :meth:`.System.at`, :meth:`.System.batch` and the geometry of configurations, :meth:`.System.compose`,
``difference`` and ``rate``, ask it, and nobody else does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from ..rotations import Array
from .configurations import composed, increment_between, rate_of_increment
from .evaluation import Evaluation
from .evaluation_batch import CoordinateBatch, EvaluationBatch, in_coordinates
from .layout import State
from .lengths import Measured


class Seen(NamedTuple):
    """Of a state: the largest open constraint, the largest rate at which one opens, the largest of what of these depends on time
    only, as lengths; how far places are from the origin; the largest velocity, acceleration and multiplier.
    """

    gap: float
    slip: float
    rate: float
    far: float
    speed: float
    acceleration: float
    multiplier: float


class Glance(Protocol):
    """Looks at states of one system. Of the one looked at last, ``energies`` are kinetic, elastic, of the weight and of springs
    (J), ``sums`` those of the balance, like v; each None where nobody asks for it, or it does not know all.
    """

    energies: list[float] | None
    sums: Array | None

    def of(self, state: State) -> Seen | None:
        """What a state shows; None where evaluations have to tell."""


class Evaluator(Protocol):
    """State in, everything out: what is evaluated of a state depends on nothing that was evaluated before."""

    def at(self, t: float, q: Array, v: Array | None) -> Evaluation:
        """The system in one configuration (and velocity); collective."""

    def batch(self, t: Array, q: Array, v: Array) -> EvaluationBatch:
        """Many configurations at the times t (k,): q (k, n_q), v (k, n_v)."""

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi), leading axes broadcast, see :func:`.configurations.composed`."""

    def difference(self, q0: Array, q1: Array, near: Array | None) -> Array:
        """The increment from q0 to q1, likewise, see :func:`.configurations.increment_between`."""

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt for the velocity v, likewise, see :func:`.configurations.rate_of_increment`."""

    def glance(self, units: Array, *, energies: bool, balance: bool) -> Glance | None:
        """Who looks at states for the judges of a run in one call each, see :class:`.Glance`; None: evaluations tell them."""

    def begin_anew(self) -> None:
        """Serve another run, the one before is over."""


class NumPyEvaluator:
    """The reference for all others, which takes every system."""

    def __init__(self, system: Measured) -> None:
        self.system = system

    def at(self, t: float, q: Array, v: Array | None) -> Evaluation:
        """The system in one configuration (and velocity); collective."""
        return Evaluation(self.system, t, q, v)

    def batch(self, t: Array, q: Array, v: Array) -> EvaluationBatch:
        """Many configurations at the times t (k,): q (k, n_q), v (k, n_v)."""
        made: Callable[..., EvaluationBatch] = CoordinateBatch if in_coordinates(self.system) else EvaluationBatch
        return made(self.system, t, q, v)

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi), leading axes broadcast."""
        return composed(self.system, q, xi)

    def difference(self, q0: Array, q1: Array, near: Array | None) -> Array:
        """The increment from q0 to q1, likewise."""
        return increment_between(self.system, q0, q1, near)

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt for the velocity v, likewise."""
        return rate_of_increment(self.system, xi, v)

    def glance(self, units: Array, *, energies: bool, balance: bool) -> None:
        """Nobody."""

    def begin_anew(self) -> None:
        """Nothing: it keeps nothing of a run."""
