"""Constraints on the ports of one part, given by functions of a user's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...rotations import Array
from .own_derivatives import UNUSABLE, Slopes, derivative_many, line_rates


@dataclass(frozen=True, eq=False)
class PortConstraint:
    """g(p, t) = 0 on the ports p of one part; ``jacobian``, ``gamma`` and ``rate`` from differences unless given.

    function(p, t) -> (m,); jacobian_(p, t) -> (m, n); gamma_(p, p', t) -> (m,), the part of g'' without p''; rate_(p, t) ->
    (m,), dg/dt at fixed p. ``vectorized``: they take many p at once, see the module.
    """

    name: str
    part: int
    function: Callable[[Any, float], Any]
    jacobian_: Callable[[Array, float], Array] | None = None
    gamma_: Callable[[Array, Array, float], Array] | None = None
    rate_: Callable[[Array, float], Array] | None = None
    vectorized: bool = False
    raw: Callable[[Any, Any], Any] | None = None  # the user's function itself
    slopes: Slopes | None = None  # of the function of all its numbers, the time last; None: by complex steps

    @property
    def derivatives_given(self) -> bool:
        """Whether functions of the user's own tell any of its derivatives."""
        return any(given is not None for given in (self.jacobian_, self.gamma_, self.rate_))

    def many(self, what: str, t: Array, *arrays: Array) -> Array:
        """``values``, ``jacobian``, ``rate`` or ``gamma`` of k configurations, arrays (k, n), t (k,): one call where possible."""
        given: Any = {"values": self.function, "jacobian": self.jacobian_, "rate": self.rate_, "gamma": self.gamma_}[
            what
        ]

        # all configurations in one call of the user's function
        if self.vectorized and given is not None:
            found = np.asarray(given(*(x.T for x in arrays), t), dtype=float)
            return (
                np.moveaxis(found, -1, 0)
                if found.shape[-1:] == t.shape
                else np.broadcast_to(found, (len(t), *found.shape))
            )

        # complex steps of all, if complex numbers pass
        if self.vectorized and self.slope.by_complex and what in ("jacobian", "rate"):
            try:
                if what == "jacobian":
                    return derivative_many(self.function, arrays[0], t)
                return derivative_many(lambda s, p: self.function(p.T, s[0]), t[:, None], arrays[0])[:, :, 0]
            except UNUSABLE:
                pass

        one: Any = getattr(self, what)
        return np.array([one(*(x[i] for x in arrays), float(t[i])) for i in range(len(t))])

    def values(self, p: Array, t: float) -> Array:
        """g, (m,)."""
        return np.asarray(self.function(p, t), dtype=float)

    @cached_property
    def slope(self) -> Slopes:
        """The derivative of g by all its numbers, the time last."""
        return self.slopes or Slopes(of_place_and_time(self.function), by_complex=True)

    def jacobian(self, p: Array, t: float) -> Array:
        """dg/dp, (m, n)."""
        if self.jacobian_ is not None:
            return np.asarray(self.jacobian_(p, t), dtype=float)
        if self.vectorized and self.slope.by_complex:
            return np.asarray(self.many("jacobian", np.array([t]), p[None])[0])
        return self.slope(np.append(p, t))[:, :-1]

    def rate(self, p: Array, t: float) -> Array:
        """dg/dt at fixed p, (m,)."""
        if self.rate_ is not None:
            return np.asarray(self.rate_(p, t), dtype=float)
        return self.slope(np.append(p, t))[:, -1]

    def gamma(self, p: Array, pd: Array, t: float) -> Array:
        """g'' - G p'', (m,): the second rate of g along the line p + s p'."""
        if self.gamma_ is not None:
            return np.asarray(self.gamma_(p, pd, t), dtype=float)
        return line_rates(of_place_and_time(self.function), np.append(p, t), np.append(pd, 1.0))[1]


def of_place_and_time(function: Callable[[Any, Any], Any]) -> Callable[[Any], Any]:
    """function(p, t) as one of all numbers, the time last."""
    return lambda z: function(z[:-1], z[-1])
