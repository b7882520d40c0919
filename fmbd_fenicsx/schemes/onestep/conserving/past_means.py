"""Means over the last steps, and what they tell of the next one."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from ....polynomials import lagrange
from ....rotations import Array
from ....system.serialisation import Memory, Remembering, plain

LONGEST = 3  # means that are kept


class PastMeans(Remembering):
    """Accelerations (n,) and multipliers (n_lam,), newest first, each at the middle of its step.

    A prediction is the polynomial through so many of them as would have told the newest best: all where the motion is smooth, one
    where vibrations are not resolved by the steps, whose polynomials grow; or bodies that move on rigidly, where that is nearer.
    """

    keeps: ClassVar = {"known": Memory.past, **dict.fromkeys(("through", "rigidly", "missed"), plain())}

    def __init__(self, t: float, a: Array, lam: Array, rigid: bool) -> None:
        """``rigid``: whether there are bodies that may move on rigidly; the first prediction is that."""
        self.known = [(t, a, lam)]
        self.through, self.rigidly = 1, rigid
        self.missed = np.inf if rigid else 0.0  # by which the newest was

    def predicted(self, t: float) -> tuple[Array, Array]:
        """Both at t (s) by the best polynomial."""
        times, a, lam = zip(*self.known[: self.through], strict=True)
        w = np.array(lagrange(times, t))
        return w @ np.array(a), w @ np.array(lam)

    def take(self, mean: tuple[float, Array, Array], size: Callable[[Array], Array], rigid: Array | None) -> None:
        """The means of one more step; errors of predictions are those of accelerations (k, n), of this ``size``. ``rigid``: those
        of bodies that move on rigidly, where they are known.
        """
        t, a, _ = mean
        times, earlier, _ = zip(*self.known, strict=True)
        w = np.zeros((len(times), len(times)))  # of polynomials through one, two .. of them
        for k in range(len(times)):
            w[k, : k + 1] = lagrange(times[: k + 1], t)
        found = w @ np.array(earlier)
        missed = size((found if rigid is None else np.concatenate((found, rigid[None]))) - a)

        self.through, self.missed = int(np.argmin(missed[: len(times)])) + 1, float(missed.min())
        self.rigidly = rigid is not None and bool(missed[-1] <= self.missed)
        self.known = [mean, *self.known][:LONGEST]
