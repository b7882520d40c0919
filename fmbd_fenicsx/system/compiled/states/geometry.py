"""Increments of configurations by the driver: many of them in one call (:mod:`~...configurations` says what they are)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....kernel_cache import addresses_of
from ....rotations import Array
from ...evaluator import NumPyEvaluator
from ...system import System

NOWHERE = (None, 0)  # an array that is not given


class CompiledGeometry:
    """What :class:`~...evaluator.NumPyEvaluator` tells of configurations, for systems that the driver knows as they are."""

    system: System
    library: Any
    address: int
    same_rows: bool  # whether the driver's configurations are the system's own: not where parts have frames at rest

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi); leading axes broadcast."""
        s = self.system
        made = self._made(self.library.driver_compose, s.n_q, (q, s.n_q), (xi, s.n_v))
        return NumPyEvaluator(self.system).compose(q, xi) if made is None else made

    def difference(self, q0: Array, q1: Array, near: Array | None) -> Array:
        """The increment xi with q0 o exp(xi) = q1: of all rotations the smallest, or the one nearest to that of ``near``."""
        s = self.system
        made = self._made(self.library.driver_difference, s.n_v, (q0, s.n_q), (q1, s.n_q), (near, s.n_v))
        return NumPyEvaluator(self.system).difference(q0, q1, near) if made is None else made

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of local coordinates q o exp(xi) for the velocity v; leading axes broadcast."""
        n = self.system.n_v
        made = self._made(self.library.driver_rate, n, (xi, n), (v, n))
        return NumPyEvaluator(self.system).rate(xi, v) if made is None else made

    def _made(self, function: Any, width: int, *given: tuple[Array | None, int]) -> Array | None:
        """Rows of so many numbers that C makes of arrays, each with the width that it has to have; None where NumPy has to: of
        configurations of the core alone, of complex numbers, of leading axes that are neither alike nor missing.
        """
        lead: list[int] = []
        wide: list[int | None] = []
        kept = []  # alive until C is done
        for x, n in given:
            if x is None:
                wide.append(None)
                continue
            *axes, count = x.shape
            if not self.same_rows or count != n or x.dtype != np.float64 or (axes and lead and axes != lead):
                return None
            lead = axes or lead
            kept.append(np.ascontiguousarray(x))
            wide.append(n if axes else 0)

        kept.append(made := np.empty((*lead, width)))
        known = iter(addresses_of(kept))
        places = [y for n in wide for y in (NOWHERE if n is None else (next(known), n))]
        function(self.address, made.size // width, *places, next(known))
        return made
