"""First and second derivatives of a user's function of time, whatever its time scale.

A function made of arithmetic, comparisons and NumPy's functions is called with a :class:`Jet`, a time that carries its
derivatives through every operation: exact to roundoff. Any other function (of ``math``, an interpolation, a table) is
differenced about t with steps of 2^-39 to 2^18 s, eight times as long from one to the next,

    s'(t) ~ (45 d_1 - 9 d_2 + d_3) / (60 h),     d_k = s(t + k h) - s(t - k h),                                          (1)
    s''(t) ~ (270 c_1 - 27 c_2 + 2 c_3) / (180 h^2),     c_k = s(t + k h) - 2 s(t) + s(t - k h),                         (2)

and the step counts whose error, by its difference from the formula of fourth order and its roundoff, is smallest. Longer steps
are tried as long as they agree with what shorter ones have found: a whole period would else look like rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

EPS = float(np.finfo(float).eps)
STEPS = tuple(2.0**k for k in range(-39, 19, 3))  # s
AGREES = 10.0  # times the errors that two steps are thought to have
REFUSED = (TypeError, ValueError, OverflowError, AttributeError)  # of functions that take plain numbers only

Rates = tuple[float, float]


class Jet:
    """A number x(t) with its first and second derivative, a jet of second order; a time t itself is (t, 1, 0)."""

    __slots__ = ("first", "second", "value")

    def __init__(self, value: float, first: float = 0.0, second: float = 0.0) -> None:
        self.value, self.first, self.second = value, first, second

    def through(self, f: float, df: float, ddf: float) -> Jet:
        """f(x) from the value and the derivatives of f at x."""
        return Jet(f, df * self.first, ddf * self.first**2 + df * self.second)

    # -- arithmetic -----------------------------------------------------------------------------------------------
    def __add__(self, other: Any) -> Jet:
        y = _moment(other)
        return Jet(self.value + y.value, self.first + y.first, self.second + y.second)

    def __mul__(self, other: Any) -> Jet:
        x, y = self, _moment(other)
        mixed = x.second * y.value + 2 * x.first * y.first + x.value * y.second
        return Jet(x.value * y.value, x.first * y.value + x.value * y.first, mixed)

    def __pow__(self, power: Any) -> Jet:
        if isinstance(power, Jet):
            return _unary("exp", power * _unary("log", self))
        n, x = float(power), self.value
        slope = n * x ** (n - 1) if n else 0.0
        return self.through(x**n, slope, n * (n - 1) * x ** (n - 2) if n * (n - 1) else 0.0)

    def __rpow__(self, base: Any) -> Jet:
        return _unary("exp", self * math.log(base))

    def __truediv__(self, other: Any) -> Jet:
        return self * _moment(other) ** -1.0

    def __rtruediv__(self, other: Any) -> Jet:
        return self**-1.0 * other

    def __mod__(self, other: Any) -> Jet:
        return Jet(self.value % float(other), self.first, self.second)

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.first, -self.second)

    def __sub__(self, other: Any) -> Jet:
        return self + -_moment(other)

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __abs__(self) -> Jet:
        return -self if self.value < 0 else self

    __radd__, __rmul__ = __add__, __mul__

    # -- comparisons, by the value --------------------------------------------------------------------------------
    def __lt__(self, other: Any) -> bool:
        return self.value < _moment(other).value

    def __le__(self, other: Any) -> bool:
        return self.value <= _moment(other).value

    def __gt__(self, other: Any) -> bool:
        return self.value > _moment(other).value

    def __ge__(self, other: Any) -> bool:
        return self.value >= _moment(other).value

    def __eq__(self, other: object) -> bool:
        return self.value == _moment(other).value

    def __hash__(self) -> int:
        return hash((self.value, self.first, self.second))

    def __bool__(self) -> bool:
        return bool(self.value)

    @property
    def real(self) -> Jet:
        """Itself."""
        return self

    def __format__(self, form: str) -> str:
        return format(self.value, form)

    # -- NumPy's functions ----------------------------------------------------------------------------------------
    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        """``np.sin(t)`` and the like."""
        if method != "__call__" or more:
            return NotImplemented
        name = ufunc.__name__
        if len(inputs) == 1:
            return _unary(name, inputs[0])
        known = _BINARY.get(name)
        return NotImplemented if known is None else known(*inputs)

    def __array_function__(self, function: Any, types: Any, inputs: Any, more: Any) -> Any:
        """``np.where`` of one condition, and ``np.clip``."""
        if function is np.where and len(inputs) == 3:
            return inputs[1] if inputs[0] else inputs[2]
        if function is np.clip and len(inputs) == 3 and not more:
            return min(max(inputs[0], inputs[1]), inputs[2])
        return NotImplemented


def _moment(x: Any) -> Jet:
    """A number as one that does not change; TypeError for anything else."""
    if isinstance(x, Jet):
        return x
    if isinstance(x, np.ndarray) and x.ndim:
        raise TypeError("arrays are no numbers")
    return Jet(float(x))


def _tan(x: float) -> tuple[float, float, float]:
    y = math.tan(x)
    return y, 1 + y * y, 2 * y * (1 + y * y)


def _tanh(x: float) -> tuple[float, float, float]:
    y = math.tanh(x)
    return y, 1 - y * y, -2 * y * (1 - y * y)


def _root(x: float) -> tuple[float, float, float]:
    y = math.sqrt(x)
    return y, 0.5 / y, -0.25 / (x * y)


# value, first and second derivative of functions of one number
_UNARY: dict[str, Callable[[float], tuple[float, float, float]]] = {
    "sin": lambda x: (math.sin(x), math.cos(x), -math.sin(x)),
    "cos": lambda x: (math.cos(x), -math.sin(x), -math.cos(x)),
    "tan": _tan,
    "exp": lambda x: (math.exp(x),) * 3,
    "expm1": lambda x: (math.expm1(x), math.exp(x), math.exp(x)),
    "log": lambda x: (math.log(x), 1 / x, -1 / x**2),
    "log1p": lambda x: (math.log1p(x), 1 / (1 + x), -1 / (1 + x) ** 2),
    "sqrt": _root,
    "sinh": lambda x: (math.sinh(x), math.cosh(x), math.sinh(x)),
    "cosh": lambda x: (math.cosh(x), math.sinh(x), math.cosh(x)),
    "tanh": _tanh,
    "arctan": lambda x: (math.atan(x), 1 / (1 + x * x), -2 * x / (1 + x * x) ** 2),
    "square": lambda x: (x * x, 2 * x, 2.0),
    "absolute": lambda x: (abs(x), math.copysign(1.0, x), 0.0),
    "fabs": lambda x: (abs(x), math.copysign(1.0, x), 0.0),
    "negative": lambda x: (-x, -1.0, 0.0),
    "positive": lambda x: (x, 1.0, 0.0),
    "deg2rad": lambda x: (math.radians(x), math.pi / 180, 0.0),
    "radians": lambda x: (math.radians(x), math.pi / 180, 0.0),
    "sign": lambda x: (float(np.sign(x)), 0.0, 0.0),
    "floor": lambda x: (math.floor(x), 0.0, 0.0),
}

_BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda x, y: _moment(x) + y,
    "subtract": lambda x, y: _moment(x) - y,
    "multiply": lambda x, y: _moment(x) * y,
    "divide": lambda x, y: _moment(x) / y,
    "power": lambda x, y: _moment(x) ** y,
    "remainder": lambda x, y: _moment(x) % y,
    "minimum": lambda x, y: min(_moment(x), _moment(y)),
    "maximum": lambda x, y: max(_moment(x), _moment(y)),
    "less": lambda x, y: _moment(x) < y,
    "less_equal": lambda x, y: _moment(x) <= y,
    "greater": lambda x, y: _moment(x) > y,
    "greater_equal": lambda x, y: _moment(x) >= y,
    "equal": lambda x, y: _moment(x) == y,
}


def _unary(name: str, x: Jet) -> Any:
    """A function of one number; TypeError where it is not known."""
    known = _UNARY.get(name)
    if known is None:
        raise TypeError(f"{name} of a moment")
    return x.through(*known(x.value))


# ------------------------------------------------------------------------------------------------------------------ use
def rates(function: Callable[[Any], Any], t: float) -> Rates:
    """s'(t) and s''(t) of ``function``(t) -> s."""
    try:
        found = function(Jet(t, 1.0))
        found = _moment(found if isinstance(found, Jet) else np.ravel(found)[0])
    except (*REFUSED, ZeroDivisionError):
        return _differenced(function, t)
    if not (math.isfinite(found.first) and math.isfinite(found.second)):
        return _differenced(function, t)
    return found.first, found.second


def _differenced(function: Callable[[Any], Any], t: float) -> Rates:
    """(1) and (2), each with the step that suits it best."""
    s = lambda x: float(function(x))
    here = s(t)
    firsts, seconds = [], []
    for h in STEPS:
        if t + h == t:
            continue
        ahead = [s(t + k * h) for k in (1, 2, 3)]
        behind = [s(t - k * h) for k in (1, 2, 3)]
        d = [x - y for x, y in zip(ahead, behind, strict=True)]
        c = [x - 2 * here + y for x, y in zip(ahead, behind, strict=True)]

        # values are known to their roundoff, and times to theirs
        noise = EPS * max(map(abs, (here, *ahead, *behind))) + EPS * abs(t) / h * max(map(abs, d))
        sixth = (45 * d[0] - 9 * d[1] + d[2]) / (60 * h)
        fourth = (8 * d[0] - d[1]) / (12 * h)
        firsts.append((sixth, abs(sixth - fourth) + noise / h))
        sixth = (270 * c[0] - 27 * c[1] + 2 * c[2]) / (180 * h * h)
        fourth = (16 * c[0] - c[1]) / (12 * h * h)
        seconds.append((sixth, abs(sixth - fourth) + 4 * noise / (h * h)))
    return _best(firsts), _best(seconds)


def _best(found: list[tuple[float, float]]) -> float:
    """Of estimates with their errors, by longer and longer steps, the most accurate one before the first that contradicts it."""
    best, error = found[0]
    for value, doubt in found[1:]:
        if not abs(value - best) <= AGREES * (error + doubt):
            break
        if doubt < error:
            best, error = value, doubt
    return best
