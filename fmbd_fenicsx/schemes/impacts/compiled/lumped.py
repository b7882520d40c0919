"""What is nearly the inverse of many contacts' compliance, as compiled code eliminates it (``driver/contact/products.c``).

Its pattern is that of N E N^T, with E the block of the step's matrix on the nodes that carry multipliers. An order of elimination
and what fills are found once for a set of contacts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ....kernel_cache import address_of
from .structures import Blocks, Lumped, Problem


class LumpedInverse:
    """Room for it, of contacts with d components."""

    def __init__(self, d: int) -> None:
        self.d = d
        self.arrays: dict[str, np.ndarray] = {}
        self.c = Lumped()

    def take(self, near: Any) -> None:
        """``near`` (m, m) sparse: which contacts E couples, themselves too."""
        m, square = near.shape[0], self.d**2
        place, of, (low, behind) = _eliminated(near)

        # where each pair of neighbours has its block among those that stand or fill
        row, other = sp.csr_matrix(near[of][:, of]).nonzero()
        apart = row != other
        row, other = row[apart], other[apart]
        slot = np.searchsorted(low * m + behind, np.minimum(row, other) * m + np.maximum(row, other))
        first, start = (np.searchsorted(rows, np.arange(m + 1)) for rows in (row, low))

        numbers = {
            "place": place, "of": of, "slot": slot, "first": first, "start": start, "near": other, "behind": behind,
            "still": np.zeros(m),
        }  # fmt: skip
        blocks_of = {"own": m, "W": len(row), "inner": m, "upper": len(behind), "lower": len(behind)}
        self.arrays = {name: np.ascontiguousarray(x, np.int32) for name, x in numbers.items()}
        self.arrays |= {name: np.zeros(count * square) for name, count in blocks_of.items()}
        self.arrays |= {"size": np.zeros(m), "work": np.zeros(2 * m * self.d * (1 + self.d))}

        c, at = self.c, {name: address_of(one) for name, one in self.arrays.items()}
        blocks = ("first", "near", "slot", "start", "behind", "own", "W")
        c.inverse = Problem(m=m, **{name: at[name] for name in blocks})
        c.blocks = Blocks(at["inner"], at["size"], at["upper"], at["lower"])
        c.place, c.of, c.still, c.work = (at[name] for name in ("place", "of", "still", "work"))


def _eliminated(near: Any) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Places of contacts in an order of elimination that fills little, the contacts there, and where blocks stand or fill behind
    each, row by row, ascending.
    """
    from scipy.sparse.linalg import splu

    ones = sp.csc_matrix((np.ones(near.nnz), near.nonzero()), shape=near.shape)
    degree = np.asarray(ones.sum(axis=0)).ravel()
    dominant = sp.diags(1.0 + degree) - ones  # whose factors lose no number that fills
    symmetric: Any = {"SymmetricMode": True}
    found = splu(dominant.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    L = sp.csc_matrix(found.L)
    behind, low = L.nonzero()
    order = np.lexsort((behind, low))
    low, behind = low[order], behind[order]
    place = np.asarray(found.perm_c)
    return place, np.argsort(place), (low[behind > low], behind[behind > low])
