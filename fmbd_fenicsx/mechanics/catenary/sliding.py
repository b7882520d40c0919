"""A point that slides along a wire: the contact of a pan head and a contact wire, as one multiplier at a moving place.

    g = y - w(x(t), t),   g' = y' - w' - x' w_x,   g'' = y'' - w'' - 2 x' w'_x - x'^2 w_xx - x'' w_x         (1)

with y a coordinate of a :class:`~fmbd_fenicsx.CoordinateBody` below the wire. The multiplier is the force on the wire, upwards.
A unilateral contact, 0 <= lambda, g <= 0, is closed (g = 0) or open (lambda = 0); :class:`~fmbd_fenicsx.Unilateral` switches it.
An open row is replaced by z = 0 for an ``idle`` coordinate z of the same body that nothing else acts on: the system keeps its
size and its rank.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import check_fields, instance, number
from ...errors import require
from ...rotations import Array


@dataclass(frozen=True, eq=False)
class SlidingContact:
    """The contact (1) of coordinate ``coordinate`` of ``body`` with wire number ``wire`` at x(t), from ``start``, with ``speed``.

    The speed grows smoothly (four continuous derivatives of x) from zero over the first ``ramp`` seconds: a point that starts
    to slide at once along a sloping wire would strike it. ``idle``: number of the body's idle coordinate; None for a
    bilateral contact.
    """

    name: str
    wires: Any
    body: Any
    wire: int = 0
    coordinate: int = 0
    start: float = 0.0  # m
    speed: float = 0.0  # m/s
    ramp: float = 0.0  # s
    idle: int | None = None

    def __post_init__(self) -> None:
        from ..bodies.coordinates import CoordinateBody
        from .wires import Wires

        what = f'Contact "{self.name}"'
        check_fields(self, what)
        instance(f"{what}: wires", self.wires, Wires)
        instance(f"{what}: body", self.body, CoordinateBody)
        number(f"{what}: ramp", self.ramp, least=0.0, unit="s")
        for name, index in (("coordinate", self.coordinate), ("idle", self.idle)):
            require(
                index is None or 0 <= index < len(self.body.start),
                f'{what}: {name} {index} is none of the {len(self.body.start)} coordinates of body "{self.body.name}".',
            )
        require(0 <= self.wire < len(self.wires.wires), f'Contact "{self.name}": there is no wire number {self.wire}.')

    def motion(self, t: float) -> tuple[float, float, float]:
        """x, x', x'' of the contact, m and s."""
        if t >= self.ramp:
            return self.start + self.speed * (t - 0.5 * self.ramp), self.speed, 0.0
        s = max(t / self.ramp, 0.0)
        v = self.speed
        T = self.ramp
        x = s**5 * (7 - 14 * s + 10 * s**2 - 2.5 * s**3)
        rate = s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)
        second = s**3 * (140 - 420 * s + 420 * s**2 - 140 * s**3)
        return self.start + v * T * x, v * rate, v / T * second


@dataclass
class Status:
    """Whether a unilateral contact is closed; shared by its two sides."""

    rows: slice
    closed: bool = True


@dataclass(frozen=True, eq=False)
class WireSide:
    """The terms of (1) on the wire's ports (w, w_x, w_xx, 0) of slider number ``slot``."""

    name: str
    part: int
    slot: int
    motion: Callable[[float], tuple[float, float, float]]
    status: Status

    @property
    def first(self) -> int:
        """The first of its ports."""
        return 4 * self.slot

    def _mine(self, p: Array) -> Array:
        return p[self.first : self.first + 4]

    def values(self, p: Array, t: float) -> Array:
        """-w."""
        return -self._mine(p)[:1] if self.status.closed else np.zeros(1)

    def jacobian(self, p: Array, t: float) -> Array:
        """d values / d p; kept for an open contact as a zero row."""
        out = np.zeros((1, len(p)))
        out[0, self.first] = -1.0 if self.status.closed else 0.0
        return out

    def rate(self, p: Array, t: float) -> Array:
        """-x' w_x."""
        return -self.motion(t)[1] * self._mine(p)[1:2] if self.status.closed else np.zeros(1)

    def gamma(self, p: Array, pd: Array, t: float) -> Array:
        """-2 x' w'_x - x'^2 w_xx - x'' w_x."""
        if not self.status.closed:
            return np.zeros(1)
        _, speed, rate = self.motion(t)
        return -2 * speed * self._mine(pd)[1:2] - speed**2 * self._mine(p)[2:3] - rate * self._mine(p)[1:2]


@dataclass(frozen=True, eq=False)
class HeadSide:
    """The terms of (1) on the body's coordinates: y when closed, the idle coordinate when open."""

    name: str
    part: int
    coordinate: int
    idle: int | None
    status: Status

    @property
    def number(self) -> int:
        """Which coordinate takes part."""
        return self.coordinate if self.status.closed or self.idle is None else self.idle

    def values(self, p: Array, t: float) -> Array:
        """y."""
        return p[[self.number]]

    def jacobian(self, p: Array, t: float) -> Array:
        """d values / d p."""
        out = np.zeros((1, len(p)))
        out[0, self.number] = 1.0
        return out

    def rate(self, p: Array, t: float) -> Array:
        """Nothing moves but y."""
        return np.zeros(1)

    def gamma(self, p: Array, pd: Array, t: float) -> Array:
        """Linear."""
        return np.zeros(1)


def place(contact: SlidingContact, parts: tuple[int, int], slot: int, row: int) -> tuple[WireSide, HeadSide]:
    """Both sides of a contact in one row; parts = numbers of (wires, body)."""
    status = Status(slice(row, row + 1))
    wire = WireSide(contact.name, parts[0], slot, contact.motion, status)
    return wire, HeadSide(contact.name, parts[1], contact.coordinate, contact.idle, status)
