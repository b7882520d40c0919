"""Names of a package that are loaded at first use, listed once: in the stub beside it, where type checkers read them."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType


@cache
def listed(stub: Path) -> dict[str, tuple[str, str]]:
    """Module and name behind each public name of a stub: ``from .mechanics.bodies.beams import Beam as Beam``."""
    found = {}
    for node in ast.parse(stub.read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                found[alias.asname or alias.name] = "." * node.level + (node.module or ""), alias.name
    return found


def attach(package: str, file: str) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package, from the stub beside its ``__init__.py``.

    What a script does not use is not imported; ``dir``, ``help`` and completion see all names.
    """
    names = listed(Path(file).with_suffix(".pyi"))

    def load(name: str) -> object:
        if name not in names:
            from difflib import get_close_matches

            close = ", ".join(get_close_matches(name, names, n=3)) or f"dir({package}) lists all names"
            raise AttributeError(f"module {package!r} has no attribute {name!r}; near it: {close}")

        folder, original = names[name]
        place = import_module(folder, package)
        if original not in vars(place):  # a module of that folder
            import_module(f"{folder.rstrip('.')}.{original}", package)

        found = getattr(place, original)
        classes = [
            x for x in (found, *(vars(found).values() if isinstance(found, ModuleType) else ())) if is_dataclass(x)
        ]
        if classes:
            from .checks import telling

            for kind in classes:
                telling(kind)
        vars(sys.modules[package])[name] = found
        return found

    return load, lambda: sorted(names), sorted(names)
