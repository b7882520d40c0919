"""What annotations allow: the types behind them, and which of these say something that can be checked."""

from __future__ import annotations

import sys
import types
import typing
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np

UNIONS = (typing.Union, types.UnionType)


def home_of(kind: type, field: str) -> str:
    """The module in which a dataclass, or the one that it is made from, declares a field."""
    return next((k.__module__ for k in kind.__mro__ if field in vars(k).get("__annotations__", {})), kind.__module__)


def hint_of(module: str, annotation: Any) -> Any:
    """The type behind an annotation, which is the type itself or, by default in this package, its text."""
    return _named_type(module, annotation) if isinstance(annotation, str) else annotation


@cache
def _named_type(module: str, annotation: str) -> Any:
    """The type behind the text of an annotation; Any where its names are known to type checkers only."""
    try:
        return eval(annotation, vars(sys.modules[module]))  # text of the source of a class or function
    except (KeyError, NameError, AttributeError, TypeError):
        return Any


@cache
def options_of(hint: Any) -> tuple[tuple[Any, ...], bool, bool]:
    """The types that an annotation allows, whether anything is allowed, and whether all of them are kinds of objects."""
    options = typing.get_args(hint) if typing.get_origin(hint) in UNIONS else (hint,)
    some = tuple(option for option in options if option is not type(None))
    objects = all(isinstance(x, type) and x not in (float, int, str, bool, np.ndarray) for x in some)
    return options, any(_unknown(option) for option in some), objects


@cache
def classes_of(hint: Any) -> tuple[type, ...]:
    """The classes among the types that an annotation allows of whose objects nothing more is checked."""
    origins = [typing.get_origin(option) or option for option in options_of(hint)[0]]
    looked_into = (float, int, str, np.ndarray, Callable, Sequence, tuple, list)
    return tuple(x for x in origins if isinstance(x, type) and x not in looked_into)


def _unknown(option: Any) -> bool:
    """Whether an annotation says nothing that can be checked."""
    return option is Any or option is object or isinstance(option, TypeVar)


def is_function(option: Any) -> bool:
    """Whether a type is that of functions."""
    origin = typing.get_origin(option) or option
    return origin is Callable or (origin is typing.Annotated and is_function(typing.get_args(option)[0]))
