"""Roads under tyres, heights z = road(x, t), with their rates along the ways of wheels that move with v, and their slopes.

A rate is one call with complex numbers where the road takes them, else one with numbers that carry their rates, ``Jet``:

    z' = Im z(i h) / h,    z(s) = road(x + s v, t + s),    h = 1e-30 s                                              (1)

both exact to roundoff, else by differences. What a road takes is seen where a wheel first moves. ``abs`` and others drop
imaginary parts without a word: (1) counts where it agrees with (z(s) - z(0)) / s of a short s, one call more.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from ...errors import AGREEMENTS, FmbdError, named
from ...rotations import Array
from ..kinds.jets import COMPLEX_STEP
from ..kinds.time_derivatives import along
from .passed_over import Asked, PassedOver
from .user_laws import checked_number

ROAD = "road(x, t), which is asked for one height at x, all coordinates of the wheel's centre,"
IMAGINARY = complex(0.0, COMPLEX_STEP)
STEP, SHORT = 1e-5, 1e-7  # of differences and of (z(s) - z(0)) / s: shares of the radius
SLOW = 1e-2
WRONG, DROPPED = 1e-6, 1e-5  # of radius and speed: what heights and rates may differ by, at first and later
KEPT = 4  # answers
STRAIGHT = 1e-3  # of a way: what it goes aside

Moving = tuple[float, float]  # height (m) and rate (m/s)
Way = Callable[[int, Array, Array, float], Moving | None]


class Roads:
    """The roads of n tyres. Answers are kept for equal arguments: records, tangents and stages ask for the last again."""

    def __init__(self, tyres: Sequence[Any]) -> None:
        self.tyres = tyres
        self.roads = [named("The road of tyre", f.name, f.road) for f in tyres]
        self.radius: Array = np.array([f.radius for f in tyres], dtype=float)
        # m/s, that count as slow beside the radius in the time of damping and stiffness, in any units
        self.slow = [
            SLOW * f.radius * f.stiffness / f.damping if f.damping and f.stiffness else f.radius for f in tyres
        ]
        self.ways: dict[int, list[Way]] = {}  # that a road takes, the quickest first
        self.kept: dict[Hashable, Array] = {}
        self.asked: Asked | None = None

    def heights(self, x: Array, t: float) -> Array:
        """Heights (n,) at places (n, d), m."""
        return self._known((x.tobytes(), t), lambda: [self.height(i, x[i], t) for i in range(len(x))])

    def moving(self, x: Array, v: Array, t: float) -> Array:
        """Heights (m) and rates (m/s), (n, 2), under wheels at places (n, d) that move with v (n, d)."""
        self.asked = self.asked or Asked(x.size)
        self.asked.note(x)
        key = x.tobytes(), v.tobytes(), t
        return self._known(key, lambda: [self._one(i, x[i], v[i], t) for i in range(len(x))])

    def slopes(self, i: int, x: Array, v: Array, t: float) -> Array:
        """dz/dx and dz'/dx, (2, d), under tyre i at a place x, by differences; the latter where rates are exact, else 0."""
        exact = bool(self.ways.get(i)) and not AGREEMENTS

        def ask(place: Array) -> Moving:
            return self._one(i, place, v, t) if exact else (self.height(i, place, t), 0.0)

        step = STEP * self.radius[i]
        found = [np.subtract(ask(x + e), ask(x - e)) for e in step * np.eye(len(x))]
        return np.transpose(found) / (2.0 * step)

    def height(self, i: int, x: Array, t: float) -> float:
        """The road under tyre i at a place x, m."""
        return checked_number(self.tyres[i].name, self.roads[i](x, t), t, ROAD)

    def passed_over(self, t: float, up: Array) -> list[PassedOver]:
        """What roads do at a time (s) between the places of wheels that have gone straight on, across their ``up`` (n, d)."""
        places = None if self.asked is None else self.asked.places
        if places is None:
            return []
        found = []
        for i in range(len(up)):
            x: Array = places.reshape(len(places), *up.shape)[:, i]
            level: Array = np.ptp(x, axis=0) * (1.0 - np.abs(up[i]))
            main = int(level.argmax())
            if np.delete(level, main).max(initial=0.0) <= STRAIGHT * level[main]:
                way = _Straight(self, i, np.asarray(x.mean(axis=0)), main)
                found += list(Asked.of(x[:, main]).passed_over([way], t))
        return found

    def _known(self, key: Hashable, ask: Callable[[], list[Any]]) -> Array:
        """What was asked for before, or the answer; always asked for where ranks have to agree on it."""
        if AGREEMENTS:
            return np.array(ask())
        found = self.kept.get(key)
        if found is None:
            found = np.array(ask())
            if len(self.kept) == KEPT:
                self.kept.clear()
            self.kept[key] = found
        return found

    def _one(self, i: int, x: Array, v: Array, t: float) -> Moving:
        """Of one tyre, in the first way that gives an answer."""
        for way in () if AGREEMENTS else self.ways.get(i, ()):
            found = way(i, x, v, t)
            if found is not None:
                return found

        plainly = self._by_differences(i, x, v, t)
        if AGREEMENTS or i in self.ways or not v.any():
            return plainly

        # the wheel moves for the first time
        self.ways[i] = [way for way in (self._by_complex_step, self._by_jets) if self._agrees(way, plainly, i, x, v, t)]
        return self._one(i, x, v, t)

    def _agrees(self, way: Way, plainly: Moving, i: int, x: Array, v: Array, t: float) -> bool:
        """Whether a way gives what differences give, and drops nothing with a warning."""
        with warnings.catch_warnings():
            warnings.simplefilter("error", np.exceptions.ComplexWarning)
            found = way(i, x, v, t)
        radius, speed = self.radius[i], np.abs(v).max()
        if found is None:
            return False
        off = max(abs(found[0] - plainly[0]), abs(found[1] - plainly[1]) * radius / speed)
        return bool(off <= WRONG * radius)

    # -- ways -------------------------------------------------------------------------------------------------------
    def _by_complex_step(self, i: int, x: Array, v: Array, t: float) -> Moving | None:
        """(1); None where the road takes no complex numbers, or drops parts of them."""
        radius, components = float(self.radius[i]), [float(c) for c in v]
        speed = max(radius, *map(abs, components))  # of a radius in a second at least
        s = SHORT * radius / speed
        try:
            z = self.tyres[i].road(x + IMAGINARY * v, np.complex128(complex(t, COMPLEX_STEP)))
            z = complex(z.item() if isinstance(z, np.ndarray) else z)
            height, rate = z.real, z.imag / COMPLEX_STEP
            plainly = (self.height(i, x + s * v, t + s) - height) / s
        except Exception:
            return None
        return (height, rate) if abs(plainly - rate) <= DROPPED * max(abs(rate), speed) else None

    def _by_jets(self, i: int, x: Array, v: Array, t: float) -> Moving | None:
        return along(self.tyres[i].road, x, v, t)

    def _by_differences(self, i: int, x: Array, v: Array, t: float) -> Moving:
        """By values at s and 2 s along the way on both sides; by one of them where the road is known there alone, and by that
        ahead where they contradict each other, as about kinks.
        """
        radius, here = float(self.radius[i]), self.height(i, x, t)
        speed = max(self.slow[i], float(np.abs(v).max()))
        s = 2.0 ** math.floor(math.log2(STEP * radius / speed))  # times have no roundoff

        def changes(way: float) -> tuple[float, float]:
            near, far = (self.height(i, x + k * way * v, t + k * way) for k in (1, 2))
            return near - here, far - here

        try:
            back = changes(-s) if t >= 2.0 * s else None
        except FmbdError:
            back = None
        try:
            ahead = changes(s)
        except FmbdError:
            if back is None:
                raise
            return here, (back[1] - 4.0 * back[0]) / (2.0 * s)

        rate = (4.0 * ahead[0] - ahead[1]) / (2.0 * s)
        if back is None or abs(rate - (back[1] - 4.0 * back[0]) / (2.0 * s)) > DROPPED * max(abs(rate), speed):
            return here, rate
        return here, (8.0 * (ahead[0] - back[0]) - ahead[1] + back[1]) / (12.0 * s)


class _Straight:
    """The road under one tyre along one coordinate, as a law of that."""

    def __init__(self, roads: Roads, i: int, place: Array, main: int) -> None:
        self.roads, self.i, self.place, self.main, self.name = roads, i, place, main, roads.tyres[i].name

    def number(self, s: float, _: float, t: float) -> float:
        """Its height at a place, m."""
        x = self.place.copy()
        x[self.main] = s
        return self.roads.height(self.i, x, t)
