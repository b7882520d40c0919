"""The rods of a system in the driver's tables: their elements, their loads, and section laws in Python."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.rods.elements import RodElements
from .....mechanics.rods.relaxation import ArmMemory
from .....mechanics.rods.sections import LinearLaw
from .....rotations import Array
from ...declarations import enumeration
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout

# numbers of a load on a node: force, moment in world axes, then in axes of its section
LOADED = enumeration("NODES", "rods/rods.c")["LOADED"]


class RodTable:
    """One rod as a structure of ``driver/tables.h``; ``c`` is the structure, the arrays are those that C reads."""

    def __init__(self, tables: TableLayout, rod: RodElements, number: int) -> None:
        self.rod, store = rod, tables.store
        self.own = not isinstance(rod.law, LinearLaw)
        m, q = rod.weights.shape
        self.strain, strain = store.array(np.zeros((m, q, 6)))
        self.S, S = store.array(np.zeros((m, q, 6)))
        self.C, C = store.array(np.zeros((m, q, 6, 6)) if self.own else rod.law.C)
        self.density, density = store.array(np.zeros((m, q)))
        self.load, load = store.array(np.zeros((len(rod.nodes), LOADED)))
        arms = 0 if rod.arms is None else len(rod.arms.tau)
        # of the last step, and of the one before: a time, strains, those of the dashpots
        self.kept, kept = store.array(np.zeros((2, 1 + (1 + arms) * rod.natural.size)))

        self.c = structure("Rod", 3)(
            k=rod.frames.shape[1], points=q, nodes=len(rod.nodes), number=number if self.own else -1, n=m, beta=rod.beta,
            node=store.integers(rod.frames), loaded=store.integers(rod.nodes[:, 0]), to=store.integers(self._places(tables)),
            N=store.address(rod.shape.N), slope=store.address(rod.slopes), weight=store.address(rod.weights),
            natural=store.address(rod.natural), C=C, strain=strain, S=S, density=density, load=load if rod.loads else None,
            z=store.address(np.zeros((m, q, 11))), E=store.address(np.zeros((m, q, 6, 11))),
            rate=store.address(np.zeros((m, q, 6))), kept=kept, follows=store.address(np.zeros(arms)), arms=arms,
            **({} if rod.arms is None else {"arm": store.address(rod.arms.C), "tau": store.address(rod.arms.tau)}),
        )  # fmt: skip

    @property
    def remembers(self) -> int:
        """1 where sections are viscoelastic."""
        return int(self.rod.arms is not None)

    def recall(self) -> None:
        """Take the memory of the rod."""
        now = self.rod.kept
        for i, memory in enumerate((now, now.before)):
            if memory is None:
                self.kept[i, 0] = np.nan
            else:
                self.kept[i] = np.concatenate(([memory.t], memory.strain.ravel(), memory.inner.ravel()))

    def memory(self) -> Array:
        """What steps have made of it."""
        return self.kept.copy()

    def remember(self, memory: Array) -> None:
        """Give it back after accepted steps."""
        now, before = memory
        earlier = None if np.isnan(before[0]) else self._memory(before)
        self.rod.kept = replace(self._memory(now), before=earlier)

    def _memory(self, row: Array) -> ArmMemory:
        """One of both memories."""
        strain, inner = np.split(row[1:], [self.rod.natural.size])
        return ArmMemory(float(row[0]), strain.reshape(self.strain.shape), inner.reshape(-1, *self.strain.shape))

    def _places(self, tables: TableLayout) -> np.ndarray:
        """Where the lower half of each element's block goes in the fronts, node by node."""
        first = tables.at_u[self.rod.frames]
        i, a, j, b = _lower_half(first.shape[1])
        return tables.fronts.place(first[:, i] + a, first[:, j] + b)

    @property
    def of_time(self) -> bool:
        """Whether loads along the rod are to be sampled."""
        return bool(self.rod.loads)

    def sample(self, t: float) -> None:
        """Loads on the nodes at a time (s)."""
        self.load[:] = 0.0
        for load in self.rod.loads:
            first = 6 * load.follower + 3 * load.turns
            self.load[:, first : first + 3] += load.on_nodes(t)

    def sections(self) -> None:
        """Section forces and energies of a law in Python."""
        self.S[:] = self.rod.law.stress(self.strain)
        self.density[:] = self.rod.law.energy(self.strain)
        if self.rod.beta:
            self.section_slopes()

    def section_slopes(self) -> None:
        """Its tangents."""
        self.C[:] = self.rod.law.tangent(self.strain)


@cache
def _lower_half(nodes: int) -> np.ndarray:
    """Of the lower half of an element's block: node and number of each row, node and number of the column, (4, entries)."""
    entries = []
    for i in range(nodes):
        for j in range(i + 1):
            a, b = np.tril_indices(6) if i == j else np.divmod(np.arange(36), 6)
            entries.append([np.full(len(a), i), a, np.full(len(a), j), b])
    return np.concatenate(entries, axis=1)


def rod_pairs(rods: tuple[Any, ...]) -> set[tuple[int, int]]:
    """Frames that elements couple, the smaller one first."""
    found: set[tuple[int, int]] = set()
    for rod in rods:
        for nodes in np.sort(rod.frames, axis=1):
            found |= {(int(a), int(b)) for a, b in combinations(nodes, 2)}
    return found
