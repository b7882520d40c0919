"""Every public function and class is called with values that mean nothing: it works, or ends with an error of the package."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import FmbdError

NAMESPACES = ("forces", "loads", "sensors", "contacts", "schemes", "forms", "solvers", "multipliers", "materials")
JUNK = (None, "junk", -1, 0.5, float("nan"), float("inf"), True, (), (1.0,), [1, "a"], {"a": 1}, object(), int)
JUNK = (*JUNK, np.full((2, 3), np.nan))
APART = {"Ends", "number", "require"}  # an enumeration, and checks that stand beside


def public() -> dict[str, Callable[..., Any]]:
    """Public functions and classes by name."""
    out = {}
    for place in (fmbd, *(getattr(fmbd, name) for name in NAMESPACES)):
        for name in dir(place):
            found = getattr(place, name)
            ours = getattr(found, "__module__", "").startswith("fmbd_fenicsx")
            error = isinstance(found, type) and issubclass(found, BaseException)
            if callable(found) and ours and not error and not name.startswith("_") and name not in APART:
                out[name] = found
    return out


def arguments(function: Callable[..., Any], junk: Any) -> tuple[list[Any], dict[str, Any]]:
    """One value for every argument that has to be given."""
    positional, named = [], {}
    for p in inspect.signature(function).parameters.values():
        if p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) or p.default is not p.empty:
            continue
        if p.kind is p.KEYWORD_ONLY:
            named[p.name] = junk
        else:
            positional.append(junk)
    return positional, named


@pytest.mark.parametrize("name", sorted(public()))
def test_values_that_mean_nothing(name: str) -> None:
    function = public()[name]
    for junk in JUNK:
        positional, named = arguments(function, junk)
        try:
            function(*positional, **named)
        except FmbdError:
            pass


@pytest.mark.parametrize("name", sorted(public()))
def test_optional_values_that_mean_nothing(name: str) -> None:
    """One optional argument at a time, beside a first name that is right."""
    function = public()[name]
    for p in inspect.signature(function).parameters.values():
        if p.default is p.empty or p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD):
            continue
        for junk in JUNK:
            positional, named = arguments(function, "right")
            try:
                function(*positional, **named, **{p.name: junk})
            except FmbdError:
                pass
