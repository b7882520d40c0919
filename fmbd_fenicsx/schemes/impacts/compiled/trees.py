"""Parts of a system that nothing couples: a force on a body moves its own part only (``driver/contact/compliance.c``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....system.compiled.tables.tables import Tables


@dataclass(frozen=True, eq=False)
class Trees:
    """Fronts and bodies of each, ascending; ``tree_of`` (bodies,): which one a body is in."""

    fronts: list[np.ndarray]
    bodies: list[np.ndarray]
    tree_of: np.ndarray


def trees_of(tables: Tables) -> Trees:
    """Those of the step's matrix; a single one where efforts may answer to bodies that they do not act on."""
    fronts = tables.fronts
    root = np.arange(len(fronts.fronts))

    # a front is added to one that comes later
    for k in reversed(range(len(root))):
        following = fronts.fronts[k].following
        if following >= 0:
            root[k] = root[following]
    if tables.c.linkable:
        root[:] = 0

    # attitudes that nothing but rows of their own acts on go with their bodies
    root[fronts.front_of[tables.at_u + tables.twist - 1]] = root[fronts.front_of[tables.at_u]]

    _, tree = np.unique(root, return_inverse=True)
    tree_of = tree[fronts.front_of[tables.at_u]]
    count = int(tree.max(initial=-1)) + 1
    return Trees(_split(tree, count), _split(tree_of, count), tree_of)


def _split(number: np.ndarray, count: int) -> list[np.ndarray]:
    """Places of each number from 0 to count - 1, ascending."""
    order = np.argsort(number, kind="stable")
    return np.split(order, np.searchsorted(number[order], np.arange(1, count)))
