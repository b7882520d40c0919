"""Efforts N(s, s', t) on a joint coordinate with formulas and derivatives of their own: friction, stops, feedback.

N is restoring, as that of a spring: the effort on the coordinate is -N. An object here can stand wherever a law(s, s', t) of
the user's own can; it also knows its slopes, so that Newton sees the exact tangent, and the energy that it stores.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...checks import LARGEST
from ...errors import require


@dataclass(frozen=True)
class Held:
    """A target that does not move, as t -> (s, s', s'')."""

    value: float

    def __call__(self, t: float) -> tuple[float, float, float]:
        """The value, at rest."""
        return self.value, 0.0, 0.0


class EffortLaw:
    """A restoring effort N(s, s', t) with its derivatives and its potential.

    ``conserves``: no effort but that of the energy :meth:`stored`, so that it neither gives nor takes any, and does not bend.
    ``gives``: whether it may give more than it stores.
    """

    conserves: ClassVar[bool] = False
    gives: ClassVar[bool] = True

    @property
    def takes(self) -> bool:
        """Whether it may take energy."""
        return not self.conserves

    @property
    def formula(self) -> tuple[str, tuple[float, ...]] | None:
        """Which formula of compiled steps it follows, by its name in ``formulas.c``, with its numbers; None: it is called."""
        return None

    def __call__(self, s: float, rate: float, t: float) -> float:
        """N, in N or N m."""
        raise NotImplementedError

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """dN/ds and dN/ds'."""
        raise NotImplementedError

    def stored(self, s: float) -> float:
        """Energy stored at s, J; zero for laws that only take or give."""
        return 0.0


@dataclass(frozen=True)
class Friction(EffortLaw):
    """Friction that opposes the rate s', smooth through rest:

        N = (F_c + (F_s - F_c) exp(-(s' / v_s)^2)) tanh(s' / v_0) + c s'.                                         (1)

    ``coulomb`` F_c and ``static`` F_s >= F_c in N or N m, ``stribeck`` v_s and ``speed`` v_0 in m/s or rad/s, ``viscous`` c.
    Below v_0 the joint creeps: it holds a load F < F_c at about v_0 F / F_c.
    """

    coulomb: float
    speed: float
    static: float
    stribeck: float
    viscous: float

    gives: ClassVar[bool] = False

    @property
    def formula(self) -> tuple[str, tuple[float, ...]]:
        """Smooth friction."""
        return "SMOOTH", (self.coulomb, self.speed, self.static, self.stribeck, self.viscous)

    def __call__(self, s: float, rate: float, t: float) -> float:
        """N of (1)."""
        peak = (self.static - self.coulomb) * np.exp(-((rate / self.stribeck) ** 2))
        return float((self.coulomb + peak) * np.tanh(rate / self.speed) + self.viscous * rate)

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """Zero, and the derivative of (1) by s'."""
        x, y = rate / self.speed, rate / self.stribeck
        peak = (self.static - self.coulomb) * np.exp(-(y * y))
        bend = (1 - np.tanh(x) ** 2) / self.speed
        falling = -2 * y / self.stribeck * peak * np.tanh(x)
        return 0.0, float((self.coulomb + peak) * bend + falling + self.viscous)


@dataclass(frozen=True)
class ElasticStop(EffortLaw):
    """Two elastic stops: with the depth d = s - upper > 0, and alike below lower,

        N = k d + (c d / width) s',     damping that sets in with the depth and is full at ``width``.              (2)

    The force is continuous when the stop is reached. A stop that would pull, because it is left faster than it springs
    back, carries no force.
    """

    lower: float
    upper: float
    stiffness: float
    damping: float
    width: float

    gives: ClassVar[bool] = False

    @property
    def takes(self) -> bool:
        """Where it is damped."""
        return self.damping > 0.0

    @property
    def formula(self) -> tuple[str, tuple[float, ...]]:
        """Stops."""
        return "STOP", (self.lower, self.upper, self.stiffness, self.damping, self.width)

    def _depth(self, s: float) -> float:
        """Signed depth: positive above ``upper``, negative below ``lower``."""
        return max(s - self.upper, 0.0) + min(s - self.lower, 0.0)

    def _damping(self, depth: float) -> float:
        return self.damping * min(abs(depth) / self.width, 1.0)

    def __call__(self, s: float, rate: float, t: float) -> float:
        """N of (2)."""
        depth = self._depth(s)
        effort = self.stiffness * depth + self._damping(depth) * rate
        return effort if effort * depth > 0 else 0.0

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """Derivatives of (2)."""
        depth = self._depth(s)
        if self(s, rate, t) == 0.0:
            return 0.0, 0.0
        rising = self.damping / self.width * np.sign(depth) if abs(depth) < self.width else 0.0
        return self.stiffness + float(rising) * rate, self._damping(depth)

    def stored(self, s: float) -> float:
        """k d^2 / 2."""
        return 0.5 * self.stiffness * self._depth(s) ** 2


@dataclass(frozen=True)
class Feedback(EffortLaw):
    """A motor that pulls a coordinate to a target: effort = k_p (s_0(t) - s) + k_d (s_0'(t) - s'), within +- ``limit``.

    ``target`` gives (s_0, s_0', s_0'').
    """

    proportional: float
    derivative: float
    target: Callable[[float], tuple[float, float, float]]
    limit: float = np.inf

    @property
    def formula(self) -> tuple[str, tuple[float, ...]]:
        """A motor with a target, which is taken at the start."""
        return "SERVO", (self.proportional, self.derivative, self.limit, 0.0, *self.target(0.0)[:2])

    def _free(self, s: float, rate: float, t: float) -> float:
        wanted, speed, _ = self.target(t)
        return self.proportional * (s - wanted) + self.derivative * (rate - speed)

    def __call__(self, s: float, rate: float, t: float) -> float:
        """Minus the motor's effort."""
        return float(np.clip(self._free(s, rate, t), -self.limit, self.limit))

    def slopes(self, s: float, rate: float, t: float) -> tuple[float, float]:
        """The gains, zero where the motor gives all it can."""
        if abs(self._free(s, rate, t)) >= self.limit:
            return 0.0, 0.0
        return self.proportional, self.derivative


def not_negative(kind: str, name: str, **values: float) -> None:
    """Refuse values that are not finite or negative."""
    for what, value in values.items():
        require(0 <= float(value) <= LARGEST, f'{kind} "{name}": {what} = {value} must be finite and >= 0.')


def positive(kind: str, name: str, **values: float) -> None:
    """Refuse values that are not finite or not positive."""
    for what, value in values.items():
        require(0 < float(value) <= LARGEST, f'{kind} "{name}": {what} = {value} must be finite and positive.')
