"""Constraints on joint coordinates: gears, screws, drives.

sum_k c_k s_k(q) - motion(t) = 0            s_k: relative coordinates of markers                 (1)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np

from ...checks import function as checked_function
from ...errors import ROUNDINGS, CallbackError, FmbdError, floats, named
from ...rotations import Array
from ..frames import Kinematics
from ..kinds.time_derivatives import Rates, SmoothIntervals, TimeFormula, rates
from .constraints import Batch, Curves, Motion, Sides
from .relative import RelativeCoordinates


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """A prescribed motion t -> (s, s', s'') by a function of the user's own. ``of``: what is moved, in messages.

    ``function`` gives these three where ``complete``, else s alone; the derivatives are then computed
    (:mod:`..kinds.time_derivatives`), to roundoff where the function is made of NumPy's functions, in one call where it writes
    a ``formula``, which is ``analytic`` where its accelerations cannot jump. ``positive``: s is a length.
    """

    name: str
    function: Callable[[Any], Any]
    of: str
    complete: bool
    differenced: Callable[[Any], Any]  # the function up to its very end
    positive: bool = False
    formula: Callable[[float, float], Rates | None] | None = None  # s' and s'' at t where s is a place
    smooth: SmoothIntervals = field(default_factory=SmoothIntervals)
    table: Callable[[float], Any] | None = None  # as the user gave it
    analytic: bool = False

    def __call__(self, t: float) -> tuple[float, float, float]:
        """s, s', s'' at a time."""
        if not self.complete:
            place = self.place(t)
            return place, *self.rates(t, place)

        value = self.function(t)
        told: Any = tuple(value.tolist()) if isinstance(value, np.ndarray) and value.ndim == 1 else value
        if isinstance(told, tuple) and len(told) == 3 and self._usable(*told):  # the usual answer passes at once
            return told
        s = self._checked(value, t)
        self._require(len(s) == 3, s, t)
        return float(s[0]), float(s[1]), float(s[2])

    @property
    def by_differences(self) -> bool:
        """Whether differences have told its rates."""
        return self.smooth.differenced

    def moving(self, t: float) -> tuple[float, float]:
        """s and s' at a time."""
        if self.complete:
            return self(t)[:2]
        place = self.place(t)
        return place, self.rates(t, place)[0]

    def rates(self, t: float, place: float | None = None) -> tuple[float, float]:
        """s' and s'' of a function that gives s alone, at t the ``place``; a few roundings behind its end those at its end."""
        place = self.place(t) if place is None else place
        if self.formula is not None:
            told = self.formula(t, place)
            if told is not None:
                return told
        inside = t * (1.0 - ROUNDINGS)
        try:
            found = self.smooth.rates(self.differenced, t, place)
        except FmbdError:
            return rates(self.differenced, inside)
        return found if isfinite(found[0]) and isfinite(found[1]) else rates(self.differenced, inside)

    def place(self, t: float) -> float:
        """s alone."""
        if self.complete:
            return self(t)[0]
        value = self.function(t)
        if isinstance(value, float) and isfinite(value) and (value > 0.0 or not self.positive):
            return value
        s = self._checked(value, t)
        self._require(len(s) == 1, s, t)
        return float(s[0])

    def _usable(self, *value: Any) -> bool:
        """Whether they are finite numbers as they stand."""
        for x in value:
            if not (isinstance(x, float) and isfinite(x)):
                return False
        return value[0] > 0.0 or not self.positive

    def _checked(self, value: Any, t: float) -> Array:
        """The numbers that the function returned, (1,) or (3,)."""
        try:
            found: Array = floats(value).ravel()
        except (TypeError, ValueError, OverflowError):
            found = np.array(np.nan)
        self._require(found.shape in ((1,), (3,)) and bool(np.isfinite(found).all()), value, t)
        if self.positive and found[0] <= 0.0:
            raise CallbackError(
                f'Joint "{self.name}": its length is {found[0]:.6g} m at t = {t:g} s, and must stay above 0.'
            )
        return found

    def _require(self, usable: bool, value: Any, t: float) -> None:
        if not usable:
            raise CallbackError(
                f"Joint \"{self.name}\": the motion returned {value!r} at t = {t:g} s, expected s or (s, s', s''), finite and "
                "the same at all times."
            )


@dataclass(frozen=True)
class Standing:
    """A motion that stands at a value: the length of a rope over pulleys."""

    value: float

    def __call__(self, t: float) -> tuple[float, float, float]:
        """s, s', s'' at any time."""
        return self.value, 0.0, 0.0


def with_its_derivatives(function: Callable[[float], Any]) -> Callable[[float], Any]:
    """An interpolation that knows its derivatives, by ``derivative(order)`` as SciPy's do, as t -> (s, s', s'') by these;
    any other function as it is.
    """
    try:
        all_three = function, *(function.derivative(order) for order in (1, 2))  # type: ignore[attr-defined]
        known = all(np.size(one(0.0)) == 1 for one in all_three)
    except Exception:
        return function  # what it has by this name is no derivative
    if not known:
        return function
    return _at_once(all_three) or (lambda t: np.array([one(t) for one in all_three], dtype=float))


def _at_once(functions: tuple[Any, ...]) -> Callable[[float], Any] | None:
    """Piecewise polynomials of SciPy with the same pieces as one of several components; None for others, and for classes of a
    user's own that answer calls otherwise.
    """
    from scipy.interpolate import PPoly

    first = functions[0]
    plain = all(type(one).__call__ is PPoly.__call__ for one in functions)
    if not plain or not all(np.array_equal(one.x, first.x) for one in functions):
        return None
    # highest powers come first; derivatives have fewer
    coefficients = np.zeros((*first.c.shape[:2], len(functions)), first.c.dtype)
    for k, one in enumerate(functions):
        coefficients[len(first.c) - len(one.c) :, :, k] = one.c.reshape(one.c.shape[:2])
    return PPoly.construct_fast(coefficients, first.x, first.extrapolate)  # type: ignore[no-any-return]


def smooth_motion(
    name: str, function: Callable[[float], Any], *, of: str = "drive", positive: bool = False
) -> SmoothMotion:
    """A prescribed motion from a function that returns (s, s', s'') or s alone; it must be smooth.

    Whether it is, and whether its rates are those of its motion, is looked at along the run
    (:mod:`fmbd_fenicsx.run.judges.prescribed_motions`). ``of``: what is moved, in messages; ``positive``: as of
    :class:`SmoothMotion`.
    """
    checked_function(f'{of.capitalize()} "{name}": motion', function, "t", named="t")
    given, function = function, with_its_derivatives(function)
    what = f"The motion of {of}"
    asked = named(what, name, function, to_end=True)
    differenced = named(what, name, function)
    first = SmoothMotion(name, asked, of, False, differenced, positive)._checked(asked(0.0), 0.0)
    complete = len(first) == 3
    written = None if complete else TimeFormula.of(function)
    formula = None if written is None else named(what, name, written.rates, time=0)
    analytic = written is not None and written.smooth
    return SmoothMotion(name, asked, of, complete, differenced, positive, formula, table=given, analytic=analytic)


class CouplingBatch(Batch):
    """Rows (1). ``terms``: (relative coordinates of one kind, constraint numbers, coefficients)."""

    def __init__(
        self, terms: list[tuple[RelativeCoordinates, np.ndarray, Array]], motions: list[Motion | None]
    ) -> None:
        self.terms, self.size = terms, len(motions)
        self.driven = [(i, m) for i, m in enumerate(motions) if m is not None]

    def lengths(self, length: float) -> Array:
        """Sums of angles alone are angles; a coefficient turns those beside a distance into one."""
        linear = np.zeros(self.size, dtype=bool)
        for relative, rows, _ in self.terms:
            linear[rows] |= not relative.angular

        return np.where(linear, 1.0, length)

    def offsets(self, t: float) -> Array:
        """(3, m) array of s, s', s''."""
        s = np.zeros((3, self.size))
        # couplings without a motion stand still
        for i, motion in self.driven:
            s[:, i] = motion(t)
        return s

    def _sum(self, parts: list[Array]) -> Array:
        out = np.zeros(self.size)
        for (_, rows, c), value in zip(self.terms, parts, strict=True):
            out += np.bincount(rows, c * value, self.size)
        return out

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = sum c_k s_k - s(t)."""
        return self._sum([r.values(kin) for r, _, _ in self.terms]) - self.offsets(t)[0]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """sum c_k gamma_k - s''(t)."""
        return self._sum([r.gamma(kin) for r, _, _ in self.terms]) - self.offsets(t)[2]

    def curves(self, kin: Kinematics, t: float, lam: Array) -> Curves:
        """Those of every joint coordinate for multipliers times its factor c_k."""
        return [(relative.markers, relative.geometric(kin, c * lam[rows])) for relative, rows, c in self.terms]

    def sides(self, kin: Kinematics, t: float) -> Sides:
        """Rows of every joint coordinate times its factor c_k."""
        out = []
        for relative, rows, c in self.terms:
            ra, rb = relative.rows(kin)
            out += [(rows, relative.a, c[:, None] * ra), (rows, relative.b, c[:, None] * rb)]
        return out


def lead_ratio(lead: float) -> float:
    """Displacement per angle of a screw that advances ``lead`` (m) in one turn, m/rad."""
    return lead / (2 * math.pi)
