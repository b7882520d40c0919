"""Compiled steps: a C kernel, built once by the system's compiler and kept in a cache.

The kernel is an optional copy of :mod:`.generalized_alpha`, equation by equation, for rigid, reduced and floating bodies with
the elementary constraints; what it cannot do (forces, surface ties, constraints close to dependent, Newton's failures with
their messages) is left to the NumPy path. Results agree to roundoff. Without a C compiler everything runs in NumPy.
:mod:`.kernel` gives it the arrays of a system.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...log import log

SOURCE = Path(__file__).with_name("step.c")
FLAGS = ("-O3", "-ffp-contract=off", "-shared", "-fPIC", "-std=c99")


def cache_folder() -> Path:
    """Where compiled kernels are kept: XDG_CACHE_HOME/fmbd_fenicsx, by default in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "fmbd_fenicsx"


@lru_cache
def library(dim: int = 2) -> Any:
    """The kernel for the plane or for space, or None: built at first use, then found in the cache by the hash of its source."""
    compiler = os.environ.get("CC", "cc").split()
    if shutil.which(compiler[0]) is None:
        log.info("no C compiler %s: steps run in NumPy", compiler[0])
        return None
    flags = (*FLAGS, f"-DDIM={dim}")
    text = SOURCE.read_bytes() + repr((compiler, flags)).encode()
    name = f"step_{dim}d_{hashlib.sha256(text).hexdigest()[:20]}"
    try:
        return _load(cache_folder(), name, [*compiler, *flags])
    except (OSError, subprocess.SubprocessError) as error:
        log.info("the compiled step is not available (%s): steps run in NumPy", error)
        return None


def _load(folder: Path, name: str, command: list[str]) -> Any:
    """Load the library; a file that does not match its checksum is built again by ``command``."""
    file, sums = folder / f"{name}.so", folder / f"{name}.sha256"
    good = file.exists() and sums.exists() and sums.read_text() == hashlib.sha256(file.read_bytes()).hexdigest()
    if not good:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder) as work:
            built = Path(work) / file.name
            subprocess.run(
                [*command, "-o", str(built), str(SOURCE), "-lm"], check=True, capture_output=True, timeout=60
            )
            sums.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
            os.replace(built, file)
    found = ctypes.CDLL(str(file))
    found.step.argtypes = [ctypes.c_void_p] * 7
    found.step.restype = ctypes.c_int
    return found
