"""Errors of the package.

Each message says what happened, where (body, joint, time), what was found and what to do about it.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

__all__ = [
    "BalanceError",
    "CallError",
    "CallbackError",
    "CheckpointError",
    "ConstraintError",
    "ConvergenceError",
    "FmbdError",
    "InputError",
    "LawError",
    "LinearSolveError",
    "MeshError",
    "PartsError",
    "StabilityError",
    "Stopped",
]


def __dir__() -> list[str]:
    """What is public here."""
    return __all__


class FmbdError(Exception):
    """Any error that this package raises on purpose."""

    exit_code = 70


class InputError(FmbdError, ValueError):
    """A value that a user passed cannot be right."""

    exit_code = 2


class MeshError(InputError):
    """A mesh file, a physical group or a cell is not usable."""


class ConstraintError(FmbdError):
    """Constraints contradict each other, are redundant, or cannot be assembled."""

    exit_code = 71


class LinearSolveError(FmbdError):
    """A linear solve failed its residual test; ``motion``: of the core, where it is one that nothing determines; ``halted``: see
    :class:`ConvergenceError`.
    """

    exit_code = 71
    motion: Any = None
    halted: tuple[float, float] | None = None


class ConvergenceError(FmbdError):
    """Newton's iteration or the step control gave up; ``halted``: when a march did, and the mean of its steps up to then, s."""

    exit_code = 71
    halted: tuple[float, float] | None = None


class StabilityError(ConvergenceError):
    """A step longer than an explicit scheme can take; parts of it are no cure, the next one would be as long."""


class PartsError(StabilityError):
    """Steps of a run had to be made in more parts than it may take: smaller ones cost less."""


class CallError(InputError, TypeError):
    """A function or class was called with arguments that it does not take, or without some that it needs."""


class CallbackError(InputError):
    """A function given by the user returned something unusable."""


class BalanceError(CallbackError):
    """Forces are beyond the range of numbers: of a load, or of a motion that has run away."""


class LawError(InputError):
    """A function given by the user raised an exception, its ``__cause__``; no scheme tries another step then."""


class CheckpointError(FmbdError):
    """A checkpoint cannot be written, is damaged, or belongs to another run."""

    exit_code = 74


class Stopped(KeyboardInterrupt):
    """A request ended a run; ``run`` holds what was computed until then. Uncaught: report and ``exit_code``.

    130 after Ctrl-C in a serial run; 75 after a signal or a file STOP in a run with checkpoints: it can be taken up again.
    """

    def __init__(self, run: Any, exit_code: int = 130) -> None:
        super().__init__(f"stopped on request at t = {run.state.t:g} s")
        self.run, self.exit_code = run, exit_code


def near(name: str, known: Iterable[str]) -> str:
    """A sentence with the known names, the closest first: ``Did you mean "pin"? Known: "pin", "tip".``

    A name that is known belongs to another object then, say one of a second scene.
    """
    known = list(known)
    if name in known:
        return f'The "{name}" that is there is another object: pass that one.'
    listed = ", ".join(f'"{k}"' for k in known) or "none"
    return f"{nearest(name, known)}Known: {listed}."


def nearest(name: str, known: Sequence[str]) -> str:
    """A question for the known name that is closest to one, ``Did you mean "pin"? ``; nothing where none is close."""
    same = [k for k in known if k.casefold() == name.casefold()]
    close = same or difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    return f'Did you mean "{close[0]}"? ' if close else ""


class Told(dict[str, Any]):
    """What a run tells, by names; who asks for a name that is not there is told those that are. ``what``: in messages."""

    def __init__(self, what: str, values: Mapping[str, Any]) -> None:
        try:
            super().__init__(values)
        except (TypeError, ValueError) as error:
            raise InputError(f"{what}: {values!r} holds no values by names.") from error
        self.what = what

    def __missing__(self, name: Any) -> Any:
        raise InputError(f'{self.what}: there is no "{name}". {near(str(name), self)}')


AGREEMENTS: list[Callable[[str, Callable[[], Any]], Any]] = []
"""How the ranks of the run under way agree on what a user's function gives, :mod:`fmbd_fenicsx.agreement`; empty on one rank."""


ROUNDINGS = 2e-10  # of a time: what a sum of a million steps may be off


def named(
    what: str, name: str, function: Callable[..., Any], *, time: int | None = -1, to_end: bool = False
) -> Callable[..., Any]:
    """A user's function whose exceptions become a :class:`LawError`: 'What "name" failed at t = 0.1 s: KeyError: ...'.

    Numbers that become too large, as in ``math.exp`` of where a trial step has led, are forces that are not finite: a
    :class:`BalanceError`.

    Args:
        what: whose function it is, for example "The law of spring".
        time: which argument is the time (s; of complex steps the real part is shown), None for none.
        to_end: whether a function that fails is asked some roundings earlier. Times are sums of steps, and the last one may lie
            so far behind a table that is as long as the run. Not for functions that are differenced.
    """

    def call(*args: Any, alone: bool = False) -> Any:  # at every iterate, some of them: no more calls than are needed
        if AGREEMENTS and not alone:
            return AGREEMENTS[-1](f'{what} "{name}"', lambda: call(*args, alone=True))

        try:
            value = function(*args)
            none = to_end and (value != value if isinstance(value, float) else _no_number(value))
            return _at_the_end(function, args, value, time) if none else value
        except FmbdError:
            raise
        except Exception as error:
            found = _at_the_end(function, args, error, time) if to_end else error
            if found is not error:
                return found
            when = "" if time is None else f" at t = {_times(args[time])} s"
            kind = BalanceError if isinstance(error, OverflowError) else LawError
            raise kind(f'{what} "{name}" failed{when}: {type(error).__name__}: {error}') from error

    return call


def excused(error: CallbackError | LawError, *numbers: Any) -> FmbdError:
    """An error of a user's function as it is, or the :class:`BalanceError` of a motion that has run away, where the ``numbers``
    that it was asked with are none: whatever it answers, another step may do.
    """
    if all(np.isfinite(x).all() for x in numbers):
        return error
    return BalanceError(f"An iteration led to a motion that is not finite. {error}")


def _no_number(value: Any) -> bool:
    """Whether a float is none, or some of an array of them are none; everything else is for others to look at."""
    if isinstance(value, float):
        return value != value
    if not (isinstance(value, np.ndarray) and value.dtype.kind == "f"):
        return False
    flat = value.ravel()
    squares = flat.dot(flat)
    return bool(squares != squares)


def _at_the_end(function: Callable[..., Any], args: tuple[Any, ...], found: Any, time: int | None) -> Any:
    """What a function that failed gives a few roundings earlier, or what was ``found``."""
    if time is None or not isinstance(args[time], float) or not args[time] > 0:
        return found
    earlier = list(args)
    earlier[time] = args[time] * (1.0 - ROUNDINGS)
    try:
        value = function(*earlier)
    except Exception:
        return found
    return found if _no_number(value) else value


def _times(t: Any) -> str:
    """A time, or the first and the last of an array of them."""
    found = sorted(x.real for x in getattr(t, "flat", (t,)))
    return f"{found[0]:g}" if found[0] == found[-1] else f"{found[0]:g} to {found[-1]:g}"


def values_of(
    what: str, function: Callable[..., Any], places: Iterable[tuple[float, ...]], size: int, where: str
) -> Any:
    """What a user's function gives at some places: finite numbers (n, size), or one error with the first place without.

    Args:
        what: whose function it is, for example 'Rod "arm": normal'.
        places: its arguments at each.
        where: how messages call a place, with a field for each argument: "s = {:g} m".
    """
    asked = [tuple(place) for place in places]
    if AGREEMENTS:
        return AGREEMENTS[-1](what, lambda: _values_of(what, function, asked, size, where))
    return _values_of(what, function, asked, size, where)


def _values_of(what: str, function: Callable[..., Any], places: list[tuple[float, ...]], size: int, where: str) -> Any:
    """The same on one rank."""
    found = []
    for place in places:
        try:
            found.append(function(*place))
        except FmbdError:
            raise
        except Exception as error:
            raise LawError(f"{what} failed at {where.format(*place)}: {type(error).__name__}: {error}") from error

    values = _finite_numbers(found, (len(places), size))
    if values is None:
        bad = (k for k, value in enumerate(found) if _finite_numbers([value], (1, size)) is None)
        k = next(bad, 0)
        numbers = "a finite number" if size == 1 else f"{size} finite numbers"
        raise CallbackError(f"{what} returned {found[k]!r:.80} at {where.format(*places[k])}, expected {numbers}.")
    return values


def floats(value: Any) -> Any:
    """An array of what a user's function returned; TypeError for texts, for complex numbers, which NumPy would cut, and for None,
    which it would take for nan.
    """
    found = np.asarray(value)
    nothing = found.dtype.kind == "O" and None in found.ravel().tolist()
    if nothing or found.dtype.kind in "cSU":
        raise TypeError("no real numbers")
    return found.astype(float)


def _finite_numbers(found: list[Any], shape: tuple[int, ...]) -> Any:
    """An array of a shape, where single numbers may stand for rows of one; None where they are no such numbers."""
    try:
        values = floats(found)
    except (TypeError, ValueError, OverflowError):
        return None
    if shape[1] == 1 and values.shape == shape[:1]:
        values = values[:, None]
    return values if values.shape == shape and np.isfinite(values).all() else None


def require(condition: bool, message: str) -> None:
    """Raise :class:`InputError` with the message unless the condition holds."""
    if not condition:
        raise InputError(message)
