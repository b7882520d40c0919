"""The small problem of contacts in compiled code, where its matrix is known.

It is solved by Newton's iteration of ``driver/contact/complementarity.c``. What this does not solve at
once, and contacts that depend on each other, are those of :mod:`....linear.complementarity`.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.sparse as sp

from ....kernel_cache import address_of
from ....linear.complementarity.coulomb import ContactCounts
from ....rotations import Array
from ....system.compiled.declarations import enumeration
from ....system.compiled.library import CONTACT, driver_library
from ....system.compiled.states.evaluation import DriverStates
from ....system.system import System
from .structures import BY_COMPONENT, Blocks, Contacts, Lumped, Problem, Tally


class LumpedInverse:
    """What is nearly the inverse of the compliance of many contacts with d components, as C eliminates it (``products.c``).

    Its pattern is that of N E N^T, with E the block of the step's matrix on the nodes that carry multipliers. An order of
    elimination and what fills are found once for a set of contacts.
    """

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


# of forces, that its iteration works with
VECTORS = 16 + 2 * enumeration("DIRECTIONS", "contact/friction.c")["DIRECTIONS"]


class CompiledProblem:
    """Forces of points in d components, whose openings are q + W f; room for as many points as were asked for so far."""

    def __init__(self, library: Any, d: int) -> None:
        self.library, self.d = library, d
        self.room = self.room_applied = 0
        self.arrays: dict[str, np.ndarray] = {}
        self.everyone = _everyone(0)
        self.c = Contacts(components=d)

    def forces(self, W: Array, opening: Array, mu: Array, force: Array, counts: ContactCounts) -> Array | None:
        """Forces (m, d) for the matrix W (m d, m d) and the openings (m, d) under ``force`` (m, d), from which the iteration
        starts; None where it does not end.
        """
        m, d = force.shape
        if m != self.c.all.m or self.c.all.lumped:
            self.take_size(m)
        row, near, _ = self.everyone
        blocks, x = W.reshape(m, d, m, d), self.arrays
        x["own"][: m * d * d] = blocks[range(m), :, range(m)].ravel()
        x["W"][: len(row) * d * d] = blocks[row, :, near].ravel()
        x["f"][: m * d], x["u"][: m * d], x["mu"][:m] = force.ravel(), opening.ravel(), mu
        x["q"][: m * d] = opening.ravel() - W @ force.ravel()
        if self.library.contact_problem(ctypes.addressof(self.c)):
            self.c.tally = Tally()
            return None

        self.count(counts)
        found = x["f"][: m * d].reshape(m, d).copy()
        found[:, 0] = np.maximum(found[:, 0], 0.0)
        return found

    @property
    def posed(self) -> tuple[Array, Array, Array, Array]:
        """The problem as it stands in C: W, openings (m d,) under the forces, friction (m,), and the forces (m, d) themselves."""
        m, d, x = self.c.all.m, self.d, self.arrays
        row, near, _ = self.everyone
        W = np.zeros((m, d, m, d))
        W[range(m), :, range(m)] = x["own"][: m * d * d].reshape(m, d, d)
        W[row, :, near] = x["W"][: len(row) * d * d].reshape(-1, d, d)
        return W.reshape(m * d, m * d), x["u"][: m * d].copy(), x["mu"][:m].copy(), x["f"][: m * d].reshape(m, d)

    def count(self, counts: ContactCounts) -> None:
        """Add what was counted since the last call."""
        tally = self.c.tally
        counts.solves, counts.iterations = counts.solves + tally.solves, counts.iterations + tally.iterations
        counts.changes, counts.residual = counts.changes + tally.changes, max(counts.residual, tally.residual)
        counts.products += tally.products
        self.c.tally = Tally()

    def take_size(self, m: int) -> None:
        """Problems of m points come next."""
        if m > self.room:
            self._make_room(m)
        self.everyone = _everyone(m)  # C reads it
        places = {name: self.arrays[name] for name in ("own", "W", "mu", *BY_COMPONENT)} | self.everyone[2]
        self.c.all = Problem(m=m, **{name: address_of(one) for name, one in places.items()})

    def take_lumped(self, near: Any) -> None:
        """Problems come next whose matrix is known by its products; ``near``: as of :meth:`.LumpedInverse.take`."""
        m = near.shape[0]
        if m > self.room_applied:
            self._make_room(m, applied=True)
        self.lumped = LumpedInverse(self.d)  # C reads it
        self.lumped.take(near)
        places = {name: address_of(self.arrays[name]) for name in ("own", "mu", *BY_COMPONENT)}
        self.c.all = Problem(m=m, lumped=ctypes.addressof(self.lumped.c), **places)

    def _make_room(self, m: int, *, applied: bool = False) -> None:
        """Arrays for m points, all of which move each other; ``applied``: the matrix is known by its products."""
        self.room, self.room_applied = (0, m) if applied else (m, 0)
        d = self.d
        square, pairs = d * d, 0 if applied else m * (m - 1)
        vectors = VECTORS + 3 * d if applied else 3 + 2 * d
        sizes = {
            "own": m * square, "W": pairs * square, "mu": m, **dict.fromkeys(BY_COMPONENT, m * d),
            "inner": m * square, "size": m, "upper": pairs // 2 * square, "lower": pairs // 2 * square,
            "least": vectors * m * d,
        }  # fmt: skip
        self.arrays = {name: np.zeros(size) for name, size in sizes.items()}
        self.arrays["states"] = np.zeros(2 * m, np.int32)
        self.arrays["known"] = np.ones(1, np.int32)

        at = {name: address_of(one) for name, one in self.arrays.items()}
        self.c.blocks = Blocks(at["inner"], at["size"], at["upper"], at["lower"])
        self.c.least, self.c.states, self.c.known_of = at["least"], at["states"], at["known"]


@lru_cache(maxsize=32)
def _everyone(m: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Pairs of m points that all move each other, and the pattern of their matrix as C reads it."""
    row, near = np.nonzero(~np.eye(m, dtype=bool))
    number = np.arange(m + 1)
    start = number * (m - 1) - number * (number - 1) // 2
    low, high = np.minimum(row, near), np.maximum(row, near)
    pattern = {
        "first": number * (m - 1), "near": near, "slot": start[low] + high - low - 1, "start": start,
        "behind": np.nonzero(np.triu(np.ones((m, m), dtype=bool), 1))[1],
    }  # fmt: skip
    return row, near, {name: x.astype(np.int32) for name, x in pattern.items()}


def compiled_problem(system: System, components: int) -> CompiledProblem | None:
    """Of forces of so many components, where compiled code evaluates a system with elastic fields; other scenes are compiled as a
    whole.
    """
    if not system.fields or not isinstance(system.evaluator, DriverStates):
        return None
    library = driver_library(system.motions.dim, (CONTACT,))
    if library is None:
        return None
    return CompiledProblem(library, components)
