"""Compiled steps: a C kernel, built once by the system's compiler and kept (:mod:`fmbd_fenicsx.kernel_cache`).

The kernel is an optional copy of :mod:`.generalized_alpha`, equation by equation, for rigid, reduced and floating bodies with
the elementary constraints; what it cannot do (forces, surface ties, constraints close to dependent, Newton's failures with
their messages) is left to the NumPy path. Results agree to roundoff. Without a C compiler everything runs in NumPy.
:mod:`.kernel` gives it the arrays of a system.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

from ... import kernel_cache

SOURCE = Path(__file__).with_name("step.c")


@cache
def library(dim: int = 2) -> Any:
    """The kernel for the plane or for space, or None: built at first use, then kept."""
    found = kernel_cache.load(f"step_{dim}d", SOURCE.read_bytes(), flags=(*kernel_cache.FLAGS, f"-DDIM={dim}"))
    if found is not None:
        found.step.argtypes = [ctypes.c_void_p] * 7
        found.step.restype = ctypes.c_int
    return found
