"""Reference curves: arc length, places and section axes along a rod as it is without load.

A curve is given by points (a smooth spline through them), or by a function of u in [0, 1]. Section axis 1 is its tangent t.
Axis 2 is the part of a given direction across t, or is carried along without twist (Bishop frame, by double reflection:
Wang, Juettler, Zheng and Liu, doi:10.1145/1330511.1330513); a twist angle (rad) about t comes on top.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import vector
from ...errors import InputError, require, values_of
from ...rotations import Array

FINEST = 4096  # intervals up to which a curve is resolved
SMOOTH = 1e-10  # of the length: what the last doubling may still change
SHARPEST = np.radians(60.0)  # turn between neighbouring chords above which points make a kink
CLOSE = 4 * float(np.finfo(float).eps)  # of a parameter: roundoff
ALONG = 1024  # places at which axes are carried along
GAUSS_U, GAUSS_W = np.polynomial.legendre.leggauss(6)


class Curve:
    """A smooth curve by its arc length: ``length`` (m), :meth:`at` places and tangents."""

    def __init__(self, name: str, given: Any) -> None:
        self.name = name
        self._exact: Callable[[float], Any] | None = given if callable(given) else None
        self._spline: Any = self._through_function() if callable(given) else self._through_points(given)
        self._slope = self._spline.derivative()
        self._measure()

    # -- what was given ---------------------------------------------------------------------------------------------
    def _through_points(self, given: Any) -> Any:
        """A spline of degree 3 at most through points, by the lengths of their chords."""
        from scipy.interpolate import make_interp_spline

        try:
            points = np.asarray(given, dtype=float)
        except (TypeError, ValueError, OverflowError):
            points = np.zeros(0)
        require(
            points.ndim == 2 and points.shape[1] == 3 and len(points) >= 2 and bool(np.isfinite(points).all()),
            f'Rod "{self.name}": the curve must be two or more points in space, or a function of u in [0, 1]; found {given!r}.',
        )

        chords = np.diff(points, axis=0)
        lengths = np.linalg.norm(chords, axis=1)
        if not lengths.min() > 1e-12 * lengths.max():
            raise InputError(
                f'Rod "{self.name}": points {int(lengths.argmin()) + 1} and {int(lengths.argmin()) + 2} of its curve coincide: '
                "there is no tangent."
            )

        # a sharp angle between chords is a kink: a spline would swing about it
        directions = chords / lengths[:, None]
        turns = np.arccos(np.clip((directions[1:] * directions[:-1]).sum(1), -1.0, 1.0))
        if turns.size and turns.max() >= SHARPEST:
            worst = int(turns.argmax()) + 1
            raise InputError(
                f'Rod "{self.name}": its curve turns by {np.degrees(turns.max()):.0f} degrees at point {worst + 1}, '
                f"{np.round(points[worst], 6).tolist()}: a kink. Make two rods and "
                "join them by fmbd.fixed(...), or give more points."
            )

        u = np.concatenate(([0.0], np.cumsum(lengths))) / lengths.sum()
        return make_interp_spline(u, points, k=min(3, len(points) - 1))

    def _value(self, u: float) -> Array:
        """The user's function at u."""
        assert self._exact is not None
        found: Array = values_of(f'Rod "{self.name}": its curve', self._exact, [(float(u),)], 3, "u = {:g}")[0]
        return found

    def _through_function(self) -> Any:
        """A quintic spline of the function, refined until it does not change."""
        from scipy.interpolate import make_interp_spline

        n = 32
        u = np.linspace(0.0, 1.0, n + 1)
        points = np.array([self._value(x) for x in u])

        while True:
            spline = make_interp_spline(u, points, k=5)
            # half-way between its points a spline is worst
            between = 0.5 * (u[1:] + u[:-1])
            found = np.array([self._value(x) for x in between])
            error = np.linalg.norm(found - spline(between), axis=1)
            size = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            if not size > 0:
                raise InputError(f'Rod "{self.name}": its curve is a single point: there is no tangent.')

            if error.max() <= SMOOTH * 1e-3 * size:
                return spline
            if n >= FINEST:
                break
            # what was found half-way are the new points
            n *= 2
            u = np.linspace(0.0, 1.0, n + 1)
            fine = np.empty((n + 1, 3))
            fine[::2], fine[1::2] = points, found
            points = fine

        if error.max() > SMOOTH * size:
            self._refuse_kink(points, between[error.argmax()])
        return spline

    def _refuse_kink(self, points: Array, u: float) -> None:
        """Refuse a curve whose tangent jumps near u; where only its curvature does, chords turn half as much when halved."""

        def turn(points: Array) -> float:
            k = int(np.clip(round(u * (len(points) - 1)), 2, len(points) - 3))
            chords = np.diff(points[k - 2 : k + 3], axis=0)
            chords /= np.linalg.norm(chords, axis=1, keepdims=True)
            return float(np.linalg.norm(chords[-1] - chords[0]))

        if turn(points) > 0.75 * turn(points[::2]):
            raise InputError(
                f'Rod "{self.name}": its curve is not smooth near u = {u:.4f}: a kink. Make two '
                "rods and join them by fmbd.fixed(...)."
            )

    # -- arc length ---------------------------------------------------------------------------------------------
    def _measure(self) -> None:
        """Arc length of the spline over its parameter."""
        n = max(512, 4 * len(self._spline.c))
        self._u = np.linspace(0.0, 1.0, n + 1)
        middle = 0.5 * (self._u[1:] + self._u[:-1])
        half = 0.5 / n
        # Gauss points of each interval
        speed = np.linalg.norm(self._slope(middle[:, None] + half * GAUSS_U), axis=-1)

        slowest = int(speed.min(axis=1).argmin())
        if not speed.min() > 1e-6 * speed.max():
            raise InputError(
                f'Rod "{self.name}": the tangent of its curve is zero near u = {middle[slowest]:.2f}: '
                "give a parameter that moves on."
            )

        self._s = np.concatenate(([0.0], np.cumsum(half * (speed @ GAUSS_W))))
        self.length = float(self._s[-1])

    def _parameter(self, s: Array) -> Array:
        """u of arc lengths s, by Newton's method."""
        u = np.interp(s, self._s, self._u)
        for _ in range(8):
            # arc length up to u: that of whole intervals, and of the rest by Gauss points
            k = np.clip(np.searchsorted(self._u, u, side="right") - 1, 0, len(self._u) - 2)
            half = 0.5 * (u - self._u[k])
            inside = self._u[k][:, None] + half[:, None] * (1 + GAUSS_U)
            found = self._s[k] + half * (np.linalg.norm(self._slope(inside), axis=-1) @ GAUSS_W)

            before, u = u, np.clip(u - (found - s) / np.linalg.norm(self._slope(u), axis=-1), 0.0, 1.0)
            if np.abs(u - before).max(initial=0.0) <= CLOSE:
                break
        return u

    def at(self, s: Array) -> tuple[Array, Array]:
        """Places (n, 3) and unit tangents (n, 3) at arc lengths s (n,)."""
        u = self._parameter(np.asarray(s, dtype=float))
        slope = self._slope(u)
        x = self._spline(u) if self._exact is None else np.array([self._value(k) for k in u])
        return x, slope / np.linalg.norm(slope, axis=-1, keepdims=True)

    def nearest(self, point: Array) -> tuple[float, float]:
        """Arc length of the place on the curve nearest to a point, and the distance, both m."""
        from scipy.optimize import minimize_scalar

        # between the neighbours of the nearest point known
        k = int(np.linalg.norm(self._spline(self._u) - point, axis=1).argmin())
        around = self._s[max(k - 1, 0)], self._s[min(k + 1, len(self._s) - 1)]

        def square(s: float) -> float:
            return float(((self.at(np.array([s]))[0][0] - point) ** 2).sum())

        found = minimize_scalar(square, bounds=around, method="bounded", options={"xatol": 1e-12 * self.length})
        s = min((*around, float(found.x)), key=square)
        return s, float(np.sqrt(square(s)))

    # -- axes -----------------------------------------------------------------------------------------------------
    def axes(
        self, s: Array, at: tuple[Array, Array], normal: Any = None, twist: Callable[[float], float] | None = None
    ) -> Array:
        """Rotation matrices (n, 3, 3) of the sections at ascending arc lengths s, where places and tangents are ``at``; columns
        axis 1, 2, 3.
        """
        x, t = at
        across = self._carried(s, x, t) if normal is None else self._directed(s, t, normal)

        if twist is not None:
            angle = values_of(f'Rod "{self.name}": twist', twist, [(float(x),) for x in s], 1, "s = {:g} m")[:, 0]
            # turned about the tangent
            c, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
            across = c * across + sin * np.cross(t, across)
        return np.stack((t, across, np.cross(t, across)), axis=-1)

    def _directed(self, s: Array, t: Array, normal: Any) -> Array:
        """Parts of a direction, constant or a function of s, across the tangents."""
        n = constant_or_along(f'Rod "{self.name}": normal', normal, s, 3)

        part = n - (n * t).sum(1, keepdims=True) * t
        size = np.linalg.norm(part, axis=1)
        whole = np.linalg.norm(n, axis=1)
        bad = np.flatnonzero(~(size > 1e-6 * np.maximum(whole, 1e-300)))
        if bad.size:
            x = self.at(s[bad[:1]])[0][0]
            raise InputError(
                f'Rod "{self.name}": its twist is undefined at s = {s[bad[0]]:g} m, point {np.round(x, 6).tolist()}: '
                f"normal {n[bad[0]].tolist()} is parallel to the tangent. Give another normal, or a function of s."
            )

        return np.asarray(part / size[:, None])

    def _carried(self, s: Array, x: Array, t: Array) -> Array:
        """Axis 2 at arc lengths s, points x and tangents t, carried along without twist."""
        places, points, tangents, carried = self._transport
        k = np.clip(np.searchsorted(places, s, side="right") - 1, 0, len(places) - 1)
        found = np.einsum("nij,nj->ni", _reflections(points[k], tangents[k], x, t), carried[k])
        return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))

    @cached_property
    def _transport(self) -> tuple[Array, Array, Array, Array]:
        """Places (n,), points and tangents all along the curve, and axis 2 there, each (n, 3): from the world axis most
        across the curve's start (y before z before x).
        """
        places = np.linspace(0.0, self.length, ALONG)
        x, t = self.at(places)

        # rounded, so that ties are broken by the order and not by roundoff
        order = np.array([1, 2, 0])
        along = np.round(np.abs(t[0][order]), 9)
        first = np.eye(3)[order[int(np.argmin(along))]]
        across = first - (first @ t[0]) * t[0]
        across /= np.linalg.norm(across)
        return places, x, t, _products(_reflections(x[:-1], t[:-1], x[1:], t[1:])) @ across


def _products(steps: Array) -> Array:
    """Products 1, S_0, S_1 S_0, S_2 S_1 S_0, ... of matrices S (n, 3, 3): all of them, (n + 1, 3, 3)."""
    found = np.concatenate((np.eye(3)[None], steps))
    reach = 1
    while reach < len(found):  # each knows the product of the last ``reach`` factors
        found[reach:] = found[reach:] @ found[:-reach]
        reach *= 2
    return found


def constant_or_along(what: str, given: Any, s: Array, size: int) -> Array:
    """What is given once, or by a function of s, at the arc lengths s: finite numbers (n, size)."""
    if callable(given):
        found: Array = values_of(what, given, [(float(x),) for x in s], size, "s = {:g} m")
        return found
    return np.tile(vector(what, given, size=size), (len(s), 1))


def _reflections(x: Array, t: Array, y: Array, u: Array) -> Array:
    """Steps of the double reflection (n, 3, 3): what carries a direction from each of the points x (n, 3) to that of y (n, 3), t
    and u (n, 3) the tangents there.
    """

    def across(normal: Array) -> Array:
        """Reflections in the planes with these normals; nothing where there is none."""
        square = (normal * normal).sum(1)
        share = np.divide(2.0, square, out=np.zeros_like(square), where=square > 0)
        return np.eye(3) - share[:, None, None] * normal[:, :, None] * normal[:, None, :]

    first = across(y - x)
    second = across(u - np.einsum("nij,nj->ni", first, t))

    # roundoff along the tangent is taken away
    square = np.eye(3) - u[:, :, None] * u[:, None, :]
    return np.asarray(square @ second @ first)
