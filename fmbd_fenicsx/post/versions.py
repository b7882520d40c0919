"""Which versions a result was made with."""

from __future__ import annotations

import platform
import sys
from importlib import import_module, metadata

LIBRARIES = ("dolfinx", "ufl", "basix", "ffcx", "petsc4py", "mpi4py", "numpy", "scipy", "gmsh")
# of their packages
NAMES = {"dolfinx": "fenics-dolfinx", "ufl": "fenics-ufl", "basix": "fenics-basix", "ffcx": "fenics-ffcx"}


def about() -> str:
    """Versions of this package, of Python and of the libraries that it stands on, and the machine, as lines of text.

    Libraries that are not loaded are looked up without loading them.
    """
    from .. import __version__

    rows = [("fmbd_fenicsx", __version__), ("Python", platform.python_version())]
    rows += [(name, version_of(name)) for name in LIBRARIES]
    rows.append(("system", f"{platform.system()} {platform.release()}, {platform.machine()}"))

    return "\n".join(f"{name:14s}{version}" for name, version in rows)


def version_of(name: str) -> str:
    """Version of a library: as it says itself where it is loaded, else from its package."""
    if name in sys.modules:
        return str(getattr(import_module(name), "__version__", "of unknown version"))
    for package in (NAMES.get(name, name), name):
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return "not found"


def short() -> str:
    """One line for reports: this package, and of the libraries those that the run has loaded."""
    from .. import __version__

    loaded = [f"{name} {version_of(name)}" for name in ("dolfinx", "petsc4py", "numpy") if name in sys.modules]
    return ", ".join([f"fmbd_fenicsx {__version__}", f"Python {platform.python_version()}", *loaded])
