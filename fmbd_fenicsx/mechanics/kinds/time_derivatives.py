"""First and second derivatives of a user's function of time, whatever its time scale.

A function made of arithmetic, comparisons and NumPy's functions is called with a :class:`.Jet`, a time that carries its
derivatives through every operation: exact to roundoff. One that writes a single formula is called with a symbol, once, and its
derivatives are formulas as well, one call of Python each time (:class:`TimeFormula`). Any other function (of ``math``, an
interpolation, a table) is differenced about t with steps of 2^-39 to 2^18 s, eight times as long from one to the next,

    h^m d^m s / dt^m ~ sum_k w_k (s(t + k h) - s(t)),     sum_k w_k k^j = m! for j = m, else 0,   j = 1 ... 6,            (1)

with k = -3 ... 3, and where the function ends (it raises, or returns no finite number), or is said to break, with k = 1 ... 6
or -6 ... -1. The step counts whose error, by its difference from the formula of the four nearest k and its roundoff, is smallest.
Longer steps are tried as long as they agree with what shorter ones have found: a whole period would else look like rest. Across
a kink formulas of s'' may agree by chance: a step counts for s'' where its s' is that of the step before, and none behind one
that contradicts an s' which is sure. At a kink rates are those behind it: where no polynomial joins both sides, the side ahead is
asked alone. Where a function is smooth in an interval, a polynomial tells its rates instead (:class:`SmoothIntervals`): two to
seven values a time, all of them asked for by one call of a function that takes an array of times.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from operator import mul, sub, truediv
from typing import Any

import numpy as np

from ...errors import AGREEMENTS, FmbdError
from .expressions import Program, as_expression, gradient, passing, symbol
from .jets import Jet, jet
from .time_polynomials import FEW, LEVELS, PARTS, TimePolynomial, falls, polynomial, times_between

EPS = float(np.finfo(float).eps)
STEPS = tuple(2.0**k for k in range(-39, 19, 3))  # s
AGREES = 10.0  # times the errors that two steps are thought to have
INTERVAL = 64  # steps over which a function is smooth, in the widest interval
SMOOTH = 1e-3  # of its change over a step: what a polynomial may leave of it
MOST = 1000  # intervals whose polynomials are kept
REFUSED = (TypeError, ValueError, OverflowError, AttributeError)  # of functions that take plain numbers only
SAME = 1e-9  # of a value: what a formula may miss of what the function says
OUTSIDE = (*REFUSED, ArithmeticError, FmbdError)  # of functions of a part of the time only

Rates = tuple[float, float]
Span = tuple[float, float]  # of time, s
ALWAYS: Span = -math.inf, math.inf
AHEAD: Span = 0.0, math.inf  # kinks at t = 0 are not seen from both sides


def rates(function: Callable[[Any], Any], t: float, scale: float = 0.0) -> Rates:
    """s'(t) and s''(t) of ``function``(t) -> s; ``scale``: of terms that may cancel in s, whose roundoff stays."""
    return _by_jets(function, t) or _differenced(function, t, scale)


def _by_jets(function: Callable[[Any], Any], t: float) -> Rates | None:
    """Both rates, exact, of a function that takes jets; None of any other."""
    try:
        found = function(Jet(t, 1.0))
        found = jet(found if isinstance(found, Jet) else np.ravel(found)[0])
    except (*REFUSED, ZeroDivisionError):
        return None
    return (found.first, found.second) if math.isfinite(found.first) and math.isfinite(found.second) else None


class TimeFormula:
    """What a function t -> s wrote when it was called with a symbol, with its derivatives: s, s', s''.

    ``smooth``: wherever it has a value.
    """

    def __init__(self, s: Program, smooth: bool) -> None:
        self.s, self.smooth = s, smooth

    @classmethod
    def of(cls, function: Callable[[Any], Any]) -> TimeFormula | None:
        """None of a function with cases, tables, or another library's functions."""
        with passing():
            try:
                t = symbol("t")
                s = as_expression(*np.ravel(function(t)))
                first = gradient(s, [t])[0]
                return cls(
                    Program([s, first, gradient(first, [t])[0]], numbers=True), _smooth(Program([s], numbers=True))
                )
            except Exception:
                return None

    def rates(self, t: float, s: float) -> Rates | None:
        """s' and s'' where the function says s, as the formula does; None where it does not, or has no derivatives."""
        try:
            value, first, second = self.s({"t": t})
        except (ArithmeticError, ValueError):
            return None
        known = math.isfinite(first) and math.isfinite(second)
        return (first, second) if known and abs(value - s) <= SAME * abs(s) else None


def _smooth(s: Program) -> bool:
    """Whether a formula is so wherever it has a value: without roots, which end at zero, angles within a turn, and poles."""
    poles = any(of is truediv and s.given[places[1]] is None for _, of, places in s.steps)
    return not poles and not any(of in (math.sqrt, math.atan2) for _, of, _ in s.steps)


def along(function: Callable[[Any, Any], Any], x: Any, v: Any, t: float) -> Rates | None:
    """Value and rate of ``function``(x, t) at a place x that moves with v; None where it does not take jets."""
    place = np.array([Jet(a, b) for a, b in zip(x.tolist(), v.tolist(), strict=True)], dtype=object)
    try:
        found = jet(function(place, Jet(t, 1.0)))
    except Exception:
        return None
    return (found.value, found.first) if math.isfinite(found.value) and math.isfinite(found.first) else None


@dataclass(frozen=True)
class DifferenceFormula:
    """Of the m-th derivative in (1): the w_k of all six nodes and of the four nearest, and the sum of the former's sizes."""

    best: tuple[float, ...]
    rough: tuple[float, ...]
    size: float

    def sums(self, d: Sequence[float]) -> tuple[float, float]:
        """Both sums in (1) over the differences d_k = s(t + k h) - s(t)."""
        return sum(map(mul, self.best, d)), sum(map(mul, self.rough, d))


def _formulas(nodes: Sequence[int]) -> tuple[DifferenceFormula, ...]:
    """Those of the first and the second derivative, numbers of Python: six of them are summed sooner than an array is made."""
    found = np.zeros((2, 2, 6))
    for kind, used in enumerate((6, 4)):
        which = np.argsort(np.abs(nodes), kind="stable")[:used]
        powers = np.array(nodes, dtype=float)[which] ** np.arange(1, used + 1)[:, None]
        found[kind][:, which] = np.linalg.solve(powers, np.eye(used)[:, :2] * (1.0, 2.0)).T
    return tuple(
        DifferenceFormula(tuple(w.tolist()), tuple(r.tolist()), float(np.abs(w).sum()))
        for w, r in zip(*found, strict=True)
    )


SIDES = tuple(
    (nodes, _formulas(nodes)) for nodes in ((-3, -2, -1, 1, 2, 3), (1, 2, 3, 4, 5, 6), (-6, -5, -4, -3, -2, -1))
)


class Best:
    """Of estimates with their errors, by longer and longer steps, the most accurate one before the first that contradicts it.

    ``number``: of its step; ``parted``: no polynomial joins its values. One alone may be misled by roundoff of terms that cancel,
    of which values tell nothing; two steps in turn that agree to :data:`SMOOTH` of a rate are ``sure``, and only these can be
    contradicted.
    """

    __slots__ = ("contradicted", "error", "number", "parted", "sharp", "sure", "value")

    def __init__(self) -> None:
        self.value, self.error, self.number = math.nan, math.inf, 0
        self.sharp = self.sure = self.contradicted = self.parted = False

    def take(self, value: float, doubt: float, number: int) -> None:
        """Look at the estimate by the next longer step."""
        if self.contradicted:
            return
        sharp = doubt <= SMOOTH * abs(value)
        agrees = math.isnan(self.value) or abs(value - self.value) <= AGREES * (self.error + doubt)
        if not agrees and self.sure:
            self.contradicted = True
            return
        self.sure |= agrees and sharp and self.sharp
        self.sharp = sharp
        if doubt < self.error:
            self.value, self.error, self.number = value, doubt, number


class Values(dict[float, float]):
    """Values of a function of time, each asked for once."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        super().__init__()
        self.function = function

    def __missing__(self, t: float) -> float:
        self[t] = value = float(self.function(t))
        return value

    def together(self, times: Sequence[float]) -> list[float] | None:
        """The function's answers to an array of times; None where it has none for each."""
        asked = np.array(times)
        asked.flags.writeable = False
        try:
            found = self.function(asked)
        except OUTSIDE:
            return None
        usable = isinstance(found, np.ndarray) and found.shape == asked.shape and found.dtype == float
        answers: list[float] = found.tolist() if usable else [math.nan]
        return answers if math.isfinite(sum(answers)) else None


class SmoothIntervals:
    """Rates of one function by polynomials (:mod:`.time_polynomials`), each of an interval of time in which it is smooth, and
    beside these as :func:`rates`.

    What is found is a function of the time alone, whoever was asked before: runs that are taken up go on to the last bit.
    """

    def __init__(self) -> None:
        self.breaks: list[float] = []  # times (s) at which the function is not smooth, rising
        self.differenced = False  # whether differences have told any rates
        self.takes_arrays: bool | None = None  # whether the function does; None: not tried yet
        self.takes_jets: bool | None = None  # likewise, where it begins
        self.widest = math.nan  # interval of a polynomial, s
        self.polynomials: dict[
            tuple[float, int, float], TimePolynomial | None
        ] = {}  # by width (s), number, break before it

    def break_at(self, times: Iterable[float]) -> None:
        """The function is not smooth at some more times, s."""
        breaks = sorted({*self.breaks, *times})
        if breaks != self.breaks:
            self.breaks, self.differenced = breaks, False
            self.polynomials.clear()

    def smooth_about(self, t: float) -> Span:
        """Between which times (s) it is smooth: at a break it is what it is behind it."""
        i = bisect_right(self.breaks, t)
        return self.breaks[i - 1] if i else -math.inf, self.breaks[i] if i < len(self.breaks) else math.inf

    def rates(self, function: Callable[[Any], Any], t: float, place: float) -> Rates:
        """s'(t) and s''(t) of ``function``(t) -> s, which is at a ``place``."""
        exact = self.by_polynomial(function, t, place) or _by_jets(function, t)
        if exact is not None:
            return exact
        self.differenced = True
        return _differenced(function, t, span=self.smooth_about(t))

    def by_polynomial(self, function: Callable[[Any], Any], t: float, place: float) -> Rates | None:
        """Both rates by the polynomial of the widest interval around t that has a good one, where it is at a ``place``.

        None without any, and of a function that takes jets.
        """
        if self.takes_jets is None:
            self.takes_jets = _by_jets(function, 0.0) is not None
            self.widest = math.nan if self.takes_jets else INTERVAL * _smooth_step(function)
        if self.takes_jets:
            return None

        span, width = self.smooth_about(t), self.widest
        best: TimePolynomial | None = None
        for _ in range(LEVELS):
            key = width, math.floor(t / width), span[0]
            if key not in self.polynomials:
                if len(self.polynomials) == MOST:
                    self.polynomials.clear()
                self.polynomials[key] = self._polynomial(function, key, span)

            found = self.polynomials[key]
            if found is not None and (best is None or found.missed < best.missed):
                best = found
            if best is not None and best.missed < 1.0:
                break
            width /= PARTS
        return None if best is None else best.rates(t, place)

    def _polynomial(
        self, function: Callable[[Any], Any], key: tuple[float, int, float], span: Span
    ) -> TimePolynomial | None:
        """That of one interval, from values as far around it as the function is smooth."""
        width, number, _ = key
        begin, values = number * width, Values(function)
        first, behind = max(span[0], 0.0 if number >= 0 else -math.inf), math.nextafter(span[1], -math.inf)
        ends = max(begin - 0.5 * width, first), min(begin + 1.5 * width, behind)
        times = times_between(*ends)
        for some in (times[FEW], times):
            self._ask(values, some)
            try:
                there = [values[t] for t in some]
            except OUTSIDE:
                return None
            if not all(map(math.isfinite, there)) or (some is not times and not falls(there)):
                return None
        return polynomial(there, ends, (begin, begin + width))

    def _ask(self, values: Values, times: Sequence[float]) -> None:
        """Find what a function says at some times by one call, if it takes arrays and is known at all of them.

        Whether it takes them is seen where all values are known alone, and at every later call by one of them.
        """
        if self.takes_arrays is False or AGREEMENTS:
            return
        found = values.together(times)
        try:
            alone = [values[x] for x in (times[:1] if self.takes_arrays else times)]
        except OUTSIDE:
            return
        if found is None:
            self.takes_arrays = self.takes_arrays or False
            return
        most = max(map(abs, found))
        self.takes_arrays = max(map(abs, map(sub, found, alone))) <= SAME * most
        values.update(zip(times, found, strict=True) if self.takes_arrays else ())


def _smooth_step(function: Callable[[Any], Any]) -> float:
    """The longest step (s) over which it is a polynomial behind t = 0."""
    here = float(function(0.0))
    for n, h in enumerate(STEPS):
        around = _around(function, 0.0, h, AHEAD)
        if around is None:
            return STEPS[max(n - 1, 0)]
        there, (formula, _) = around
        d = [value - here for value in there]
        value, rough = formula.sums(d)
        if abs(value - rough) > SMOOTH * max(map(abs, d)) + EPS * formula.size * max(map(abs, there)):
            return STEPS[max(n - 1, 0)]
    return STEPS[-1]


def _differenced(function: Callable[[Any], Any], t: float, scale: float = 0.0, span: Span = ALWAYS) -> Rates:
    """(1) for m = 1 and 2, each with the step that suits it best; NaN where the function is known at t alone."""
    values = Values(function).__getitem__  # steps are looked at again ahead
    found = search(values, t, scale, span)
    if found[1].parted:
        ahead = search(values, t, scale, (t, span[1]))
        found = ahead if ahead[1].error < SMOOTH * found[1].error else found
    return found[0].value, found[1].value


def search(
    function: Callable[[Any], Any],
    t: float,
    scale: float = 0.0,
    span: Span = ALWAYS,
    steps: Sequence[int] = range(len(STEPS)),
) -> tuple[Best, Best]:
    """The same by some of the steps, as long as they stay in the ``span`` of times in which the function is smooth."""
    here = float(function(t))
    first, second = Best(), Best()
    shorter: tuple[float, float] | None = None  # s' by the step before, with its doubt
    side: tuple[DifferenceFormula, ...] | None = None
    for number in steps:
        h = STEPS[number]
        if t + h == t:
            continue
        around = _around(function, t, h, span)
        if around is None:
            break
        there, formulas = around

        # values are known to their roundoff, and times to theirs
        d = [value - here for value in there]
        most = max(map(abs, d))
        noise = EPS * max(scale, abs(here), max(map(abs, there))) + EPS * abs(t) / h * most
        of_rate, of_curve = formulas
        (rate, rough_rate), (curve, rough_curve) = of_rate.sums(d), of_curve.sums(d)
        blur, blurred = noise * of_rate.size, noise * of_curve.size

        rate, doubt = rate / h, (abs(rate - rough_rate) + blur) / h
        # where longer steps fit on another side only, and it is another function there
        if side is not None and side is not formulas and not _agree(rate, doubt, first.value, first.error):
            break
        side = formulas
        first.take(rate, doubt, number)
        # across a kink both formulas of s'' may agree by chance, but s' leaps
        if shorter is None or _agree(rate, doubt, *shorter):
            apart = abs(curve - rough_curve)
            second.take(curve / (h * h), (apart + blurred) / (h * h), number)
            if second.number == number:
                second.parted = apart > SMOOTH * most + blurred
        else:
            second.contradicted |= second.sure
        shorter = rate, doubt

        if first.contradicted:  # beyond a kink
            break
    return first, second


def _agree(rate: float, doubt: float, other: float, its_doubt: float) -> bool:
    """Whether two estimates, each with its doubt, may be of one rate."""
    return abs(rate - other) <= SMOOTH * abs(rate) + AGREES * (doubt + its_doubt)


def _around(
    function: Callable[[Any], Any], t: float, h: float, span: Span
) -> tuple[list[float], tuple[DifferenceFormula, ...]] | None:
    """Values at t + k h with the formulas of these k: on both sides, else ahead, else behind; None where neither is known."""
    for nodes, formulas in _sides(t, h, span):
        try:
            there = [float(function(t + k * h)) for k in nodes]
        except OUTSIDE:
            continue
        if all(map(math.isfinite, there)):
            return there, formulas
    return None


def _sides(t: float, h: float, span: Span) -> list[tuple[tuple[int, ...], tuple[DifferenceFormula, ...]]]:
    """Those of :data:`SIDES` about t with steps h that stay in a span of time."""
    return [side for side in SIDES if t + side[0][0] * h >= span[0] and t + side[0][-1] * h < span[1]]
