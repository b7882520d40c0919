"""What the sources of the driver declare, read from them: the numbers of enumerations, constants, the fields of structures.

Each of these is written once, in C.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

DRIVER = Path(__file__).with_name("driver")
TABLES = "tables.h"  # whose constants all others use
PYTHON = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_double)

_NUMBERS = {"int": ctypes.c_int, "long": ctypes.c_long, "double": ctypes.c_double}
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_BY_DIMENSION = re.compile(r"#if DIM == 3\n(.*?)#else\n(.*?)#endif", re.DOTALL)
_ENUMERATION = re.compile(r"\benum \{([^}]*)\}")
_REAL = re.compile(r"static const double ([^;{]*);")
_ARRAY = re.compile(r"static const double (\w+)\[\] = \{([^}]*)\};")
_STRUCTURE = re.compile(r"typedef struct\b[^{}]*\{([^{}]*)\} (\w+);")
_FUNCTION = re.compile(r"\(\*(\w+)\)\(")
_DECLARATION = re.compile(r"(?:(?:const|struct|signed|unsigned)\s+)*(\w+)\s*(.*)", re.DOTALL)
_NAME = re.compile(r"\s*(\**)(\w+)(?:\[(.*)\])?")


@cache
def _text(file: str, dim: int) -> str:
    """A source without comments, as it is compiled for the plane or for space."""
    text = _COMMENT.sub("", (DRIVER / file).read_text())
    return _BY_DIMENSION.sub(lambda found: found[1 if dim == 3 else 2], text)


def _value(text: str, known: Mapping[str, int]) -> int:
    """A sum of products of numbers and of known names."""
    terms = (term.split("*") for term in text.replace(" ", "").split("+"))
    return sum(math.prod(known[x] if x in known else int(x) for x in term) for term in terms)


@cache
def _enumerations(file: str, dim: int) -> dict[str, dict[str, int]]:
    """Names and values of the enumerations of a source, by their first names; of each as many as are sums of products."""
    known = {} if file == TABLES else dict(_constants(TABLES, dim))
    found: dict[str, dict[str, int]] = {}
    for body in _ENUMERATION.findall(_text(file, dim)):
        values, last = {}, -1
        for one in body.split(","):
            name, _, given = (part.strip() for part in one.partition("="))
            try:
                last = _value(given, known) if given else last + 1
            except ValueError:
                break
            values[name] = known[name] = last
        found[next(iter(values), body)] = values
    return found


@cache
def _constants(file: str, dim: int) -> dict[str, int]:
    """All of them."""
    return {name: value for values in _enumerations(file, dim).values() for name, value in values.items()}


@cache
def _structures(file: str, dim: int) -> dict[str, str]:
    """What stands in the structures of a source, by their names."""
    return {name: body for body, name in _STRUCTURE.findall(_text(file, dim))}


def enumeration(first: str, file: str = TABLES) -> dict[str, int]:
    """Names and values of the enumeration that begins with a name."""
    return _enumerations(file, 3)[first]


@cache
def _reals(file: str) -> dict[str, str]:
    """The constants of a source that are real numbers, as they are written."""
    pairs = (one.split("=") for group in _REAL.findall(_text(file, 3)) for one in group.split(","))
    return {name.strip(): value.strip() for name, value in pairs}


def constants(file: str, *names: str) -> tuple[float, ...]:
    """Real numbers that an algorithm in Python shares with the one in a source."""
    return tuple(float(_reals(file)[name]) for name in names)


def array_of(file: str, name: str) -> tuple[float, ...]:
    """The same of an array of them."""
    return tuple(map(float, dict(_ARRAY.findall(_text(file, 3)))[name].split(",")))


def fields_of(file: str, name: str, dim: int = 3, **parts: Any) -> list[tuple[str, Any]]:
    """Names and types of the fields of a structure; ``parts``: the types of structures within it, by their names in C."""
    known = {**_constants(TABLES, dim), **_constants(file, dim)}
    fields: list[tuple[str, Any]] = []
    for declaration in _structures(file, dim)[name].split(";"):
        function = _FUNCTION.search(declaration)
        if function is not None:
            fields.append((function[1], PYTHON if function[1] == "python" else ctypes.c_void_p))
            continue
        declared = _DECLARATION.match(declaration.strip())
        if declared is None:  # behind the last one
            continue

        for one in declared[2].split(","):
            pointer, field, size = _NAME.match(one).groups()  # type: ignore[union-attr]
            kind: Any = ctypes.c_void_p if pointer else _NUMBERS.get(declared[1]) or parts[declared[1]]
            fields.append((field, kind * _value(size, known) if size else kind))
    return fields


@cache
def structure_of(file: str, name: str, dim: int = 3, **parts: Any) -> type[ctypes.Structure]:
    """A structure, in the plane or in space; ``parts`` as for :func:`fields_of`."""
    return type(name, (ctypes.Structure,), {"_fields_": fields_of(file, name, dim, **parts)})
