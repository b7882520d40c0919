"""Laws of the user's own: what they return is checked on every call, and once whether they return it again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

import numpy as np

from ...errors import AGREEMENTS, BalanceError, CallbackError, LawError, excused, floats, named
from ...rotations import Array


def checked(name: str, value: Any, size: int, t: float, what: str = "the law") -> Array:
    """A user's result as an array of the right size, or an error that names the force; ``what``: the function, in it.

    In the plane (2) a third number may follow when it is zero, as for :func:`~fmbd_fenicsx.checks.vector`.
    """
    try:
        found = np.atleast_1d(floats(value))
    except (TypeError, ValueError, OverflowError):
        raise CallbackError(f'Force "{name}": {what} returned {value!r} at t = {t:g} s, expected numbers.') from None
    if size == 2 and found.shape == (3,) and found[2] == 0.0:  # a vector of the plane as one of space
        found = found[:2]
    if found.shape != (size,):
        raise CallbackError(f'Force "{name}": {what} returned shape {found.shape} at t = {t:g} s, expected ({size},).')
    if not np.isfinite(found).all():
        kind = CallbackError if np.isnan(found).any() else BalanceError
        raise kind(f'Force "{name}": {what} returned {found} at t = {t:g} s.')
    return found


def checked_number(name: str, value: Any, t: float, what: str = "the law") -> float:
    """:func:`checked` for a single number."""
    found = plain(value)
    return float(checked(name, value, 1, t, what)[0]) if found is None else found


def plain(value: Any) -> float | None:
    """A finite number as it is, or alone in an array; None for anything else."""
    if isinstance(value, np.ndarray) and value.size == 1 and value.ndim < 2 and value.dtype.kind == "f":
        value = value.item()
    return value if isinstance(value, float) and isfinite(value) else None


def few(value: Any, size: int) -> Sequence[float] | None:
    """So many finite numbers, where that is seen at a glance: a float, a tuple, a list or an array of them; None for others."""
    if size == 1 and isinstance(value, float):
        return (value,) if isfinite(value) else None
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple | list):
        if len(value) == 3 and size == 2 and value[2] == 0.0:  # a vector of the plane as one of space
            value = value[:2]
        total = sum(value)
        if len(value) == size and isinstance(total, float) and isfinite(total):
            return value
    return None


class Repeatable:
    """A law whose first call is made twice: steps are tried, repeated and taken back, so equal arguments must give equal forces.

    ``time``: which argument is the time.
    """

    def __init__(self, what: str, name: str, law: Callable[..., Any], *, time: int = -1) -> None:
        self.name, self.time, self.law = name, time, named(what, name, law, time=time, to_end=True)
        self.function = law
        self._asked = False

    def __call__(self, *args: Any) -> Any:
        """What the law returns."""
        value = self.law(*args)
        if not self._asked:
            self._asked = True
            self._compare(value, self.law(*args), float(np.real(args[self.time])))
        return value

    def number(self, *args: Any) -> float:
        """What it returns as a number, checked. What is no plain number, or fails, is asked again with all that belongs to it."""
        if self._asked and not AGREEMENTS:
            try:
                value = self.function(*args)
                found = value if isinstance(value, float) and isfinite(value) else plain(value)
            except Exception:
                found = None  # with a name below
            if found is not None:
                return found
        try:
            return checked_number(self.name, self(*args), float(np.real(args[self.time])))
        except (CallbackError, LawError) as error:
            raise excused(error, *args) from error.__cause__

    def numbers(self, size: int, t: float) -> Sequence[float] | Array:
        """What it returns at a time as so many numbers, as :meth:`number` does."""
        if self._asked and not AGREEMENTS:
            try:
                found = few(self.function(t), size)
            except Exception:
                found = None  # with a name below
            if found is not None:
                return found
        return checked(self.name, self(t), size, t)

    def wrench(self, size: int, of_force: int, t: float, *markers: Any) -> Array | None:
        """The force and torque that it returns at a time as so many finite numbers, so many ``of_force``, where that is seen at a
        glance; None for others, at the first call and where it fails.
        """
        if self._asked and not AGREEMENTS:
            try:
                force, torque = self.function(t, *markers)
                found = np.concatenate((force, torque), axis=None)
                fits = found.shape == (size,) and len(force) == of_force and found.dtype == np.float64
                return found if fits and isfinite(found.dot(found)) else None
            except Exception:
                pass  # asked again, with a name
        return None

    def _compare(self, first: Any, second: Any, t: float) -> None:
        """Refuse two answers that differ; values that are no numbers are for others to refuse."""
        if all(np.array_equal(x, y, equal_nan=True) for x, y in zip(_parts(first), _parts(second), strict=False)):
            return
        raise CallbackError(
            f'Force "{self.name}": the law returned {first!r:.80} and then {second!r:.80} for equal arguments at t = {t:g} s. '
            "Steps are tried more than once, so a law may keep nothing between calls. Take fmbd.controller(..., memory=...)."
        )


def _parts(value: Any) -> list[Array]:
    """The numbers of an answer: one array, or force and torque; none where it has none."""
    try:
        return [floats(x) for x in (value if isinstance(value, tuple) else (value,))]
    except (TypeError, ValueError, OverflowError):
        return []
