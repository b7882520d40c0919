"""Compiled kernels of the kinds: one library for the package's own in the plane and in space, one for each kind of a user's own.

Each is built by the system's compiler at its first use and kept (:mod:`fmbd_fenicsx.kernel_cache`). Without a compiler the same
kinds are evaluated by NumPy, see :mod:`.evaluation`.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from ... import kernel_cache
from .derivation import Kind, c_source, kinds

# straight lines of sums and products: what costs the compiler more finds nothing to gain in them
FLAGS = ("-O1", "-march=native", "-fno-math-errno", "-ffp-contract=off", "-shared", "-fPIC", "-std=gnu11")


@cache
def package_kernels(dim: int) -> kernel_cache.Library:
    """Kernels of the package's own kinds, as they are built."""
    files = sorted(Path(__file__).parent.glob("*.py"))
    text = b"".join(path.read_bytes() for path in files) + processor().encode()
    unit = kernel_cache.SourceUnit(f"kernels_{dim}d", lambda: c_source(kinds(dim)), FLAGS, text)
    return kernel_cache.Library(unit.name, (unit,))


@cache
def _package_library(dim: int) -> Any:
    """Kernels of the package's own kinds; None where they cannot be had."""
    return kernel_cache.load_library(package_kernels(dim))


@cache
def _own_library(kind: Kind) -> Any:
    """Kernels of one kind of a user's own; None where they cannot be had."""
    text = c_source({kind.name: kind}) + f"\n/* {processor()} */\n"
    return kernel_cache.load(f"kernels_own_{kind.dim}d", text, flags=FLAGS)


@cache
def kernel(kind: Kind, which: str) -> Any:
    """The compiled function ``which`` of a kind, see :data:`.derivation.SIGNATURE`; None where NumPy has to do."""
    own = kinds(kind.dim).get(kind.name) is not kind
    library = _own_library(kind) if own else _package_library(kind.dim)
    if library is None:
        return None
    function = getattr(library, f"{kind.name}_{which}")
    function.argtypes, function.restype = [ctypes.c_long, *[ctypes.c_void_p] * 5], None
    return function


def kernel_address(kind: Kind, which: str) -> int:
    """Where that function stands, for other compiled code."""
    if kind.asked:
        return kind.address(which)
    return int(ctypes.cast(kernel(kind, which), ctypes.c_void_p).value or 0)


@cache
def processor() -> str:
    """What the compiler may make use of: a cache shared by several machines holds a library for each sort."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        import platform

        return platform.processor()
    return next((line for line in text.splitlines() if line.startswith("flags")), "")
