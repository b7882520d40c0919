"""Accelerations, projections and the stages of explicit and half-explicit methods by the driver: one call each.

None as an answer: NumPy has to do, or has something to say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from .structures import address_of, enumeration

if TYPE_CHECKING:
    from .evaluation import DriverStates

LOOK = enumeration("DONE")["LOOK"]  # a verdict
Tableau = tuple[Array, Array]  # nodes c (stages,), rows A (stages + 1, stages) with the weights last
Stages = tuple[Array, Array, Array, Array]  # rates and accelerations (stages, n_v); xi and v at the end


class ExplicitStates:
    """The answers for one system; ``states``: whose driver it is."""

    def __init__(self, states: DriverStates) -> None:
        self.states, self.system = states, states.system
        tables = states.tables
        s = tables.system
        self.room = np.zeros(2 * s.n_q + 2 * s.n_v + 5 * s.n_lam + tables.nu)
        self.place = address_of(self.room)

    def accelerations(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """a and lambda of a consistent state; its matrix of masses is factored then."""
        twin = self.states.twin
        a = np.empty(twin.system.n_v)
        lam = np.empty(self.system.n_lam)
        arrays = twin.configurations(q), twin.velocities(v), self._bias(np.array([t])), a, lam
        known = self.states.holds_masses(t, q)
        if not self._ask(self.states.library.driver_accelerate, (int(known), t, self.system.length), arrays):
            return None
        self.states.hold(t, q, v, new=not known)
        return twin.forces(a), lam

    def closed(self, t: float, q: Array, v: Array) -> tuple[Array, Array] | None:
        """q, then v, moved onto the constraints by the smallest change in the mass metric."""
        twin = self.states.twin
        q, v = twin.configurations(q.copy()), twin.velocities(v.copy())
        made = self._ask(self.states.library.driver_close, (t, self.system.length), (q, v))
        return (twin.places(q), twin.forces(v)) if made else None

    def stages(self, span: tuple[float, float], start: tuple[Array, Array, Array], tableau: Tableau) -> Stages | None:
        """All stages of a step.

        ``span``: where it begins, and its size (s). ``start``: q, v and the accelerations there.
        """
        (t, h), (c, A), twin = span, tableau, self.states.twin
        q, v = twin.configurations(start[0]), twin.velocities(start[1])
        rates, pushes = np.empty((2, len(c), len(v)))
        rates[0], pushes[0] = v, twin.velocities(start[2])
        xi, after = np.empty((2, len(v)))

        arrays = c, A, self._bias(t + h * c), q, v, rates, pushes, xi, after
        made = self._ask(self.states.library.driver_stages, (len(c), t, h, self.system.length), arrays)
        return (twin.forces(rates), twin.forces(pushes), twin.forces(xi), twin.forces(after)) if made else None

    def half_stage(
        self, times: Array, sizes: tuple[float, float], given: tuple[Array, ...], guess: tuple[Array, Array]
    ) -> tuple[Array, Array, int] | None:
        """a and lambda of a stage of a half-explicit method, and how many solutions that took.

        ``times``: of the stage and of the end of what it moves, (2,). ``sizes``: h times its weight (s); the acceleration that
        counts as none. ``given``: q and v of the stage, q at the end, v there without this stage. ``guess``: of a and lambda.
        """
        twin = self.states.twin
        (q, v, after, known), a, lam = given, twin.velocities(guess[0].copy()), guess[1].copy()
        solves = np.zeros(1, dtype=np.int64)

        q, after = twin.configurations(q), twin.configurations(after)
        arrays: tuple[Any, ...] = (times, q, twin.velocities(v), after, twin.velocities(known), a, lam, solves)
        made = self._ask(self.states.library.driver_half_stage, sizes, arrays)
        return (twin.forces(a), lam, int(solves[0])) if made else None

    def _bias(self, times: Array) -> Array:
        """What prescribed motions add to gamma at several times, (k, n_lam)."""
        bias = np.zeros((len(times), self.system.n_lam))
        for rows, motions in self.states.calls.moving:
            bias[:, rows] -= [[motion(float(t))[2] for motion in motions] for t in times]
        return bias

    def _ask(self, function: Any, numbers: tuple[float, ...], arrays: tuple[Array, ...]) -> bool:
        """One call of a function of numbers, arrays and room to work in; whether it has found an answer."""
        states = self.states
        if states.taken:
            return False
        states.hold(None)
        states.tables.recall()

        given = [np.ascontiguousarray(x) for x in arrays]  # alive until C is done
        verdict = function(states.address, *numbers, *(address_of(x) for x in given), self.place)
        states.calls.raise_error()
        if verdict == LOOK:
            states.tables.look()
        return not verdict
