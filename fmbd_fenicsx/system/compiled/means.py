"""Steps of the energy-momentum scheme by the driver (mean.c): the residual, or all of Newton's iteration, in one call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from .explicit import ExplicitStates
from .structures import address_of

if TYPE_CHECKING:
    from .evaluation import DriverStates

Start = tuple[float, Array, Array]  # t, q, v


@dataclass(frozen=True)
class Ends:
    """When an iteration for accelerations ends: their ``size`` by which increments are judged (m/s^2), of it what is ``nothing``
    and what is ``roundoff`` where increments stall; how many are made at ``most``.
    """

    size: float
    nothing: float
    roundoff: float
    most: int


@dataclass(frozen=True)
class Found:
    """Mean accelerations and multipliers, sizes of the increments; q and v at the end, None where the matrix did not serve."""

    a: Array
    lam: Array
    sizes: list[float]
    end: tuple[Array, Array] | None


class MeanStates(ExplicitStates):
    """The answers for one system without elastic fields."""

    def __init__(self, states: DriverStates) -> None:
        super().__init__(states)
        self.room = np.zeros(states.library.driver_mean_room(states.address))
        self.place = address_of(self.room)

    def residual(self, start: Start, h: float, a: Array, lam: Array) -> tuple[Array, Array] | None:
        """The balance of a step of size h, like v, and what constraints leave open at its end."""
        twin, (t, q, v) = self.states.twin, start
        core, gap = np.empty(twin.system.n_v), np.empty(self.system.n_lam)
        arrays = twin.configurations(q), twin.velocities(v), twin.velocities(a), lam, core, gap
        made = self._ask(self.states.library.driver_mean, (t, h, self.system.length), arrays, factors=False)
        return (twin.forces(core), gap) if made else None

    def step(self, start: Start, h: float, guess: tuple[Array, Array], ends: Ends) -> Found:
        """A step of size h by the matrix of its middle."""
        twin, (t, q, v) = self.states.twin, start
        a, lam = twin.velocities(guess[0].copy()), guess[1].copy()
        q, v = twin.configurations(q), twin.velocities(v)
        sizes, done, after, then = np.empty(ends.most), np.zeros(1, dtype=np.int64), np.empty_like(q), np.empty_like(v)

        before = self.states.tables.c.factors
        numbers = ends.most, t, h, self.system.length, ends.size, ends.nothing, ends.roundoff
        arrays: tuple[Any, ...] = (q, v, a, lam, sizes, done, after, then)
        made = self._ask(self.states.library.driver_mean_step, numbers, arrays)
        self.states.factors += self.states.tables.c.factors - before
        end = (twin.places(after), twin.forces(then)) if made else None
        return Found(twin.forces(a), lam, list(map(float, sizes[: int(done[0])])), end)
