"""Increments of configurations by the driver: many of them in one call (:mod:`~...configurations` says what they are)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ....kernel_cache import addresses_of
from ....rotations import Array
from ...evaluator import NumPyEvaluator
from ...system import System
from ..tables.resting import Twin

NOWHERE = (None, 0)  # an array that is not given


class Widening(NamedTuple):
    """Arrays like q, or like v: how long they are, how they get as long as the driver's, and how long these are; the way back."""

    size: int
    widened: Callable[[Array], Array]
    wide: int
    narrowed: Callable[[Array], Array]


class CompiledGeometry:
    """What :class:`~...evaluator.NumPyEvaluator` tells of configurations, for systems that the driver knows."""

    system: System
    library: Any
    address: int
    twin: Twin  # between arrays of the system and those of the driver

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi); leading axes broadcast."""
        made = self._made(self.library.driver_compose, self._places, (q, self._places), (xi, self._rates))
        return NumPyEvaluator(self.system).compose(q, xi) if made is None else made

    def difference(self, q0: Array, q1: Array, near: Array | None) -> Array:
        """The increment xi with q0 o exp(xi) = q1: of all rotations the smallest, or the one nearest to that of ``near``."""
        at = self._places
        made = self._made(self.library.driver_difference, self._rates, (q0, at), (q1, at), (near, self._rates))
        return NumPyEvaluator(self.system).difference(q0, q1, near) if made is None else made

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of local coordinates q o exp(xi) for the velocity v; leading axes broadcast."""
        made = self._made(self.library.driver_rate, self._rates, (xi, self._rates), (v, self._rates))
        return NumPyEvaluator(self.system).rate(xi, v) if made is None else made

    def know_twin(self) -> None:
        """Take the kinds of arrays of the system and of its twin."""
        own, twin = self.system, self.twin
        self._places = Widening(own.n_q, twin.configurations, twin.system.n_q, twin.places)
        self._rates = Widening(own.n_v, twin.velocities, twin.system.n_v, twin.forces)

    def _made(self, function: Any, kind: Widening, *given: tuple[Array | None, Widening]) -> Array | None:
        """Rows of a kind that C makes of arrays, each of its own; None where NumPy has to: of configurations of the core alone,
        of complex numbers, of leading axes that are neither alike nor missing, and where C has something to say.
        """
        lead: list[int] = []
        wide: list[int | None] = []
        kept = []  # alive until C is done
        for x, of in given:
            if x is None:
                wide.append(None)
                continue
            *axes, count = x.shape
            if count != of.size or x.dtype != np.float64 or (axes and lead and axes != lead):
                return None
            lead = axes or lead
            kept.append(np.ascontiguousarray(of.widened(x)))
            wide.append(of.wide if axes else 0)

        kept.append(made := np.empty((*lead, kind.wide)))
        known = iter(addresses_of(kept))
        places = [y for n in wide for y in (NOWHERE if n is None else (next(known), n))]
        failed = function(self.address, made.size // kind.wide, *places, next(known))
        return None if failed else kind.narrowed(made)
