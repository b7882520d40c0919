"""Numbers with their first two derivatives by time, which arithmetic, comparisons and NumPy's functions carry on exactly.

Also through arrays: a product with one, ``np.sin`` of one, ``np.stack`` and ``np.cross`` take jets entry by entry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .expressions import of_scalars

# h of derivatives Im f(x + i h) / h, exact to roundoff (Squire and Trapp, doi:10.1137/S003614459631241X)
COMPLEX_STEP = 1e-30


class Jet:
    """A number x(t) with its first and second derivative, a jet of second order; a time t itself is (t, 1, 0)."""

    __slots__ = ("first", "second", "value")

    def __init__(self, value: float, first: float = 0.0, second: float = 0.0) -> None:
        self.value, self.first, self.second = value, first, second

    def through(self, f: float, df: float, ddf: float) -> Jet:
        """f(x) from the value and the derivatives of f at x."""
        return Jet(f, df * self.first, ddf * self.first**2 + df * self.second)

    # -- arithmetic -----------------------------------------------------------------------------------------------
    @of_scalars
    def __add__(self, other: Any) -> Jet:
        if type(other) is float:
            return Jet(self.value + other, self.first, self.second)
        y = jet(other)
        return Jet(self.value + y.value, self.first + y.first, self.second + y.second)

    @of_scalars
    def __mul__(self, other: Any) -> Jet:
        if type(other) is float:
            return Jet(self.value * other, self.first * other, self.second * other)
        x, y = self, jet(other)
        mixed = x.second * y.value + 2 * x.first * y.first + x.value * y.second
        return Jet(x.value * y.value, x.first * y.value + x.value * y.first, mixed)

    @of_scalars
    def __pow__(self, power: Any) -> Jet:
        if isinstance(power, Jet):
            return _unary("exp", power * _unary("log", self))
        n, x = float(power), self.value
        slope = n * x ** (n - 1) if n else 0.0
        return self.through(x**n, slope, n * (n - 1) * x ** (n - 2) if n * (n - 1) else 0.0)

    def __rpow__(self, base: Any) -> Jet:
        return _unary("exp", self * math.log(base))

    @of_scalars
    def __truediv__(self, other: Any) -> Jet:
        return self * (1.0 / other if type(other) is float and other else jet(other) ** -1.0)

    @of_scalars
    def __rtruediv__(self, other: Any) -> Jet:
        return self**-1.0 * other

    @of_scalars
    def __mod__(self, other: Any) -> Jet:
        return Jet(self.value % float(other), self.first, self.second)

    def __neg__(self) -> Jet:
        return Jet(-self.value, -self.first, -self.second)

    @of_scalars
    def __sub__(self, other: Any) -> Jet:
        return self + -jet(other)

    @of_scalars
    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __abs__(self) -> Jet:
        return -self if self.value < 0 else self

    __radd__, __rmul__ = __add__, __mul__

    # -- comparisons, by the value --------------------------------------------------------------------------------
    @of_scalars
    def __lt__(self, other: Any) -> bool:
        return self.value < jet(other).value

    @of_scalars
    def __le__(self, other: Any) -> bool:
        return self.value <= jet(other).value

    @of_scalars
    def __gt__(self, other: Any) -> bool:
        return self.value > jet(other).value

    @of_scalars
    def __ge__(self, other: Any) -> bool:
        return self.value >= jet(other).value

    def __eq__(self, other: object) -> bool:
        return self.value == jet(other).value

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
    def __getattr__(self, name: str) -> Any:
        """What ``np.sin`` asks the entries of an array of jets for."""
        if name not in _UNARY:
            raise AttributeError(name)
        return lambda: _unary(name, self)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **more: Any) -> Any:
        """``np.sin(t)`` and the like; with an array entry by entry."""
        if method != "__call__" or more:
            return NotImplemented
        if any(isinstance(x, np.ndarray) and x.ndim for x in inputs):
            return ufunc(*map(_in_arrays, inputs))
        name = ufunc.__name__
        if len(inputs) == 1:
            return _unary(name, jet(inputs[0]))
        known = _BINARY.get(name)
        return NotImplemented if known is None else known(*map(jet, inputs))

    def __array_function__(self, function: Any, types: Any, inputs: Any, more: Any) -> Any:
        """``np.where`` of one condition, ``np.clip``, ``np.interp``, and what makes arrays of numbers, as ``np.stack``."""
        if function is np.where and len(inputs) == 3 and not isinstance(inputs[0], np.ndarray):
            return inputs[1] if inputs[0] else inputs[2]
        if function is np.clip and len(inputs) == 3 and not more:
            return min(max(inputs[0], inputs[1]), inputs[2])
        if function is np.interp and len(inputs) == 3 and not more and isinstance(inputs[0], Jet):
            return _interpolated(*inputs)
        return function(*map(_in_arrays, inputs), **more)


def _interpolated(x: Jet, places: Any, values: Any) -> Jet:
    """``np.interp``: on a place of the table the slope is that of the side to which x goes, outside of it zero."""
    at, f = np.asarray(places, dtype=float), np.asarray(values, dtype=float)
    k = int(at.searchsorted(x.value, "left" if x.first < 0 else "right"))
    if not 0 < k < len(at):
        return Jet(float(f[min(k, len(at) - 1)]))
    slope = float((f[k] - f[k - 1]) / (at[k] - at[k - 1]))
    return x.through(float(f[k - 1]) + slope * (x.value - float(at[k - 1])), slope, 0.0)


def _in_arrays(x: Any) -> Any:
    """A jet, or those in a list, as arrays of objects."""
    if isinstance(x, list | tuple):
        return type(x)(map(_in_arrays, x))
    return np.array(x, dtype=object) if isinstance(x, Jet) else x


def jet(x: Any) -> Jet:
    """A number as one that does not change; TypeError for anything else."""
    if isinstance(x, Jet):
        return x
    if isinstance(x, np.ndarray):
        if x.ndim:
            raise TypeError("arrays are no numbers")
        return jet(x.item())
    return Jet(float(x))


def _tan(x: float) -> tuple[float, float, float]:
    y = math.tan(x)
    return y, 1 + y * y, 2 * y * (1 + y * y)


def _tanh(x: float) -> tuple[float, float, float]:
    y = math.tanh(x)
    return y, 1 - y * y, -2 * y * (1 - y * y)


def _arcsine(x: float) -> tuple[float, float, float]:
    y = 1.0 / math.sqrt(1.0 - x * x)
    return math.asin(x), y, x * y**3


def _arccosine(x: float) -> tuple[float, float, float]:
    y, first, second = _arcsine(x)
    return 0.5 * math.pi - y, -first, -second


def _direction(y: Jet, x: Jet) -> Jet:
    """arctan2(y, x), by the angle phi' = (x y' - y x') / r^2."""
    square = x.value**2 + y.value**2
    across = (x.value * y.first - y.value * x.first) / square
    along = 2 * (x.value * x.first + y.value * y.first) / square
    second = (x.value * y.second - y.value * x.second) / square - across * along
    return Jet(math.atan2(y.value, x.value), across, second)


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
    "arcsin": _arcsine,
    "arccos": _arccosine,
    "log10": lambda x: (math.log10(x), 1 / (x * math.log(10)), -1 / (x * x * math.log(10))),
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

_BINARY: dict[str, Callable[[Jet, Jet], Any]] = {
    "add": lambda x, y: x + y,
    "subtract": lambda x, y: x - y,
    "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y,
    "power": lambda x, y: x**y,
    "hypot": lambda x, y: _unary("sqrt", x * x + y * y),
    "arctan2": _direction,
    "remainder": lambda x, y: x % y,
    "minimum": lambda x, y: min(x, y),
    "maximum": lambda x, y: max(x, y),
    "less": lambda x, y: x < y,
    "less_equal": lambda x, y: x <= y,
    "greater": lambda x, y: x > y,
    "greater_equal": lambda x, y: x >= y,
    "equal": lambda x, y: x == y,
}


def _unary(name: str, x: Jet) -> Any:
    """A function of one number; TypeError where it is not known."""
    known = _UNARY.get(name)
    if known is None:
        raise TypeError(f"{name} of a moment")
    return x.through(*known(x.value))
