"""Laws of the user's own on scalar coordinates, N(s, s', t), of many elements: asked with arrays where they take them.

Laws are of one kind where they are one function, or functions of one text that differ in numbers: values of defaults or of
variables around them. Such a kind is asked once, for arrays of all its elements, with arrays of these numbers in their places:

    for spring, k in ...:   law=lambda s, rate, t, k=k: k * s        ->    one call with s (.., n) and k (n,)

Whether arrays give what numbers give is seen at the first call, where all elements are asked alone too, and at every later
call by one of them in turn. A kind that does not take arrays is asked element by element.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from itertools import cycle, repeat
from math import isfinite
from operator import attrgetter, is_
from types import CellType, FunctionType, MethodType
from typing import Any, TypeAlias

import numpy as np

from ...errors import AGREEMENTS
from ...log import log
from ...rotations import Array
from .passed_over import Asked
from .user_laws import Repeatable

FEW = 8  # numbers: below it Python is faster with each of them
STEP = 1e-6  # of differences, relative to s and s'
ASIDE = np.array(((1.0, -1.0, 0.0, 0.0), (0.0, 0.0, 1.0, -1.0)))[
    :, :, None
]  # where differences ask: steps of s, and of s'
LEAST = 1e-3  # size of these (of the model, and that a second)
SAME = 1e-9  # relative, of arrays against numbers: their functions may round in other ways
GAUSS = (0.5 - 0.15**0.5, 5 / 18), (0.5, 4 / 9), (0.5 + 0.15**0.5, 5 / 18)  # points and weights, of means over a step
Times: TypeAlias = float | Array  # one, or (k, 1) of as many rows of elements
_content = attrgetter("cell_contents")


def mean_effort(law: Callable[[Array, Array], Array], begun: Array, rate: Array, h: float) -> Array:
    """Means (n,) of N(s, s') over a step of size h (s) that begins at s = ``begun`` with constant rates (n,); all points in one
    call with arrays (3, n).
    """
    points, weights = np.array(GAUSS).T
    s = begun + points[:, None] * (h * rate)
    return np.asarray(weights @ law(s, np.broadcast_to(rate, s.shape)))


class LawsTogether:
    """The laws of n elements; ``size``: what elongations may be, m or rad."""

    def __init__(self, laws: Sequence[Repeatable], size: float = 1.0) -> None:
        self.laws, self.size, self.least, self.asked = laws, size, LEAST * size, Asked(len(laws))
        kinds: dict[Hashable, list[int]] = {}
        for i, law in enumerate(laws):
            kinds.setdefault(_kind(law.function), []).append(i)
        self.kinds = [OneKind([laws[i] for i in which], np.array(which)) for which in kinds.values()]

    def part(self, which: Sequence[int] | np.ndarray) -> LawsTogether:
        """Those of some elements."""
        return LawsTogether([self.laws[i] for i in which], self.size)

    def __call__(self, s: Array, rate: Array, t: Times) -> Array:
        """N at elongations and rates: all (.., n); at one time, or (k, n) at as many times."""
        if s.size < FEW:
            return _alone(self.laws, s, rate, t)
        if len(self.kinds) == 1:
            return self.kinds[0](s, rate, t)
        out = np.empty(s.shape)
        for kind in self.kinds:
            out[..., kind.which] = kind(s[..., kind.which], rate[..., kind.which], t)
        return out

    def slopes(self, s: Array, rate: Array, t: float) -> tuple[Array, Array]:
        """dN/ds and dN/ds', (n,), by central differences in steps of the size of s and s'."""
        if 2 * len(self.laws) < FEW:
            at = zip(self.laws, map(float, s), map(float, rate), strict=True)
            each = [_slopes(law.number, (x, v, t), self.least) for law, x, v in at]
            return tuple(np.array(each).T)  # type: ignore[return-value]
        here = np.array((s, rate))
        steps = STEP * np.maximum(np.abs(here), self.least)
        places, rates = here[:, None] + ASIDE * steps[:, None]
        efforts = self(places, rates, t)
        along, of_rate = (efforts[::2] - efforts[1::2]) / (2 * steps)
        return along, of_rate


class OneKind:
    """Laws of one kind, of some elements ``which``. ``function``: one of them for arrays of all; ``cells``: variables around the
    laws that differ, whose ``contents`` it has.
    """

    def __init__(self, laws: Sequence[Repeatable], which: np.ndarray) -> None:
        self.laws, self.which = laws, which
        # whether arrays of elements, and those at several times, give what numbers give; None: not tried yet
        self.takes_arrays: bool | None = None
        self.takes_times: bool | None = None
        self.turn = 0  # who is asked alone next

        functions = [law.function for law in laws]
        cells = zip(*(getattr(f, "__closure__", None) or () for f in functions), strict=True)
        self.cells = [x for same in cells if any(y is not same[0] for y in same) for x in same]
        self.contents = [x.cell_contents for x in self.cells]
        self.function = _of_arrays(functions)

    def __call__(self, s: Array, rate: Array, t: Times) -> Array:
        """N at elongations and rates: all (.., n)."""
        by_rows = not isinstance(t, float) and self.takes_times is False
        if self.takes_arrays is False or (s[0] if by_rows else s).size < FEW or AGREEMENTS:
            return _alone(self.laws, s, rate, t)
        if self.cells and not all(map(is_, map(_content, self.cells), self.contents)):
            return _alone(self.laws, s, rate, t)  # somebody changed a variable: it may be no number any more
        if isinstance(t, float) or by_rows:
            self.takes_arrays, found = self._tried(s, rate, t, self.takes_arrays)
        else:
            self.takes_times, found = self._tried(s, rate, t, self.takes_times)
        return found

    def _tried(self, s: Array, rate: Array, t: Times, known: bool | None) -> tuple[bool, Array]:
        """Whether arrays are taken as numbers are, None where that is not ``known`` yet, and N."""
        single = _alone(self.laws, s, rate, t) if known is None else None
        found = self._together(s, rate, t)
        if found is None or (single is not None and not _same(found, single)):
            return False, _alone(self.laws, s, rate, t) if single is None else single

        # one of them alone: what differs shows itself within a few calls
        self.turn += 1
        at = tuple([self.turn % size for size in s.shape])
        law, now = self.laws[at[-1]], t if isinstance(t, float) else float(t[at[0], 0])
        one = law.number(float(s[at]), float(rate[at]), now)
        off = abs(one - found[at])
        if off <= SAME * abs(one) or off <= SAME * 1e-3 * float(np.abs(found).max()):
            return True, found
        if single is None:
            log.warning(
                'the law of "%s" gives %.9g with numbers and %.9g with arrays at t = %g s, although it agreed before: it is '
                "asked with numbers from now on. Write branches (if) with numpy.where",
                law.name, one, found[at], now,
            )  # fmt: skip
        return False, _alone(self.laws, s, rate, t)

    def _together(self, s: Array, rate: Array, t: Times) -> Array | None:
        """The same by arrays; None where there is no such answer."""
        s, rate = s.view(), rate.view()
        s.flags.writeable = rate.flags.writeable = False  # numbers cannot be changed by a law either
        try:
            if isinstance(t, float) or self.takes_times is not False:
                found = self.function(s, rate, t)
            else:
                times = t.ravel().tolist()
                found = np.array([self.function(x, v, now) for x, v, now in zip(s, rate, times, strict=True)])
            good = (
                isinstance(found, np.ndarray) and found.shape == s.shape and isfinite(np.add.reduce(found, axis=None))
            )
        except Exception:
            return None  # alone it says who failed
        return np.asarray(found, dtype=float) if good else None


def _alone(laws: Sequence[Repeatable], s: Array, rate: Array, t: Times) -> Array:
    """N at elongations and rates, all (.., n), each number by itself."""
    times: Any = repeat(t) if isinstance(t, float) else t.repeat(len(laws)).tolist()
    numbers = zip(cycle(laws), s.ravel().tolist(), rate.ravel().tolist(), times, strict=False)
    return np.array([law.number(x, v, now) for law, x, v, now in numbers]).reshape(s.shape)


def _slopes(
    law: Callable[[float, float, float], float], at: tuple[float, float, float], least: float
) -> tuple[float, float]:
    """The slopes of one law at (s, s', t)."""
    s, rate, t = at
    hs, hv = STEP * max(abs(s), least), STEP * max(abs(rate), least)
    along = (law(s + hs, rate, t) - law(s - hs, rate, t)) / (2 * hs)
    return along, (law(s, rate + hv, t) - law(s, rate - hv, t)) / (2 * hv)


def _same(one: Array, other: Array) -> bool:
    return bool(np.allclose(one, other, rtol=SAME, atol=1e-3 * SAME * float(np.abs(other).max())))


def _is_number(x: Any) -> bool:
    return isinstance(x, int | float) and not isinstance(x, bool)


def _kind(f: Any) -> Hashable:
    """Equal for functions that differ in numbers only."""
    if isinstance(f, MethodType):
        return id(f.__self__), id(f.__func__)
    if not isinstance(f, FunctionType):
        return id(f)

    def key(x: Any) -> Hashable:
        return type(x).__name__ if _is_number(x) else id(x)

    try:
        around = tuple(key(cell.cell_contents) for cell in f.__closure__ or ())
    except ValueError:  # a variable without a value as yet
        return id(f)
    named = tuple((name, key(x)) for name, x in (f.__kwdefaults__ or {}).items())
    return f.__code__, id(f.__globals__), tuple(map(key, f.__defaults__ or ())), named, around


def _of_arrays(functions: Sequence[Callable[..., Any]]) -> Callable[..., Any]:
    """One function of the same kind, with arrays (n,) where their numbers differ."""
    first = functions[0]
    if all(f is first for f in functions) or not isinstance(first, FunctionType):
        return first

    def merged(values: Sequence[Any]) -> Any:
        return values[0] if not _is_number(values[0]) or len(set(values)) == 1 else np.array(values)

    def cell(cells: Sequence[CellType]) -> CellType:
        same = all(x is cells[0] for x in cells)
        return cells[0] if same else CellType(merged([x.cell_contents for x in cells]))

    def columns(name: str) -> list[tuple[Any, ...]]:
        return list(zip(*(getattr(f, name) or () for f in functions), strict=True))

    made = FunctionType(
        first.__code__, first.__globals__, first.__name__, tuple(map(merged, columns("__defaults__"))),
        tuple(map(cell, columns("__closure__"))),
    )  # fmt: skip
    named = first.__kwdefaults__ or {}
    made.__kwdefaults__ = {x: merged([f.__kwdefaults__[x] for f in functions]) for x in named}  # type: ignore[attr-defined]
    return made
