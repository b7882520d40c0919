"""The driver as a shared library, built at first use and kept (:mod:`fmbd_fenicsx.kernel_cache`).

It is made of units: the core, and what a scene may lack, which is compiled and linked only for systems that have it. Without a C
compiler there is none, which is said once; everything then runs in NumPy.
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
from .items import other_loads

if TYPE_CHECKING:
    from ..system import System

DRIVER = Path(__file__).with_name("driver")
FLAGS = (
    *("-O3", "-march=native", "-fno-math-errno", "-ffp-contract=off", "-shared", "-fPIC", "-fvisibility=hidden"),
    "-std=gnu11",
)
CORE = "driver"
CONTACT = "moreau"


def units_of(system: System) -> tuple[str, ...]:
    """The units, beside the core, that a system needs."""
    wanted = {
        "reduced": bool(system.parts),
        "fields": bool(system.fields),
        "rods": bool(system.elements),
        "mounts": any(loads.mounts() is not None for loads in system.forces),
        "whole": bool(other_loads(system)),
    }
    return tuple(name for name, needed in wanted.items() if needed)


@cache
def driver_library(dim: int, units: tuple[str, ...] = ()) -> Any:
    """The driver for the plane or for space, of the core and some units; None where it cannot be had."""
    names = (CORE, *units)
    library = kernel_cache.Library(f"driver_{dim}d", tuple(_unit(dim, name) for name in names))
    loaded = kernel_cache.load_library(library, beside=(package_kernels(dim),))
    return None if loaded is None else _typed(loaded, contact=CONTACT in units)


@cache
def _unit(dim: int, name: str) -> kernel_cache.Unit:
    """One unit as it is compiled; it follows from all sources of the driver, and from what generates those of rods."""
    definitions = Path(strains.__file__).parents[1] / "kinds"
    files = [*sorted(definitions.glob("*.py")), Path(strains.__file__)] if name == "rods" else []
    text = b"".join(path.read_bytes() for path in files) + _source(dim, name, generated=False).encode()
    flags = (*FLAGS, f"-DDIM={dim}")
    return kernel_cache.Unit(
        f"{name}_{dim}d", lambda: _source(dim, name), flags, text + processor().encode(), shared=True
    )


def _source(dim: int, name: str, *, generated: bool = True) -> str:
    """A unit as one text, with what rods generate for it."""

    def included(line: re.Match[str]) -> str:
        file = line.group(1)
        if file == "strains.c":
            return strains.c_source() if generated else ""
        return whole(file)

    def whole(file: str) -> str:
        return re.sub(r'#include "(.*)"', included, (DRIVER / file).read_text())

    return whole(f"{name}.c")


def _typed(library: Any, *, contact: bool) -> Any:
    """The library with the types of its functions."""
    p, r, i = ctypes.c_void_p, ctypes.c_double, ctypes.c_int

    # runs of steps
    library.march.argtypes, library.march.restype = [p, p, ctypes.c_long, p, p, p], ctypes.c_long
    if contact:
        library.moreau_march.argtypes = [p, p, p, ctypes.c_long, p, p]
        library.moreau_march.restype = ctypes.c_long

    # states that Python asks for
    library.driver_evaluate.argtypes = [p] * 5 + [r]
    library.driver_prepare.argtypes = [p, p, r, r, p, i, r]
    library.driver_increment.argtypes = [p, r, p, p, r]
    library.driver_balances.argtypes = [p, ctypes.c_long] + [p] * 6
    library.driver_constraints.argtypes = [p, ctypes.c_long] + [p] * 7
    library.driver_rows.argtypes = [p, ctypes.c_long] + [p] * 4
    library.driver_compose.argtypes, library.driver_compose.restype = [p, ctypes.c_long] + [p] * 3, None
    library.driver_energies.argtypes = [p, r] + [p] * 4
    library.driver_solve.argtypes = [p] * 6
    library.driver_accelerate.argtypes = [p, i, r, r] + [p] * 6
    library.driver_half_stage.argtypes = [p, r, r] + [p] * 9
    library.driver_close.argtypes = [p, r, r] + [p] * 3
    library.driver_stages.argtypes = [p, i, r, r, r] + [p] * 10

    return library
