"""Memories of controllers with a continuous law: what is kept of a step, and the memory within the next.

z(t) = z_n + (t - t_n) / 2 (g_n + g(t, y, z(t)))                                                              (1)

where no scheme says more (:mod:`.memory_points`). Before the end of the last step it is on the cubic through both ends of that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ...errors import CallbackError
from ...rotations import Array
from .control_laws import differences, solved

PAST = 5  # ends of steps before the last one that are kept, as differences of BDF ask for
FORETOLD = 1.5  # of the last step, that the cubic through its ends foretells of the next one
SLOW = 1e-2  # share of an error that may be left by inserting a memory in its own rule


@dataclass(frozen=True, eq=False)
class ControllerMemory:
    """What a controller keeps: time t_n (s), memory z and its rate g, efforts u, and the number of the next sample.

    ``past``: t and z where steps before have ended, the newest first, and g at the newest of these, ``before``. ``size``: the
    largest memories so far; ``reach``: of rates, by what readings change at least.
    """

    t: float
    z: Array
    rate: Array
    u: Array
    next: int
    past: tuple[tuple[float, Array], ...] = ()
    before: Array = field(default_factory=lambda: np.zeros(1))
    size: Array = field(default_factory=lambda: np.zeros(1))
    reach: Array = field(default_factory=lambda: np.zeros(1))

    def ends(self, times: Array) -> Array:
        """z at ends of steps (p,), or on a line back from the last one where no step has ended, (p, m)."""
        known = {self.t: self.z, **dict(self.past)}
        return np.array([known[t] if t in known else self.z + (t - self.t) * self.rate for t in map(float, times)])

    def followed_by(self) -> tuple[tuple[float, Array], ...]:
        """The past of what the next step leaves."""
        return ((self.t, self.z), *self.past)[:PAST]

    def within(self, t: float) -> Array | None:
        """z at a time (s) in the last step, which has ended; None at others."""
        return self._along(t) if self.past and self.past[0][0] <= t < self.t else None

    def divided(self, times: Array) -> ControllerMemory:
        """What is kept where the last step is taken for several, which began at these times (s), the newest first."""
        begun = [(float(t), self._along(float(t))) for t in times]
        return replace(self, past=(*begun, *self.past[1:])[:PAST], before=self._slope(begun[0][0]))

    def _slope(self, t: float) -> Array:
        """The rate of :meth:`_along`."""
        (begun, z), rate = self.past[0], self.before
        h = self.t - begun
        x, rise = (t - begun) / h, self.z - z
        first, last = h * rate - rise, h * self.rate - rise
        found: Array = rise + (1.0 - x) * (1.0 - 3.0 * x) * first - x * (2.0 - 3.0 * x) * last
        return found / h

    def _along(self, t: float) -> Array:
        """On the cubic through the ends of the last step."""
        (begun, z), rate = self.past[0], self.before
        h = self.t - begun
        x = (t - begun) / h
        rise = self.z - z
        found: Array = z + x * rise + x * (1.0 - x) * ((1.0 - x) * (h * rate - rise) - x * (h * self.rate - rise))
        return found

    def foretold(self, t: float) -> Array:
        """z at a time (s) of the next step, as far as ends tell."""
        if self.past and t < self.t + FORETOLD * (self.t - self.past[0][0]):
            return self._along(t)
        return self.z + (t - self.t) * self.rate


class StepMemory:
    """The memory within the step from what was ``kept`` on: (1) by inserting, enough for memories that are slow, else by
    Newton's method.

    ``slopes``: dg/dz, which serve all of the step from when they were asked for; None before.
    """

    def __init__(self, name: str, kept: ControllerMemory) -> None:
        self.name, self.kept = name, kept
        self.slopes: Array | None = None

    def at(
        self,
        t: float,
        law: Callable[[Array], tuple[Array, Array]],
        start: Array | None,
        rule: tuple[Array, float] | None = None,
    ) -> tuple[Array, Array, Array]:
        """u, z and g of (1) at time t, or of z = base + share g where the ``rule``, base (m,) and share (s), says so.

        ``law``: z -> (u, g). ``start``: a memory of the same step, nearer than what the rate that was kept foretells; None for
        that.
        """
        kept = self.kept
        half = 0.5 * (t - kept.t)
        base, share = (kept.z + half * kept.rate, half) if rule is None else rule
        z = kept.z + 2 * half * kept.rate if start is None else start
        u, rate = law(z)
        if not len(z) or share == 0.0:
            return u, z, rate

        before, left, past = np.inf, 1.0, z
        for count in range(20):
            miss = z - base - share * rate
            change = self._moved(share, miss, left)
            if _largest(change) > SLOW * before:
                self.slopes = differences(z, np.abs(share * rate), law, (u, rate))[1]
                change = self._moved(share, miss, left)
            elif count == 1 and self.slopes is None:
                left = 1.0 - float(miss @ past) / float(past @ past)  # of a miss once z has moved by it
                change = self._moved(share, miss, left)

            size = _largest(change)
            if size <= 1e-14 * (_largest(z) + _largest(share * rate)):
                return u, z, rate
            z, before, past = z - change, size, miss
            u, rate = law(z)

        raise CallbackError(
            f'Controller "{self.name}": its memory has no value at t = {t:g} s. Is the law smooth in it?'
        )

    def _moved(self, share: float, miss: Array, left: float) -> Array:
        """By how much the memory is off where (1) is off by ``miss``; ``left``: what would be left of it by inserting."""
        if self.slopes is None:
            return miss / left
        return solved(np.eye(len(miss)) - share * self.slopes, miss)


def _largest(x: Array) -> float:
    """max |x| of few numbers, (m,)."""
    return max(map(abs, map(float, x)))
