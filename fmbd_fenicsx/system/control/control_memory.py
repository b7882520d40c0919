"""Memories of controllers with a continuous law: what is kept of a step, and the memory within the next.

z(t) = z_n + (t - t_n) / 2 (g_n + g(t, y, z(t)))                                                              (1)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import CallbackError
from ...rotations import Array
from .control_laws import differences

SLOW = 1e-2  # share of an error that may be left by inserting a memory in its own rule


@dataclass(frozen=True, eq=False)
class ControllerMemory:
    """What a controller keeps: time t_n (s), memory z and its rate g, efforts u, and the number of the next sample."""

    t: float
    z: Array
    rate: Array
    u: Array
    next: int


class StepMemory:
    """The memory within the step from what was ``kept`` on: (1) by inserting, enough for memories that are slow, else by
    Newton's method.

    ``slopes``: dg/dz, which serve all of the step from when they were asked for; None before.
    """

    def __init__(self, name: str, kept: ControllerMemory) -> None:
        self.name, self.kept = name, kept
        self.slopes: Array | None = None

    def at(
        self, t: float, law: Callable[[Array], tuple[Array, Array]], start: Array | None
    ) -> tuple[Array, Array, Array]:
        """u, z and g of (1) at time t.

        ``law``: z -> (u, g). ``start``: a memory of the same step, nearer than what the rate that was kept foretells; None for
        that.
        """
        kept = self.kept
        half = 0.5 * (t - kept.t)
        z = kept.z + 2 * half * kept.rate if start is None else start
        u, rate = law(z)
        if not len(z) or half == 0.0:
            return u, z, rate

        before, left, past = np.inf, 1.0, z
        for count in range(20):
            miss = z - kept.z - half * (kept.rate + rate)
            size = _largest(miss)
            if size <= 1e-14 * (_largest(z) + _largest(half * rate)):
                return u, z, rate
            if size > SLOW * before:
                self.slopes = differences(z, np.abs(half * rate), law, (u, rate))[1]
            elif count == 1:
                left = 1.0 - float(miss @ past) / float(past @ past)  # of a miss once z has moved by it
            z, before, past = z - self._moved(half, miss, left), size, miss
            u, rate = law(z)
        raise CallbackError(
            f'Controller "{self.name}": its memory has no value at t = {t:g} s. Is the law smooth in it?'
        )

    def _moved(self, half: float, miss: Array, left: float) -> Array:
        """By how much the memory is off where (1) is off by ``miss``; ``left``: what would be left of it by inserting."""
        if self.slopes is None:
            return miss / left
        return np.linalg.solve(np.eye(len(miss)) - half * self.slopes, miss)


def _largest(x: Array) -> float:
    """max |x| of few numbers, (m,)."""
    return max(map(abs, map(float, x)))
