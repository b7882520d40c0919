"""The driver as a shared library, built at first use and kept (:mod:`fmbd_fenicsx.kernel_cache`).

Without a C compiler there is none, which is said once; everything then runs in NumPy.
"""

from __future__ import annotations

import ctypes
import re
from functools import cache
from pathlib import Path
from typing import Any

from ... import kernel_cache
from ...mechanics.kinds.library import FLAGS, processor
from ...mechanics.rods import strains

DRIVER = Path(__file__).with_name("driver")


@cache
def driver_library(dim: int) -> Any:
    """The driver for the plane or for space; None where it cannot be had."""
    flags = (*FLAGS, f"-DDIM={dim}")
    definitions = Path(strains.__file__).parents[1] / "kinds"
    files = [*sorted(DRIVER.iterdir()), *sorted(definitions.glob("*.py")), Path(strains.__file__)]
    text = b"".join(path.read_bytes() for path in files if path.suffix in (".c", ".h", ".py"))
    library = kernel_cache.load(
        f"driver_{dim}d", lambda: driver_source(dim), flags=flags, made_from=text + processor().encode()
    )
    return None if library is None else _typed(library)


def driver_source(dim: int) -> str:
    """The driver, and what rods generate for it, as one translation unit."""
    text = (DRIVER / "driver.c").read_text()

    def included(line: re.Match[str]) -> str:
        name = line.group(1)
        if name != "strains.c":
            return (DRIVER / name).read_text()
        return strains.c_source() if dim == 3 else ""

    return re.sub(r'#include "(.*)"', included, text)


def _typed(library: Any) -> Any:
    """The library with the types of its functions."""
    p, r, i = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
    library.march.argtypes, library.march.restype = [p, p, ctypes.c_long, p, p, p], ctypes.c_long
    library.moreau_march.argtypes = [p, p, p, ctypes.c_long, p, p]
    library.moreau_march.restype = ctypes.c_long
    library.driver_evaluate.argtypes = [p] * 5 + [r]
    library.driver_prepare.argtypes = [p, p, r, r, p, i, r]
    library.driver_increment.argtypes = [p, r, p, p, r]
    library.driver_balances.argtypes = [p, ctypes.c_long] + [p] * 6
    library.driver_constraints.argtypes = [p, ctypes.c_long] + [p] * 7
    library.driver_rows.argtypes = [p, ctypes.c_long] + [p] * 4
    library.driver_energies.argtypes = [p, r] + [p] * 4
    library.driver_solve.argtypes = [p] * 6
    return library
