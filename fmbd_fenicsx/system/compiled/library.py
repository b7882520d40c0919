"""The driver and its generated kernels as one shared library, built at first use and kept (:mod:`fmbd_fenicsx.kernel_cache`).

Without a C compiler there is none, which is said once; everything then runs in NumPy.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import Any

from ... import kernel_cache
from ...mechanics import kinds as definitions
from ...mechanics.rods import strains

DRIVER = Path(__file__).with_name("driver")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-ffp-contract=off", "-shared", "-fPIC", "-std=gnu11")


@cache
def driver_library(dim: int) -> Any:
    """The driver with the package's own kinds for the plane or for space; None where it cannot be had."""
    flags = (*FLAGS, f"-DDIM={dim}")
    files = [*sorted(DRIVER.iterdir()), *sorted(Path(definitions.__file__).parent.glob("*.py")), Path(strains.__file__)]
    text = b"".join(path.read_bytes() for path in files if path.suffix in (".c", ".h", ".py"))
    library = kernel_cache.load(
        f"driver_{dim}d", lambda: driver_source(dim), flags=flags, made_from=text + _processor().encode()
    )
    return None if library is None else _typed(library)


def driver_source(dim: int) -> str:
    """The driver and the kernels of the package's own kinds as one translation unit."""
    from ...log import log
    from ...mechanics.kinds.derivation import c_source, kinds

    log.info("compiling kernels and driver for %s, once", "space" if dim == 3 else "the plane")
    text = (DRIVER / "driver.c").read_text()

    def included(line: re.Match[str]) -> str:
        name = line.group(1)
        if name != "kernels.c":
            return (DRIVER / name).read_text()
        return c_source(kinds(dim)) + (strains.c_source() if dim == 3 else "")

    return re.sub(r'#include "(.*)"', included, text)


@cache
def _processor() -> str:
    """What the compiler may make use of: a cache shared by several machines holds a library for each sort."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        import platform

        return platform.processor()
    return next((line for line in text.splitlines() if line.startswith("flags")), "")


def _typed(library: Any) -> Any:
    """The library with the types of its functions."""
    p, r, i = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    library.march.argtypes, library.march.restype = [p, p, ctypes.c_long, p, p, p], ctypes.c_long
    library.driver_evaluate.argtypes = [p] * 5 + [r]
    library.driver_prepare.argtypes = [p, p, r, r, p, i, r]
    library.driver_increment.argtypes, library.driver_increment.restype = [p, r, p, p], None
    library.driver_energies.argtypes = [p] * 5
    return library
