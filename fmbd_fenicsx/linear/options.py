"""PETSc options of our own prefixes: what the user sets there must be consumed by something."""

from __future__ import annotations

import ctypes
from typing import Any

from ..errors import InputError, near
from ..ranks import together

ORTHOGONAL = "ksp_gmres_cgs_refinement_type"


def set_from_options(ksp: Any) -> None:
    """``ksp.setFromOptions()``; (F)GMRES makes its basis orthogonal twice, unless the user's options say otherwise.

    Once is PETSc's default: where the first residual is 1e10 times the last, as beside the large forces of a stiff tie, the
    basis then is not orthogonal, and the residual stands still. Collective.
    """
    from petsc4py import PETSc

    options, name = PETSc.Options(), f"{ksp.getOptionsPrefix() or ''}{ORTHOGONAL}"
    # the list of all options, for a look at one would count as its use
    given = name in options.getAll()
    if not given:
        options[name] = "refine_always"

    ksp.setFromOptions()
    if not given:
        options.delValue(name)


def check_options(prefix: str, comm: Any) -> None:
    """Raise on all ranks when an option under ``prefix`` was set and no PETSc object asked for it;
    collective.
    """
    from petsc4py import PETSc

    known = PETSc.Options().getAll()
    mine = {name for name in known if name.startswith(prefix)}
    unused = sorted(name for name in mine if not _used(name))
    error = None
    if unused:
        text = ", ".join(f"-{n} {known[n]}" for n in unused)
        used = sorted(n for n in mine if n not in unused)
        error = InputError(
            f"PETSc options that nothing used: {text}. {near(unused[0], used)} Check the names of blocks and the spelling."
        )
    together(comm, error)


def _used(name: str) -> bool:
    """PetscOptionsUsed, which petsc4py does not offer."""
    from petsc4py import PETSc

    library = ctypes.CDLL(PETSc.__file__)
    flag = ctypes.c_int(0)
    code = library.PetscOptionsUsed(None, ctypes.c_char_p(f"-{name}".encode()), ctypes.byref(flag))
    if code == 0 and flag.value == 0:
        code = library.PetscOptionsUsed(None, ctypes.c_char_p(name.encode()), ctypes.byref(flag))
    return bool(flag.value) or code != 0
