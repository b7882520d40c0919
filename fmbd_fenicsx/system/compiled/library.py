"""The driver as a shared library, built at first use and kept (:mod:`fmbd_fenicsx.kernel_cache`).

It is made of units, files that are compiled by themselves: the core and its schemes, which stand above the folders of the driver,
and what a scene or its scheme may lack, which is compiled and linked only where it is there. Without a C compiler there is none,
which is said once; everything then runs in NumPy.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ... import kernel_cache
from ...mechanics.kinds.library import package_kernels, processor
from ...mechanics.rods import strains
from .declarations import DRIVER
from .tables.bodies.told import is_told
from .tables.items.items import other_loads

if TYPE_CHECKING:
    from ..system import System

FLAGS = (
    "-march=native",
    "-fno-math-errno",
    "-ffp-contract=off",
    "-fcx-limited-range",
    "-fPIC",
    "-fvisibility=hidden",
    "-std=gnu11",
)
CORE = ("schemes", "driver")  # units of every scene, to be compiled side by side, the longest first
RODS, CONTACT, IMPLICIT = "rods/rods", "impacts/moreau", "implicit_schemes"
# of units whose loops are short or jump: vectors gain nothing there, and double the time to compile
SPARSE = {IMPLICIT: ("-O2",), CONTACT: ("-O3", "-fno-tree-vectorize")}
EXPORTED = re.compile(r"^EXPORT (\w+) (\w+)\((.*?)\)", re.MULTILINE | re.DOTALL)
TYPES = {"int": ctypes.c_int, "long": ctypes.c_long, "double": ctypes.c_double, "void": None}


def units_of(system: System) -> tuple[str, ...]:
    """The units, beside the core, that a system needs."""
    wanted = {
        "bodies/reduced": bool(system.parts),
        "bodies/told": any(map(is_told, system.parts)),
        "fields/fields": bool(system.fields),
        RODS: bool(system.elements),
        "forces/mounts": any(loads.mounts() is not None for loads in system.forces),
        "forces/whole": bool(other_loads(system)),
    }
    return tuple(name for name, needed in wanted.items() if needed)


@cache
def driver_library(dim: int, units: tuple[str, ...] = ()) -> Any:
    """The driver for the plane or for space, of the core and some units; None where it cannot be had."""
    names = (*CORE, *units)
    library = kernel_cache.Library(f"driver_{dim}d", tuple(_unit(dim, name) for name in names))
    loaded = kernel_cache.load_library(library, beside=(package_kernels(dim),))
    return None if loaded is None else _typed(loaded, dim, names)


@cache
def _unit(dim: int, name: str) -> kernel_cache.SourceUnit:
    """One unit as it is compiled; it follows from all sources of the driver, and from what generates those of rods."""
    definitions = Path(strains.__file__).parents[1] / "kinds"
    files = [*sorted(definitions.glob("*.py")), Path(strains.__file__)] if name == RODS else []
    text = b"".join(path.read_bytes() for path in files) + _source(dim, name, generated=False).encode()
    flags = (*SPARSE.get(name, ("-O3",)), *FLAGS, f"-DDIM={dim}")
    return kernel_cache.SourceUnit(
        f"{Path(name).name}_{dim}d", lambda: _source(dim, name), flags, text + processor().encode(), shared=True
    )


@cache
def _source(dim: int, name: str, *, generated: bool = True) -> str:
    """A unit as one text, with what rods generate for it; its name, and those that it includes, are paths within the driver."""

    def included(line: re.Match[str]) -> str:
        file = line.group(1)
        if file == "strains.c":
            return strains.c_source() if generated else ""
        return whole(file)

    def whole(file: str) -> str:
        return re.sub(r'#include "(.*)"', included, (DRIVER / file).read_text())

    return whole(f"{name}.c")


def _typed(library: Any, dim: int, names: tuple[str, ...]) -> Any:
    """The library with the types of its functions, as the sources declare them: ctypes would cut an address that has none."""
    for name in names:
        for result, function, arguments in EXPORTED.findall(_source(dim, name, generated=False)):
            declared = [x.replace("const ", "").strip() for x in arguments.split(",")]
            made = getattr(library, function)
            made.restype = TYPES[result]
            made.argtypes = [ctypes.c_void_p if "*" in x else TYPES[x.split()[0]] for x in declared]
    return library
