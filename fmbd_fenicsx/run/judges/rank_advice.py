"""A word on the number of ranks: where bodies are too small for it, fewer are faster.

Rigid and reduced bodies, joints and multipliers are the same on every rank; only elastic fields are shared out. Below some ten
thousand unknowns a rank its work is smaller than what it has to tell the others (the PETSc manual's rule,
https://petsc.org/release/faq/).
"""

from __future__ import annotations

from ...log import note, world_size
from ...system.system import System

WORTH = 10_000  # unknowns that make a rank worth while


def faster_ranks(unknowns: int, ranks: int) -> int:
    """How many of so many ranks are worth while for elastic fields with so many unknowns, at least 1."""
    return max(1, min(ranks, unknowns // WORTH))


def advise_on_ranks(system: System) -> None:
    """Say once when a run would be faster on fewer ranks; nothing on one."""
    ranks = world_size()
    if ranks == 1:
        return
    unknowns = sum(int(part.field.n_global) for _, part in system.fields)
    better = faster_ranks(unknowns, ranks)
    if better == ranks:
        return
    shared = (
        f"{unknowns} unknowns of elastic bodies"
        if unknowns
        else "no elastic body with the unknowns of its mesh, which alone are shared out (rigid and reduced bodies are not),"
    )
    note(f"{shared} on {ranks} ranks: {better} would be faster (a rank is worth while from about {WORTH} unknowns on)")
