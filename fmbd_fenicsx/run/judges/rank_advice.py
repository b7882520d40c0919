"""A word on the number of ranks: where bodies are too small for it, fewer are faster.

Rigid and reduced bodies, joints and multipliers are the same on every rank; only elastic fields are shared out. The work on a
field of n unknowns grows like n. What ranks do not share, and what they have to tell each other (messages, interfaces, the
calls for each field), was measured to grow like sqrt(n). So bodies n_k count like one of

    n = (sum n_k / sum sqrt(n_k))^2                                                                                  (1)

unknowns: many small ones are worth no more ranks than one of them. Two ranks are as fast as one at 13 000 unknowns or so
(docs/performance_log.md: solids and plates, linear and quadratic, floating and absolute, by factors and by multigrid).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...log import note
from ...ranks import world_size
from ...system.system import System

WORTH = 6_500  # unknowns of a body that make a rank worth while


def faster_ranks(unknowns: Sequence[int], ranks: int) -> int:
    """How many of so many ranks are worth while for elastic fields with so many unknowns each, at least 1: by (1)."""
    each = np.asarray(unknowns, dtype=float)
    if not each.any():
        return 1
    counted = (each.sum() / np.sqrt(each).sum()) ** 2
    return max(1, min(ranks, int(counted // WORTH)))


def advise_on_ranks(system: System) -> None:
    """Say once when a run would be faster on fewer ranks; nothing on one."""
    ranks = world_size()
    if ranks == 1:
        return

    # wires, and bodies whose mesh a user has read on one rank, are whole on each
    unknowns = [int(part.field.n_global) for _, part in system.fields if part.field.comm.size > 1]
    better = faster_ranks(unknowns, ranks)
    if better == ranks:
        return

    bodies = f"{len(unknowns)} elastic bodies" if len(unknowns) > 1 else "an elastic body"
    shared = (
        f"{sum(unknowns)} unknowns of {bodies}"
        if unknowns
        else "no elastic body with the unknowns of its mesh, which alone are shared out (rigid, reduced bodies, wires are not),"
    )
    reason = f"a rank is worth while from about {WORTH} unknowns of a body on"
    note(f"{shared} on {ranks} ranks: {better} would be faster ({reason})")
