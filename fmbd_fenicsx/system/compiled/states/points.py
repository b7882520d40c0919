"""What an implicit step asks of points in local coordinates, by the driver: one call for all of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ....kernel_cache import address_of
from ....rotations import Array
from ...sparsity import Pattern
from ..tables.structures import Sizes
from .exchange import Exchange

if TYPE_CHECKING:
    from .evaluation import DriverStates

Metric = tuple[Pattern, Array]  # of a matrix by its pattern and data


class PointsTold(NamedTuple):
    """At each of k points: rates of xi and the balance (k, n_v), g and G v + g_t (k, n_lam)."""

    rates: Array
    sums: Array
    gaps: Array
    slips: Array

    def constraint(self) -> Array:
        """g(q, t), as of many configurations."""
        return self.gaps

    def opening(self) -> Array:
        """G v + g_t, likewise."""
        return self.slips

    def balance(self, a: Array, lam: Array) -> Array:
        """That of the accelerations and multipliers that were asked for."""
        return self.sums


class LocalPoints:
    """The answers for one system; ``states``: whose driver it is."""

    def __init__(self, states: DriverStates) -> None:
        self.states, self._rooms = states, dict[int, Exchange]()

    def _room(self, count: int) -> Exchange:
        """Arrays for so many points: those given, those told, and room to work in."""
        if count not in self._rooms:
            s = self.states.system
            n, m = (count, s.n_v), (count, s.n_lam)
            given: Sizes = {"t": count, "q0": s.n_q, "xi": n, "v": n, "a": n, "lam": m, "mu": m}
            told: Sizes = {"rates": n, "sums": n, "gaps": m, "slips": m}
            self._rooms[count] = Exchange({**given, **told, "room": s.n_q + 2 * s.n_v})
        return self._rooms[count]

    def told(
        self, t: Array, q0: Array, points: tuple[Array, Array, Array], forces: tuple[Array, Array | None, Metric | None]
    ) -> PointsTold | None:
        """Of points q0 o exp(xi) at the times t (k,); None where NumPy has something to say.

        ``points``: xi, v and accelerations a, (k, n_v). ``forces``: multipliers lambda (k, n_lam); mu and W (n_v, n_v) where
        rates are those of v - W G^T mu, or None.
        """
        states, (lam, mu, W) = self.states, forces
        room = self._room(len(t))
        at: list[int | None] = list(room.put(t, q0, *points, lam, mu))
        metric: list[int | None] = [None] * 3
        if mu is None or W is None:
            at[6] = None
        else:
            metric = [address_of(x) for x in (W[0].start, W[0].on, W[1])]

        states.anew = True
        if not states.ask(states.implicit.driver_points, len(t), *at, *metric, *room.at[7:]):
            return None
        told = PointsTold(*[x.copy() for x in room.arrays[7:11]])
        return told if np.logical_and.reduce(np.isfinite(told.sums), axis=None) else None
