"""What was given, by names: numbers, small arrays and words of all parts of a scene and of settings.

Bodies, joints and forces that others refer to are told by their names, functions and meshes by what they are.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ...checks import OfBody, name_of
from ...fem.mesh.mesh import Mesh
from .scene import Scene

SMALL = 24  # arrays up to this size are told entry by entry
DEEPEST = 4  # objects in objects
CONTAINERS = (list, tuple, dict)
KINDS = ("bodies", "joints", "forces", "contacts", "limits", "sliders", "ties", "sensors")
SETTINGS = ("gravity", "gravity_ramp", "breakpoints", "settle")


def described(scene: Scene, **settings: Any) -> dict[str, Any]:
    """Numbers, arrays and texts by names, of ``settings`` and all parts of a scene."""
    out: dict[str, Any] = {}
    for name, value in settings.items():
        _describe(name, value, out)
    for name in SETTINGS:
        _describe(name, getattr(scene, name), out)
    for kind in KINDS:
        for name, part in getattr(scene, kind).items():
            _describe(f'{kind} "{name}"', part, out)
    return out


def text_of(value: Any) -> str:
    """One of them as text."""
    if isinstance(value, np.ndarray):
        return np.array2string(value, precision=12)
    return value if isinstance(value, str) else repr(value)


def _describe(name: str, x: Any, out: dict[str, Any], depth: int = 0) -> None:
    """Enter a value, or the parts of it, under their names."""
    if isinstance(x, np.ndarray | list | tuple) and _numbers(x):
        a = np.asarray(x, dtype=float)
        out[name] = a if a.size <= SMALL else f"array {a.shape}"
        return
    # numbers and words
    if x is None or isinstance(x, bool | int | float | str | np.generic):
        plain = x.item() if isinstance(x, np.generic) else x
        out[name] = plain if isinstance(plain, int | float) else repr(plain)
        return
    # what has a name is told by it: bodies and joints are described where they stand
    if depth and not isinstance(x, CONTAINERS) and name_of(x) is not None:
        body = name_of(x.body) if isinstance(x, OfBody) else None
        out[name] = f'{type(x).__name__} "{x.name}"' + (f' of "{body}"' if body else "")
        return

    parts = _parts(x, depth)
    if parts is None:
        out[name] = "a function" if callable(x) else type(x).__name__
        return
    if not isinstance(x, CONTAINERS):
        out[name] = type(x).__name__
    for part, y in parts.items():
        _describe(name + part, y, out, depth + 1)


def _parts(x: Any, depth: int) -> dict[str, Any] | None:
    """The items of containers, and the fields of objects but meshes, by what is added to their names; None: told as a whole."""
    if isinstance(x, list | tuple):
        return {f"[{k}]": y for k, y in enumerate(x)}
    if isinstance(x, dict):
        return {f"[{k!r}]": y for k, y in x.items()}
    if dataclasses.is_dataclass(x) and not isinstance(x, type | Mesh) and depth < DEEPEST:
        return {f".{f.name}": getattr(x, f.name) for f in dataclasses.fields(x)}
    return None


def _numbers(x: Any) -> bool:
    try:
        a = np.asarray(x)
    except ValueError:
        return False
    return a.dtype.kind in "fiub"
