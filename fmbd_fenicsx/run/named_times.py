"""Instants that functions of time name: numbers in their text, in what they hold, and tables that they read.

A knock of a thousandth of a run lies between any instants at which loads are looked at. Who writes it says when it comes: as
numbers of the function, t_0 and its width, as values that it has from around it, or as a column of times.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import partial
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from ..rotations import Array
from ..system.scene.scene import Scene

DEPTH, VISITED = 6, 1000  # how far, and how many things, what a function holds is followed
FEW, TABLE = 24, 2000  # numbers whose sums are looked at, and rows of a table, at most
AGAIN, PERIODS = 6, 40  # numbers of which each may be a period, and periods in a run, at most
PLAIN = (int, float, np.number)
HOME = __package__.partition(".")[0]
NOTHING = (str, bytes, bool, type, ModuleType, BuiltinFunctionType, np.ufunc, complex)


def named_times(scene: Scene, begin: float, end: float) -> Array:
    """Instants (s) between two times that forces, drives and loads of a scene name, ascending: their numbers, these plus and less
    one another, the middles between all of these, and columns of times.
    """
    found = Numbers()
    for part in (*scene.forces.values(), *scene.joints.values(), *scene.bodies.values(), *scene.contacts.values()):
        for function in functions_of(part):
            found.take(function, DEPTH)
    found.take(scene.gravity, DEPTH)
    times = np.unique([t for t in found.instants(end - begin) if begin < t < end])
    between = 0.5 * (times[1:] + times[:-1])
    columns = [x[(x > begin) & (x < end)] for x in found.columns]
    return np.unique(np.concatenate((times, between, *columns)))


@dataclass
class Numbers:
    """Numbers and ascending columns of numbers in what functions are made of."""

    single: set[float] = field(default_factory=set)
    columns: list[Array] = field(default_factory=list)
    seen: dict[int, Any] = field(default_factory=dict)  # kept alive, so that their ids stay theirs

    def take(self, x: Any, depth: int) -> None:
        """Those of a thing, and of what it is made of."""
        if x is None or isinstance(x, NOTHING) or id(x) in self.seen or len(self.seen) > VISITED:
            return
        if isinstance(x, PLAIN):
            self.single.add(float(x))
            return
        self.seen[id(x)] = x
        if isinstance(x, np.ndarray) or (isinstance(x, list | tuple) and all(isinstance(y, PLAIN) for y in x)):
            self._take_column(np.asarray(x))
        elif depth:
            for y in _inside(x):
                self.take(y, depth - 1)

    def _take_column(self, x: Array) -> None:
        if x.ndim != 1 or x.dtype.kind not in "iuf" or not 0 < len(x) <= TABLE:
            return
        if len(x) > 2 and (np.diff(x) > 0.0).all():
            self.columns.append(x.astype(float))
        elif len(x) <= FEW:
            self.single.update(map(float, x))

    def instants(self, span: float) -> set[float]:
        """Single numbers that are no longer than a run, their sums and differences, and what comes again with one of few."""
        known = {x for x in self.single if 0.0 < abs(x) < span}
        pairs = known if len(known) <= FEW else ()
        periods = [x for x in known if x * PERIODS >= span] if len(known) <= AGAIN else []
        again = {a + k * b for a in (0.0, *known) for b in periods for k in range(2, int(span / b) + 1)}
        return known | again | {a + sign * b for a in pairs for b in pairs for sign in (1, -1)}


def functions_of(part: Any) -> list[Any]:
    """Functions that a part of a scene holds, and those of its loads and rows."""
    found = []
    for value in vars(part).values():
        if callable(value) and not isinstance(value, type):
            found.append(value)
        elif isinstance(value, list | tuple):
            held = [x for x in value if hasattr(x, "__dataclass_fields__") and not isinstance(x, type)]
            found += [f for x in held for f in functions_of(x)]
    return found


def _inside(x: Any) -> Iterable[Any]:
    """What a thing is made of: constants of a function, values that it has from around it, attributes of other things."""
    match x:
        case FunctionType():
            return x.__code__, x.__defaults__, x.__kwdefaults__, *_around(x)
        case CodeType():
            return x.co_consts
        case MethodType():
            return x.__self__, x.__func__
        case partial():
            return x.func, x.args, x.keywords
        case list() | tuple() | set() | frozenset():
            return x
        case dict():
            return x.values()

    if type(x).__module__.startswith(HOME) and not callable(x):
        return ()  # a body, a scene

    slots = [name for kind in type(x).__mro__ for name in vars(kind).get("__slots__", ())]
    own = vars(x).values() if hasattr(x, "__dict__") else ()
    return *own, *(getattr(x, name, None) for name in slots)


def _around(function: FunctionType) -> list[Any]:
    """What a function takes from around it; attributes that are called like something there are taken for it."""
    try:
        enclosed = [cell.cell_contents for cell in function.__closure__ or ()]
    except ValueError:  # something has no value yet
        return []
    around = function.__globals__
    return [*enclosed, *(around[name] for name in function.__code__.co_names if name in around)]
