"""A demo in a copy of this process: libraries that are loaded here need not be loaded again, a second less for each demo."""

from __future__ import annotations

import os
import runpy
import sys
import traceback
import warnings
from pathlib import Path

import dolfinx.fem.petsc  # noqa: F401  # loaded for the copies
import gmsh  # noqa: F401
import scipy.integrate  # noqa: F401

import fmbd_fenicsx as fmbd

ROOT = Path(__file__).resolve().parents[1]


def load() -> None:
    """Load what demos use of the package, which is loaded at first use."""
    for name in fmbd.__all__:
        getattr(fmbd, name)


def run_copy(demo: Path, arguments: list[str], folder: Path) -> tuple[int, str]:
    """Exit code of a demo with such arguments, and what it printed, errors included; ``folder`` for its output."""
    load()
    output = folder / "output.txt"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads: those of pytest's own
        child = os.fork()
    if not child:
        _run_as_child(demo, arguments, output)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), output.read_text()


def _run_as_child(demo: Path, arguments: list[str], output: Path) -> None:
    """Run it as a program of its own; never returns: MPI, PETSc and open files belong to the process it was copied from."""
    code = 1
    try:
        descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        sys.stdout = sys.stderr = os.fdopen(descriptor, "w")  # pytest has put its own in their places

        os.chdir(ROOT)
        sys.argv = [str(demo), *arguments]
        sys.path.insert(0, str(demo.parent))
        warnings.resetwarnings()
        runpy.run_path(str(demo), run_name="__main__")
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


assert dolfinx.fem.petsc
