"""Rates of a function of time by polynomials: what is asked for once in an interval serves all times in it.

In an interval around which the function is smooth, s is interpolated at N + 1 points of Chebyshev of one that is twice as wide,

    s(t) ~ sum_k c_k T_k(x),    x = (t - m) / r,                                                         (1)

m its middle and r half its width; it ends where the function is known to break, and at t = 0. Rates are those of (1) where the
last quarter of the c_k, of size e, is roundoff of s, or has no weight in the rates:

    e sum_k |T_k'| < RATE max |s' r|,    e sum_k |T_k''| < CURVE max |s'' r^2|                            (2)

up to the last c_k above e, those behind it count as zero. Every third value tells first whether the c_k fall at all. An interval
without such a polynomial is cut in parts; where the last have none, that of the interval that misses (2) least serves, by not
more than tenfold. What is found of one does not depend on what was asked before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from ...rotations import Array

N = 24  # degree of polynomials
PARTS, LEVELS = 8, 5  # of an interval; widths of intervals
FEW = slice(None, None, 3)  # values that are looked at first
FALLS = 3e-3  # of the largest c_k, k > 0, by these: what the last two may be
ROUNDED = 4.0  # times e: c_k below are none
RATE, CURVE = 1e-10, 1e-7  # of the largest s' and s''
MISSED = 10.0  # times these, at most
SEEN = 1e-14  # of the largest s: roundoff
OFF = 10.0  # times e and the roundoff of s: by how much (1) may differ from s
EPS, TINY = float(np.finfo(float).eps), float(np.finfo(float).tiny)

_K = np.arange(N + 1.0)
_X = np.cos(np.pi * _K / N)
_SERIES = np.linalg.inv(np.cos(np.outer(np.arccos(_X), _K)))  # c by values at these x
_OF_FEW = np.linalg.inv(np.cos(np.outer(np.arccos(_X[FEW]), _K[: N // 3 + 1])))  # the same by these
_RATE = np.array([np.append(chebyshev.chebder(row), 0.0) for row in np.eye(N + 1)]).T  # those of ds/dx by c


@dataclass(frozen=True)
class TimePolynomial:
    """(1) about a middle (s): r (s), coefficients of s, s' and s'' (N + 1, 3), by how much s may differ from the function, and
    the larger left side of (2) over the right one.
    """

    middle: float
    radius: float
    series: Array
    off: float
    missed: float

    def rates(self, t: float, place: float) -> tuple[float, float] | None:
        """s' and s'' at a time where the function says ``place``; None where the polynomial does not."""
        x = (t - self.middle) / self.radius
        s, rate, curve = map(float, np.cos(_K * math.acos(min(max(x, -1.0), 1.0))) @ self.series)
        return (rate, curve) if abs(s - place) <= self.off else None


def times_between(begin: float, end: float) -> list[float]:
    """At which a function is asked for its polynomial."""
    return list(map(float, 0.5 * (begin + end) + 0.5 * (end - begin) * _X))


def falls(values: Sequence[float]) -> bool:
    """Whether values at few of these times let (2) be hoped for."""
    c = np.abs(_OF_FEW @ np.array(values))
    return bool(c[-2:].max() <= FALLS * c[1:].max() + SEEN * np.abs(values).max())


def polynomial(
    values: Sequence[float], ends: tuple[float, float], served: tuple[float, float]
) -> TimePolynomial | None:
    """That of values at :func:`times_between` both ends, to serve an interval; None where (2) is far from holding."""
    middle, radius = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    size = float(np.abs(np.array(values)).max())
    c = _SERIES @ np.array(values)
    e = float(np.abs(c[3 * N // 4 :]).max())
    last = int(np.flatnonzero(np.abs(c) > ROUNDED * e).max(initial=0))
    c[last + 1 :] = 0.0
    rate = _RATE @ c
    curve = _RATE @ rate

    missed = 0.0
    if e > SEEN * size:
        first, end = max((served[0] - middle) / radius, -1.0), min((served[1] - middle) / radius, 1.0)
        x = np.linspace(first, end, 9)
        T = np.cos(np.outer(np.arccos(x), _K))
        slopes, curves = _largest_derivatives(float(np.abs(x).max()))
        of_rate = e * slopes[: last + 1].sum() / max(RATE * np.abs(T @ rate).max(), TINY)
        of_curve = e * curves[: last + 1].sum() / max(CURVE * np.abs(T @ curve).max(), TINY)
        missed = float(max(of_rate, of_curve))
        if missed > MISSED:
            return None
    series = np.stack((c, rate / radius, curve / radius**2), axis=1)
    return TimePolynomial(middle, radius, series, OFF * (e + EPS * size), missed)


def _largest_derivatives(x: float) -> tuple[Array, Array]:
    """Bounds of |T_k'| and |T_k''| between -x and x, (N + 1,) each."""
    inside = max(1.0 - x * x, EPS)
    slopes = np.minimum(_K**2, _K / math.sqrt(inside))
    return slopes, np.minimum(_K**2 * (_K**2 - 1.0) / 3.0, _K * (_K + 1.0 / math.sqrt(inside)) / inside)
