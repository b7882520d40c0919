"""Steps of the energy-momentum scheme by the driver (mean.c): the residual, or all of Newton's iteration, in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ....kernel_cache import address_of
from ....rotations import Array
from .explicit import ExplicitStates

if TYPE_CHECKING:
    from .evaluation import DriverStates

Start = tuple[float, Array, Array]  # t, q, v


@dataclass(frozen=True)
class IterationEnds:
    """When an iteration for accelerations ends, in shares of their ``size`` by which increments are judged (m/s^2), as in mean.c.

    It is over where the next increment would be ``nothing`` and the last one was ``enough``; where rates above ``slow`` meet
    what roundoff makes, ``lost``; at ``zero``; and ``close`` to it where an increment is not below the share ``idle`` of the one
    before. Rates count down to ``fastest``; above ``noise`` a slow one asks for a new tangent. ``most``: increments.
    """

    size: float
    nothing: float
    lost: float
    most: int
    slow: float = 0.1
    fastest: float = 1e-5
    enough: float = 1e-9
    zero: float = 1e-13
    close: float = 1e-10
    idle: float = 0.2
    noise: float = 1e-11

    @property
    def numbers(self) -> Array:
        """As C reads them, which is told ``most`` apart."""
        return np.array([value for name, value in vars(self).items() if name != "most"])

    def over(self, history: list[float]) -> bool:
        """Whether the iteration is, by the sizes of its increments."""
        last, rate = history[-1], rate_of(history)
        stalled = len(history) > 2 and last <= self.close and last > self.idle * history[-2]
        reached = len(history) > 1 and last <= self.enough and rate <= self.slow
        reached &= max(rate, self.fastest) * last <= self.nothing
        return last <= self.zero or self.drowned(history) or reached or stalled or not np.isfinite(last)

    def drowned(self, history: list[float]) -> bool:
        """Whether what is left is roundoff that converges no more."""
        return rate_of(history) > self.slow and history[-1] <= self.lost

    def found(self, last: float) -> bool:
        """Whether a last increment of this size leaves a solution."""
        return last <= max(self.enough, self.lost)


def rate_of(history: list[float]) -> float:
    """Rate of convergence of the last two increments, 0 after the first."""
    return history[-1] / max(history[-2], 1e-300) if len(history) > 1 else 0.0


@dataclass(frozen=True)
class MeanStep:
    """Mean accelerations and multipliers, sizes of the increments, whether fields have new tangents; q and v at the end, None
    where the matrix did not serve.
    """

    a: Array
    lam: Array
    sizes: list[float]
    renewed: bool
    end: tuple[Array, Array] | None


class MeanStates(ExplicitStates):
    """The answers for one system; fields have the factors of a step's size, and ``states.tables.renewed`` for new tangents."""

    def __init__(self, states: DriverStates) -> None:
        super().__init__(states)
        self._made: object = None  # the tables that room was made for

    def _take_room(self) -> None:
        """Room to work in, of the tables as they are."""
        states = self.states
        if self._made is not states.tables:
            self._made = states.tables
            self.room = np.zeros(states.library.driver_mean_room(states.address))
            self.place = address_of(self.room)

    def residual(self, start: Start, h: float, a: Array, lam: Array) -> tuple[Array, Array] | None:
        """The balance of a step of size h, like v, and what constraints leave open at its end."""
        twin, (t, q, v) = self.states.twin, start
        self._take_room()
        core, gap = np.empty(twin.system.n_v), np.empty(self.system.n_lam)
        arrays = twin.configurations(q), twin.velocities(v), twin.velocities(a), lam, core, gap
        made = self._ask(self.states.library.driver_mean, [(t, h, self.system.length)], arrays, factors=False)
        return (twin.forces(core), gap) if made else None

    def step(self, start: Start, h: float, guess: tuple[Array, Array], ends: IterationEnds, *, old: bool) -> MeanStep:
        """A step of size h by the matrix of its middle; ``old``: fields are to have new tangents first."""
        self._take_room()
        twin, (t, q, v) = self.states.twin, start
        a, lam = twin.velocities(guess[0].copy()), guess[1].copy()
        q, v = twin.configurations(q), twin.velocities(v)
        sizes, done, after, then = np.empty(ends.most), np.zeros(2, dtype=np.int64), np.empty_like(q), np.empty_like(v)

        before = self.states.tables.c.factors
        numbers = [(ends.most, int(old), t, h, self.system.length)]
        arrays: tuple[Any, ...] = (ends.numbers, q, v, a, lam, sizes, done, after, then)
        made = self._ask(self.states.library.driver_mean_step, numbers, arrays)
        self.states.factor.count += self.states.tables.c.factors - before
        end = (twin.places(after), twin.forces(then)) if made else None
        return MeanStep(twin.forces(a), lam, list(map(float, sizes[: int(done[0])])), bool(done[1]), end)
