"""What a user may give: a few checks with one sentence each, and the same checks made from type annotations.

Each check returns the value in the form in which it is used (a float, an array), or raises an :class:`InputError` that says what,
what was found, and what would do. ``what`` begins the sentence: ``'Body "arm": mass'``.

:func:`check_fields` and :func:`typed` apply them by the annotations of a dataclass or function, so that a word for a number, a
class in place of an object, NaN or a vector of the wrong kind is refused where it is given. What depends on more than one value,
or on physics, stays with whoever knows it.
"""

from __future__ import annotations

import inspect
import math
import sys
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cache, wraps
from numbers import Integral, Real
from types import FunctionType
from typing import Any, ParamSpec, TypeVar

import numpy as np

from .errors import CallError, InputError, near, nearest
from .hints import classes_of, hint_of, home_of, is_function, options_of

P = ParamSpec("P")
T = TypeVar("T")

SEVERAL = (Sequence[float], tuple[float, ...])  # annotations of vectors
LARGEST = sys.float_info.max  # whole numbers may be larger


@typing.runtime_checkable
class Named(typing.Protocol):
    """What messages call by a name: parts of a scene."""

    name: Any


@typing.runtime_checkable
class OfBody(typing.Protocol):
    """What belongs to a body: surfaces, nodes, stations."""

    body: Any


def name_of(value: Any) -> str | None:
    """The name of an object that has one; None of others, and of classes."""
    named = isinstance(value, Named) and not isinstance(value, type) and isinstance(value.name, str)
    return value.name if named else None


def shown(value: Any) -> str:
    """A value as a message shows it: short, and a class as a class."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if is_dataclass(value):  # their names may be properties
        name = getattr(value, "name", None)
    else:
        name = getattr(value, "__dict__", {}).get("name")
    if isinstance(name, str):
        kind: Any = type(value)
        return f'{vars(kind).get("shown_as", kind.__name__)} "{name}"'
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."


def refuse(what: str, wanted: str, found: Any) -> typing.NoReturn:
    """The sentence of all checks: ``Body "arm": mass must be a positive number of kg, found -1.0.``"""
    raise InputError(f"{what} {shown(found)} must be {wanted}.")


# ------------------------------------------------------------------------------------------------------ the vocabulary


def number(what: str, value: Any, *, above: float = -np.inf, least: float = -np.inf, unit: str = "") -> float:
    """A finite number, larger than ``above`` and not smaller than ``least``; strings, bools and lists are none."""
    if type(value) is float and above < value <= LARGEST and value >= least:  # as most are
        return value
    single: Any = value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value
    wanted = "a positive number" if above == 0 else "a number that is not negative" if least == 0 else "a finite number"
    wanted += f" above {above:g}" if above > 0 or -np.inf < above < 0 else ""
    wanted += f" of at least {least:g}" if least > 0 or -np.inf < least < 0 else ""

    if isinstance(single, bool | np.bool_) or not isinstance(single, Real):
        refuse(what, wanted + (f" ({unit})" if unit else ""), value)
    try:
        found = float(single)
    except OverflowError:
        found = np.inf
    if not np.isfinite(found) or found <= above or found < least:
        raise InputError(f"{what} {shown(single)}{' ' + unit if unit else ''} must be {wanted}.")
    return found


def whole(what: str, value: Any, *, least: int | None = 0) -> int:
    """A whole number of at least ``least``, None for any."""
    known = isinstance(value, Integral) and not isinstance(value, bool | np.bool_)
    if not known or abs(int(value)) > sys.maxsize or (least is not None and int(value) < least):
        refuse(what, "a whole number" if least is None else f"a whole number, at least {least}", value)
    return int(value)


def array(what: str, value: Any, *, shape: str = "finite numbers") -> np.ndarray:
    """Finite numbers in an array of any shape; ``shape``: what is wanted, in words."""
    plain = value if type(value) in (tuple, list) else (value,)
    if plain and _numbers(plain):
        return np.array(value, dtype=float)  # as most are given
    try:
        found = np.asarray(value)
        usable = found.dtype.kind in "iuf" and _finite(found)
    except (TypeError, ValueError, OverflowError):
        usable = False
    if not usable:
        refuse(what, shape, value)
    return np.array(found, dtype=float)


def _numbers(values: Sequence[Any]) -> bool:
    """Whether all of some values are finite numbers as most are given."""
    for x in values:
        kind = type(x)
        if not ((kind is float or kind is int or kind is np.float64) and -LARGEST <= x <= LARGEST):
            return False
    return True


def _finite(x: np.ndarray) -> bool:
    """Whether all numbers are finite."""
    if x.size < 10:  # NumPy's own is slower for a few
        values: Any = x.ravel().tolist()
        return all(map(math.isfinite, values))
    return bool(np.isfinite(x).all())


def vector(what: str, value: Any, *, size: int | None = None, zero: bool = True, other: str = "") -> np.ndarray:
    """Finite numbers, (size,). In the plane (2) a third number may follow when it is zero; ``zero``: all may be zero; ``other``:
    what else may stand there.
    """
    many = "a finite number" if size == 1 else f"{'a vector of' if size is None else size} finite numbers"
    wanted = many + ("" if zero else ", not all zero") + other
    found = array(what, value, shape=wanted)

    if size == 2 and found.shape == (3,):
        if found[2] != 0:
            refuse(what, f"{wanted}: the bodies are plane, and z cannot be followed", value)
        found = found[:2]
    if found.ndim != 1 or found.size == 0 or (size is not None and len(found) != size):
        refuse(what, wanted, value)
    if not zero and not found.any():
        refuse(what, wanted, value)
    return found


def word(what: str, value: Any) -> str:
    """A string that is not empty."""
    if not isinstance(value, str) or not value.strip():
        refuse(what, "a string that is not empty", value)
    return value


def words(what: str, value: Any) -> tuple[str, ...]:
    """Several strings; one alone is none: its letters are not meant."""
    if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(x, str) for x in value):
        refuse(what, 'several strings, as ("a", "b")', value)
    return tuple(value)


def function(what: str, value: Any, arguments: Sequence[Any] | None = None, *, named: str = "") -> Callable[..., Any]:
    """Something that can be called, with so many arguments; ``named``: what they are."""
    of = "" if arguments is None else f" of {len(arguments)} argument{'s' * (len(arguments) != 1)}"
    wanted = f"a function{of}{f' ({named})' if named else ''}"
    if not callable(value):
        refuse(what, wanted, value)
    if arguments is None or isinstance(value, type):
        return typing.cast(Callable[..., Any], value)

    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):  # of compiled code that does not tell
        return typing.cast(Callable[..., Any], value)
    try:
        signature.bind(*arguments)
    except TypeError:
        found = ", ".join(signature.parameters)
        raise InputError(f"{what} must be {wanted}, found one of ({found}).") from None
    return typing.cast(Callable[..., Any], value)


def instance(what: str, value: Any, kinds: type | tuple[type, ...]) -> Any:
    """An object of one of the kinds; a class in the place of its object is named as such."""
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    if isinstance(value, kinds):
        return value
    made = [vars(kind).get("made_by") for kind in kinds]  # how users make one, where that is not by the class
    words = [
        by or f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
        for by, kind in zip(made, kinds, strict=True)
    ]
    wanted = " or ".join(dict.fromkeys(words))  # bools of Python and of NumPy have one name
    if isinstance(value, type) and issubclass(value, kinds):
        raise InputError(f"{what} is the class {value.__name__}; make an object of it: {value.__name__}(...).")
    refuse(what, wanted, value)


# -------------------------------------------------------------------------------------------------- from annotations


def check_fields(data: Any, what: str | None = None) -> None:
    """Check the fields of a dataclass by their annotations; ``what``: whose, in messages; by default ``Kind "name"``."""
    kind: Any = type(data)
    values = {name: getattr(data, name) for name, _, _ in _annotated(kind)}
    label = _label(kind.__name__, values) if what is None else what
    for name, hint, default in _annotated(kind):
        if values[name] is not default and not _usual(values[name], hint):
            _check(f"{label}: {name}", values[name], hint, default=default)


def unchanging(kind: type[T]) -> type[T]:
    """A frozen dataclass whose objects tell who sets a field of one what to do; those with :func:`check_fields` are such."""

    def refuse_change(self: Any, name: str, value: Any) -> None:
        known = [f.name for f in fields(self) if f.init]
        if name not in known:
            raise InputError(f'{shown(self)} has no "{name}" to set. {near(name, known)}')
        raise InputError(f"{shown(self)} stays as it was made, with its {name}: make another one with this {name}.")

    kind.__setattr__ = refuse_change  # type: ignore[method-assign, assignment]
    return kind


@cache
def _annotated(kind: Any) -> tuple[tuple[str, Any, Any], ...]:
    """Name, type and default of each field that users give."""
    if kind.__dataclass_params__.frozen:
        unchanging(kind)
    given = [f for f in fields(kind) if f.init]
    return tuple((f.name, hint_of(home_of(kind, f.name), f.type), f.default) for f in given)


def typed(make: Callable[P, T]) -> Callable[P, T]:
    """A function whose arguments are checked by their annotations before it is called."""
    signature = inspect.signature(make)
    module, title = make.__module__, make.__qualname__.rpartition("<locals>.")[2]
    bound = binder(title, signature)
    hints: dict[str, tuple[Any, Any]] = {}

    @wraps(make)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        values = bound(args, kwargs)
        label = _label(title, values)

        # names of annotations may come from modules that import this one: they are looked up at the first call
        if not hints:
            single = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
            every = {
                n: p for n, p in signature.parameters.items() if p.kind not in single and p.annotation is not p.empty
            }
            hints.update({n: (hint_of(module, p.annotation), p.default) for n, p in every.items()})

        for name, value in values.items():
            if name in hints:
                hint, default = hints[name]
                if value is not default and not _usual(value, hint):
                    _check(f"{label}: {name}", value, hint, default=default)

        return make(*args, **kwargs)

    return checked


def telling(kind: Any) -> None:
    """Let a dataclass refuse arguments that it does not take as functions with :func:`typed` do."""
    own = vars(kind).get("__init__")
    if not isinstance(own, FunctionType) or "__wrapped__" in vars(own):  # told already
        return

    @wraps(own)
    def begin(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            own(self, *args, **kwargs)
        except TypeError:
            fitted(kind.__name__, inspect.signature(kind), args, kwargs)
            raise

    kind.__init__ = begin


def fitted(
    title: str, signature: inspect.Signature, args: Sequence[Any], kwargs: Mapping[str, Any]
) -> Mapping[str, Any]:
    """The arguments of a call by their names; one sentence where it does not fit the signature, with what that takes."""
    try:
        return signature.bind(*args, **kwargs).arguments
    except TypeError as error:  # without the function's name
        unknown = next((name for name in kwargs if name not in signature.parameters), None)
        hint = nearest(unknown, list(signature.parameters)) if unknown else ""
        raise CallError(f"{title}(): {error}. {hint}It takes {_taken(signature)}.") from None


def binder(title: str, signature: inspect.Signature) -> Callable[[tuple[Any, ...], dict[str, Any]], Mapping[str, Any]]:
    """What :func:`fitted` tells of calls of one function. Usual ones are seen at a glance."""
    parameters = signature.parameters.values()
    places = [p.name for p in parameters if p.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD]
    needed = {p.name for p in parameters if p.default is inspect.Parameter.empty}
    known = set(places) | {p.name for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}
    plain = len(known) == len(parameters)

    def bound(args: tuple[Any, ...], kwargs: dict[str, Any]) -> Mapping[str, Any]:
        if plain and len(args) <= len(places):
            values = dict(zip(places, args, strict=False))
            once = values.keys().isdisjoint(kwargs)
            values |= kwargs
            if once and needed <= values.keys() <= known:
                return values
        return fitted(title, signature, args, kwargs)

    return bound


def _taken(signature: inspect.Signature) -> str:
    """The names of the arguments, those apart that must be named in a call."""
    by_name = [p.name for p in signature.parameters.values() if p.kind is inspect.Parameter.KEYWORD_ONLY]
    others = [name for name in signature.parameters if name not in (*by_name, "cls", "self")]
    listed = [", ".join(others)] if others else []
    if by_name:
        listed.append("by name: " + ", ".join(by_name))
    return "; ".join(listed)


def _label(kind: str, values: Mapping[str, Any]) -> str:
    name = values.get("name")
    return f'{kind} "{name}"' if isinstance(name, str) else kind


def _check(what: str, value: Any, hint: Any, *, default: Any) -> None:
    """Check one value; the default itself is always allowed, an infinite number where the default is one."""
    if value is default or _usual(value, hint):
        return
    options, _, objects = options_of(hint)
    if (
        float in options
        and isinstance(default, float)
        and np.isinf(default)
        and isinstance(value, Real)
        and value == default
    ):
        return
    if value is None and type(None) in options:
        return

    options = tuple(option for option in options if option is not type(None))
    known = any(isinstance(option, type) and isinstance(value, option) for option in options)
    if callable(value) and not isinstance(value, type) and not known:  # functions are told how many arguments they lack
        options = tuple(option for option in options if is_function(option)) or options
    if objects:
        instance(what, value, options)
        return
    refusals = []
    for option in options:  # any will do
        try:
            return _one(what, value, option)
        except InputError as error:
            refusals.append(str(error))
    raise InputError(_together(f"{what} {shown(value)} must be ", refusals))


def _together(begin: str, refusals: list[str]) -> str:
    """One sentence of several that begin alike, with all that would do; else the last of them."""
    if not all(text.startswith(begin) for text in refusals):
        return refusals[-1]
    asked = dict.fromkeys(text.removeprefix(begin).removesuffix(".") for text in refusals)
    wanted = [x for x in asked if not any(x in other and x != other for other in asked)]  # no part of another
    return f"{begin}{' or '.join(wanted)}."


def _usual(value: Any, hint: Any) -> bool:
    """Whether a value is seen at a glance to be of one of the types."""
    options, anything, _ = options_of(hint)
    return anything or _plainly(value, options) or isinstance(value, classes_of(hint))


def _plainly(value: Any, options: tuple[Any, ...]) -> bool:
    """Whether a value is seen at a glance to be of one of the types; most are."""
    kind = type(value)
    if kind is float or kind is int:
        return float in options and -LARGEST <= value <= LARGEST
    if kind is tuple or kind is list:
        return bool(value) and _numbers(value) and any(option in SEVERAL for option in options)
    if kind is np.ndarray:
        plain = value.ndim == 1 and value.dtype.kind == "f" and value.size > 0
        return plain and _finite(value) and any(option in SEVERAL for option in options)
    return kind is str and str in options and bool(value.strip())


def _one(what: str, value: Any, option: Any) -> None:
    """Check a value against one type; words beside that of a function name its arguments."""
    origin = typing.get_origin(option) or option
    inner = typing.get_args(option)
    named = ""
    if origin is typing.Annotated:
        option, named = inner[:2]
        origin, inner = typing.get_origin(option) or option, typing.get_args(option)
    simple: dict[Any, Callable[[str, Any], Any]] = {float: number, str: word}

    if origin in simple:
        simple[origin](what, value)
    elif origin is Callable:
        function(what, value, inner[0] if inner and inner[0] is not Ellipsis else None, named=named)
    elif origin is int:
        whole(what, value, least=None)
    elif origin is bool:
        instance(what, value, (bool, np.bool_))
    elif origin is np.ndarray:
        array(what, value)
    elif origin in (Sequence, tuple, list):
        _several(what, value, inner)
    elif isinstance(origin, type):
        instance(what, value, origin)


def _several(what: str, value: Any, inner: tuple[Any, ...]) -> None:
    """Check a sequence by the type of its members."""
    members = {x for x in inner if x is not Ellipsis}
    count = len(inner) if len(inner) > 1 and Ellipsis not in inner else None
    if members == {float}:
        vector(what, value, size=count) if count or np.size(np.asarray(value, dtype=object)) else None
    elif members == {str}:
        words(what, value)
    elif isinstance(value, str) or not isinstance(value, Sequence | np.ndarray) or getattr(value, "ndim", 1) == 0:
        refuse(what, "a pair" if count == 2 else "a list or tuple", value)
    elif count and len(value) != count:
        refuse(what, "a pair" if count == 2 else f"{count} values", value)
    elif len(members) == 1:
        for k, member in enumerate(value):
            _check(f"{what}[{k}]", member, next(iter(members)), default=MISSING)
