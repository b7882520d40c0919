"""Bodies whose attitude is held by rows of its own while nothing else turns them: these rows and angular velocities do not meet
the rest of the step's matrix, and a point mass has three unknowns there (two in the plane).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...layout import ATTITUDE
from .items.items import READ

if TYPE_CHECKING:
    from .tables import Tables


def attitudes_apart(tables: Tables) -> dict[int, np.ndarray]:
    """The rows that hold the attitude of each such body, by its number.

    What may turn a body acts beside its origin, or is known to Python alone.
    """
    blocks = [block for block in tables.system.blocks if block.kind == ATTITUDE]
    held = {int(tables.frame[block.b]): np.arange(block.rows.start, block.rows.stop) for block in blocks}
    if not held:
        return {}

    place = tables.system.markers.position
    turned = np.zeros(tables.nb + 1 + len(tables.surfaces), dtype=bool)
    for items in (x for x in tables.items if x.role != READ):
        asked = any(term.kind.asked for term in items.terms or [items])
        turned[items.frames[place[items.markers].any(axis=2) | asked]] = True
    for loads in tables.mounts:
        turned[tables.frame[loads.a]] = True
        turned[tables.frame[loads.b[place[loads.b].any(axis=1)]]] = True
    for loads in tables.loads:
        turned[tables.frame[loads.a]] = turned[tables.frame[loads.b]] = True
    return {body: rows for body, rows in held.items() if not (turned[body] or tables.modes[body])}
