"""Accelerations and projections by the driver: one call each.

None as an answer: NumPy has to do, or has something to say.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....kernel_cache import address_of, addresses_of
from ....rotations import Array
from ...layout import State, States
from ..declarations import constants

if TYPE_CHECKING:
    from .evaluation import DriverStates

Tableau = tuple[Array, Array]  # nodes c (stages,), rows A (stages + 1, stages) with the weights last
# of the model's length in a step; of velocities
MOVES_NOTHING, SPEEDS = constants("onestep/explicit.c", "MOVES_NOTHING", "SPEEDS")


class ExplicitStates:
    """The answers for one system; ``states``: whose driver it is."""

    def __init__(self, states: DriverStates) -> None:
        self.states, self.system = states, states.system
        tables = states.tables
        s = tables.system
        self.room = np.zeros(3 * s.n_q + 4 * s.n_v + 5 * s.n_lam + tables.nu)
        self.place = address_of(self.room)

    def accelerations(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """a and lambda of a consistent state; its matrix of masses is factored then."""
        known = self.states.factor.holds_masses(t, q)
        found = self._accelerations((t,), q[None], v[None], known=known)
        if found is None:
            return None
        self.states.factor.hold(t, q, v, new=not known)
        return found[0][0], found[1][0]

    def all_accelerations(self, states: States) -> tuple[Array, Array] | None:
        """:meth:`accelerations` of many states."""
        found = self._accelerations(states.times, states.q, states.v, known=False)
        self.states.factor.count += len(states.q)
        return found

    def _accelerations(self, t: Sequence[float], q: Array, v: Array, *, known: bool) -> tuple[Array, Array] | None:
        """Of q (k, n_q) and v (k, n_v) at times; ``known``: whether the matrix that is held is that of the masses there."""
        twin = self.states.twin
        q, v = twin.configurations(q), twin.velocities(v)
        a, lam = np.empty_like(v, order="C"), np.empty((len(q), self.system.n_lam))

        numbers = [(int(known), at, self.system.length) for at in t]
        made = self._ask(self.states.library.driver_accelerate, numbers, (q, v, a, lam))
        return (twin.forces(a), lam) if made else None

    def least(self, t: float, q: Array, lam: Array) -> Array | None:
        """Of multipliers (k, n_lam) with the same forces in a configuration the smallest; the masses are factored then."""
        states, lam = self.states, lam.copy()
        known = states.factor.holds_masses(t, q)
        numbers = (int(known), t, len(lam))
        if not self._ask(states.library.driver_least, [numbers], (states.twin.configurations(q), lam)):
            return None
        states.factor.hold(t, q, np.zeros(states.system.n_v), new=not known)
        return lam

    def closed(self, t: float, q: Array, v: Array, cd: float = 0.0, ck: float = 0.0) -> tuple[Array, Array] | None:
        """q, then v, moved onto the constraints by the smallest change in the metric M + cd C + ck K."""
        found = self._closed([(True, t, self.system.length, cd, ck)], q[None], v[None])
        return None if found is None else (found[0][0], found[1][0])

    def all_closed(self, states: States, weights: Sequence[tuple[float, float]]) -> tuple[Array, Array] | None:
        """:meth:`closed` of many states, each with its weights of C and K."""
        numbers = [(True, t, self.system.length, *at) for t, at in zip(states.times, weights, strict=True)]
        return self._closed(numbers, states.q, states.v)

    def _closed(self, numbers: Sequence[tuple[float, ...]], q: Array, v: Array) -> tuple[Array, Array] | None:
        twin = self.states.twin
        q, v = twin.configurations(q).copy(), twin.velocities(v).copy()
        made = self._ask(self.states.library.driver_close, numbers, (q, v))
        return (twin.places(q), twin.forces(v)) if made else None

    def all_corrected(self, states: States, weights: Sequence[tuple[float, float]]) -> tuple[Array, Array] | None:
        """a and lambda of many states nearer to their equations, by increments in the metrics M + cd C + ck K."""
        twin = self.states.twin
        q, v, a = twin.configurations(states.q), twin.velocities(states.v), twin.velocities(states.a).copy()
        t, lam = np.array(states.times, dtype=float), states.lam.copy()
        made = self._ask(self.states.library.driver_correct, [(len(t),)], (t, np.array(weights), q, v, a, lam))
        return (twin.forces(a), lam) if made else None

    def arrived(self, t: float, q: Array, v: Array, *, places: bool) -> State | None:
        """:meth:`closed`, v alone where not ``places``, and a and lambda there."""
        twin = self.states.twin
        q, v = twin.configurations(q.copy()), twin.velocities(v.copy())
        a, lam = np.empty_like(v), np.empty(self.system.n_lam)
        arrays = q, v, a, lam
        if not self._ask(self.states.library.driver_arrive, [(places, t, self.system.length)], arrays):
            return None
        end = State(t, twin.places(q), twin.forces(v), twin.forces(a), lam)
        self.states.factor.hold(t, end.q, end.v)
        return end

    def _ask(
        self, function: Any, numbers: Sequence[tuple[float, ...]], arrays: tuple[Array, ...], *, factors: bool = True
    ) -> bool:
        """Calls of a function of numbers, arrays and room to work in; whether all have found an answer.

        One call takes the arrays as they are; of several each takes its own rows. ``factors``: a matrix of its own, in place of
        the one that is held.
        """
        states = self.states
        if states.taken:
            return False
        if factors:
            states.factor.hold(None)

        given = [np.ascontiguousarray(x) for x in arrays]  # alive until C is done
        starts = addresses_of(given)
        answered = True
        for i, each in enumerate(numbers):
            places = [start + i * x.strides[0] for start, x in zip(starts, given, strict=True)]
            answered &= states.ask(function, *each, *places, self.place)
        return answered
