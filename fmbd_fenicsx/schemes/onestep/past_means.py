"""Means over the last steps, and what they tell of the next one."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...rotations import Array
from ...system.serialisation import Remembering, plain
from ..multistep.past import weights as lagrange

LONGEST = 3  # means that are kept


class PastMeans(Remembering):
    """Accelerations (n,) and multipliers (n_lam,), newest first, each at the middle of its step.

    A prediction is the polynomial through so many of them as would have told the newest best: all where the motion is smooth, one
    where vibrations are not resolved by the steps, whose polynomials grow.
    """

    keeps: ClassVar = {"known": plain(), "through": plain()}

    def __init__(self, t: float, a: Array, lam: Array) -> None:
        self.known = [(t, a, lam)]
        self.through = 1

    def predicted(self, t: float, through: int = 0) -> tuple[Array, Array]:
        """Both at t (s); ``through``: how many means, 0 for those that serve best."""
        times, a, lam = zip(*self.known[: through or self.through], strict=True)
        w = lagrange(np.array(times), t)
        return w @ np.array(a), w @ np.array(lam)

    def take(self, mean: tuple[float, Array, Array], weights: Array) -> None:
        """The means of one more step; errors of predictions are those of accelerations times weights (n,)."""
        t, a, _ = mean
        counts = range(1, len(self.known) + 1)
        missed = [np.abs(weights * (self.predicted(t, k)[0] - a)).max(initial=0.0) for k in counts]
        self.through = int(np.argmin(missed)) + 1
        self.known = [mean, *self.known][:LONGEST]
