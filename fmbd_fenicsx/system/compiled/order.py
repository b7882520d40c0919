"""The order of elimination of the step's matrix, and its dense fronts.

Unknowns are grouped in *nodes*: the rates of one body, or the rows of the constraints between the same bodies. A tree of joints
is grown from the ground; the rows of a joint of the tree are eliminated with the body it leads to, which leaves a positive
pivot for that body and a negative one for each row. So is a row that couples the coordinate of this joint with others, with the
first of its bodies: a train of gears is eliminated from its ends, and all that wheels add to the next ones is positive, however
far gears reduce. A wheel that a drive holds comes behind the others: what is left of it, nothing, is roundoff of its own
inertia, in which a slower part of the train is lost. Rows that close a loop, or couple more, come after all their bodies. Among
what may come next, the group with the fewest neighbours is taken (minimum degree): chains and trees fill nothing, the work is
proportional to their length.

Where the bodies of a loop are in line, what comes later may lock them while it stands: such a row has no pivot though it depends
on no other. It then comes after all bodies of its loop but the one that leads to the others: what is eliminated before it hangs
on one body alone, and locks nothing. For all rows that would fill more (a star of n loops n^2).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from .declarations import enumeration

LANES = enumeration("LANES", "algebra/factor.c")["LANES"]  # columns of fronts begin at whole vectors of the processor

LOCKED = "rows that wait for all bodies of their loops"  # kept with a system: numbers of rows
MOST_COUPLED = 8  # bodies of a row that is eliminated with one of them, which couples all others
ENTRY = 16  # eliminations that cost as much as clearing an entry of a front and adding it to the next one


@dataclass(frozen=True)
class RowGroup:
    """Rows of constraints that act on the same bodies; ``coupling``: they are sums of coordinates of several joints.

    ``ends``: pairs of markers that they act on, those of a joint and of its coordinates are the same; ``locked``: whether bodies
    that are eliminated later have locked some of them.
    """

    bodies: tuple[int, ...]
    rows: tuple[int, ...]
    coupling: bool
    ends: frozenset[tuple[int, ...]] = frozenset()
    locked: bool = False


@dataclass(frozen=True, eq=False)
class Front:
    """Unknowns of a dense part of the factor, the ``pivots`` eliminated there first; ``following``: the front it is added to;
    ``apart``: of a lot that meets no other unknowns.
    """

    unknowns: np.ndarray
    pivots: int
    following: int
    apart: bool = False


def joint_tree(n_bodies: int, groups: list[RowGroup]) -> dict[int, list[int]]:
    """Groups that lead to each body in a tree of joints grown from the ground (from some body where nothing is held)."""
    touching: dict[int, list[int]] = {b: [] for b in range(-1, n_bodies)}
    for number, group in enumerate(groups):
        if group.coupling or not 1 <= len(group.bodies) <= 2:
            continue
        for body in (*group.bodies, -1)[:2]:
            touching[body].append(number)

    led: dict[int, list[int]] = {b: [] for b in range(n_bodies)}
    seen: set[int] = set()
    for root in (-1, *range(n_bodies)):
        if root in seen:
            continue
        seen.add(root)
        reached = [root]
        for body in reached:
            ways = [(number, other) for number in touching[body] for other in groups[number].bodies]
            # what has many joints leads those of other bodies, so that loops close beside it
            for number, other in sorted(ways, key=lambda way: -len(touching[way[1]])):
                if other not in seen:
                    seen.add(other)
                    reached.append(other)
                    led[other].append(number)
    return led


def parents(groups: list[RowGroup], led: dict[int, list[int]]) -> dict[int, int]:
    """The body that leads to each one in a tree of joints, -1: the ground, or none."""
    return {b: next((x for g in joints for x in groups[g].bodies if x != b), -1) for b, joints in led.items()}


def loop_of(bodies: Iterable[int], parent: dict[int, int]) -> set[int]:
    """The bodies between these in a tree and the first one that leads to all of them."""
    ways = []
    for body in bodies:
        way = [body]
        while way[-1] != -1:
            way.append(parent[way[-1]])
        ways.append(set(way))
    return set().union(*ways) - (ways[0].intersection(*ways[1:]) if len(ways) > 1 else {-1})


def couplings_of(widths: list[int], groups: list[RowGroup], led: dict[int, list[int]]) -> dict[int, list[int]]:
    """Couplings that may be eliminated with each body: of the coordinate that the one joint which leads to it leaves free."""
    found: dict[int, list[int]] = {}
    for number, group in enumerate(groups):
        for body in group.bodies if group.coupling and len(group.bodies) <= MOST_COUPLED else ():
            joint = groups[led[body][0]] if len(led[body]) == 1 else None
            if joint is None or len(joint.ends) != 1 or not joint.ends <= group.ends:
                continue
            if len(joint.rows) + len(group.rows) <= widths[body]:
                found.setdefault(body, []).append(number)
    return found


class Elimination:
    """Groups of nodes in the order in which they are eliminated; see the module.

    Nodes: bodies 0 .. n - 1, then the groups of rows. ``pairs``: bodies that a force couples.
    """

    def __init__(self, widths: list[int], groups: list[RowGroup], pairs: set[tuple[int, int]]) -> None:
        n = len(widths)
        self.widths = [*widths, *(len(g.rows) for g in groups)]
        self.near: list[set[int]] = [set() for _ in self.widths]
        held_by = {(n + number, body) for number, group in enumerate(groups) for body in group.bodies}
        for a, b in pairs | held_by:
            self.near[a].add(b)
            self.near[b].add(a)

        led = joint_tree(n, groups)
        self.couplings = {b: [n + g for g in these] for b, these in couplings_of(widths, groups, led).items()}
        coupled = {body for group in groups if group.coupling for body in group.bodies}
        self.held = {b for b in coupled if sum(len(groups[g].rows) for g in led[b]) >= widths[b]}
        self.units = [[b, *(n + g for g in led[b])] for b in range(n)]
        self.unit_of = {node: u for u, unit in enumerate(self.units) for node in unit}
        self.done: set[int] = set()  # nodes

        # loops come after their bodies
        self.waiting = [0] * n  # for so many of these
        self.closers: dict[int, list[int]] = {}
        parent = parents(groups, led)
        for number, group in enumerate(groups):
            if n + number in self.unit_of:
                continue
            self.unit_of[n + number] = len(self.units)
            before = loop_of(group.bodies, parent) if group.locked else group.bodies
            for body in before:
                self.closers.setdefault(body, []).append(len(self.units))
            self.units.append([n + number])
            self.waiting.append(len(before))

    def run(self) -> list[tuple[list[int], set[int]]]:
        """(nodes eliminated together, nodes they are coupled with then) in order."""
        heap = [(self._degree(u), u) for u in range(len(self.units)) if not self.waiting[u]]
        heapq.heapify(heap)
        out = []

        while heap:
            degree, u = heapq.heappop(heap)
            if self.units[u][0] in self.done:
                continue
            if degree < (now := self._degree(u)):
                heapq.heappush(heap, (now, u))
                continue
            unit = self._unit(u)
            around = self._around(unit)
            self.done.update(unit)
            out.append((unit, around))

            # what is left is coupled
            for x in around:
                self.near[x] |= around
                self.near[x] -= {x, *unit}
            for v in {self.unit_of[x] for x in around}:
                if not self.waiting[v]:
                    heapq.heappush(heap, (self._degree(v), v))
            for v in self.closers.get(unit[0], ()):
                self.waiting[v] -= 1
                if not self.waiting[v]:
                    heapq.heappush(heap, (self._degree(v), v))
        return out

    def _degree(self, u: int) -> tuple[bool, int]:
        """Unknowns that a group is coupled with, behind whether it is a coupled body that is held."""
        return self.units[u][0] in self.held, sum(self.widths[x] for x in self._around(self._unit(u)))

    def _unit(self, u: int) -> list[int]:
        """A group, of a body with the first coupling that is left for it: the last body of a train has none."""
        unit = self.units[u]
        left = (x for x in self.couplings.get(unit[0], ()) if x not in self.done)
        return [*unit, *islice(left, 1)]

    def _around(self, unit: list[int]) -> set[int]:
        """What a group is coupled with."""
        return set().union(*(self.near[x] for x in unit)) - set(unit)


def merged(
    steps: list[tuple[list[int], set[int]]], width: Callable[[Iterable[int]], int]
) -> list[tuple[list[int], set[int]]]:
    """The same eliminations in fewer steps: one is made together with its following one where that costs no more (supernodes;
    Duff and Reid, as factor.c): nets have few dense fronts, in place of one for each node. ``width``: unknowns of nodes.
    """

    def cost(pivots: int, size: int) -> float:
        return (size**3 - (size - pivots) ** 3) / 3 + ENTRY * size**2

    step_of = {node: k for k, (unit, _) in enumerate(steps) for node in unit}
    units = [unit for unit, _ in steps]
    pivots = [width(unit) for unit in units]
    rest = [width(around) for _, around in steps]

    for k, (_, around) in enumerate(steps):
        if not around:
            continue
        f = min(step_of[x] for x in around)
        size = pivots[f] + rest[f]
        apart = cost(pivots[k], pivots[k] + rest[k]) + cost(pivots[f], size)
        if cost(pivots[k] + pivots[f], pivots[k] + size) <= apart:
            units[f] = units[k] + units[f]
            pivots[f] += pivots[k]
            step_of.update(dict.fromkeys(units[k], f))
            units[k] = []
    return [(unit, around) for unit, (_, around) in zip(units, steps, strict=True) if unit]


class Fronts:
    """The fronts of a matrix, and where its entries go.

    ``unknowns``: of each node (bodies, then groups of rows). Storage: columns of one front after another, ``place`` of an entry.
    ``apart``: unknowns whose entries with all others are zero, a front for each lot; these entries go behind the storage.
    """

    def __init__(
        self,
        unknowns: list[np.ndarray],
        groups: list[RowGroup],
        pairs: set[tuple[int, int]],
        apart: Sequence[np.ndarray] = (),
    ) -> None:
        n = len(unknowns) - len(groups)
        steps = merged(
            Elimination([len(x) for x in unknowns[:n]], groups, pairs).run(),
            lambda nodes: sum(len(unknowns[x]) for x in nodes),
        )
        order = {node: (k, i) for k, (unit, _) in enumerate(steps) for i, node in enumerate(unit)}

        self.fronts: list[Front] = [Front(lot, len(lot), -1, apart=True) for lot in apart]
        first = len(self.fronts)
        for unit, around in steps:
            rest = sorted(around, key=order.__getitem__)
            rows = np.concatenate([unknowns[x] for x in (*unit, *rest)])
            pivots = sum(len(unknowns[x]) for x in unit)
            self.fronts.append(Front(rows, pivots, first + order[rest[0]][0] if rest else -1))

        sizes = np.array([len(f.unknowns) for f in self.fronts], np.int64)
        self.ld = -(-sizes // LANES) * LANES
        self.start = np.concatenate(([0], np.cumsum(self.ld * sizes))).astype(np.int64)
        self._index(sum(len(x) for x in (*unknowns, *apart)))
        self.apart = bool(apart)
        self.lot = np.zeros(self.size, np.int64)  # of each unknown, 0: those that are not apart
        for number, lot in enumerate(apart):
            self.lot[lot] = 1 + number

    @property
    def storage(self) -> int:
        """Numbers that all fronts take."""
        return int(self.start[-1])

    def _index(self, size: int) -> None:
        """Front and position of each unknown's pivot; sorted keys of (front, unknown) with their rows."""
        self.size = size
        self.front_of = np.zeros(size, np.int64)
        self.position = np.zeros(size, np.int64)
        keys, rows, count = [], [], 0

        for k, f in enumerate(self.fronts):
            mine = f.unknowns[: f.pivots]
            self.front_of[mine] = k
            self.position[mine] = count + np.arange(f.pivots)
            count += f.pivots
            keys.append(k * size + f.unknowns)
            rows.append(np.arange(len(f.unknowns)))

        key = np.concatenate(keys) if keys else np.zeros(0, np.int64)
        # keys in order: a row is found by bisection
        order = np.argsort(key)
        self._keys = key[order]
        self._rows = (np.concatenate(rows) if rows else key)[order]

    def row_in(self, front: np.ndarray, unknown: np.ndarray) -> np.ndarray:
        """Rows of unknowns in fronts."""
        key = front * self.size + unknown
        at = np.searchsorted(self._keys, key)
        assert np.array_equal(self._keys[at], key), "an entry outside of the fronts"
        return self._rows[at]

    def place(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Places of the entries (i, j) in the storage; i and j in either order."""
        i, j = np.broadcast_arrays(np.asarray(i, np.int64), np.asarray(j, np.int64))
        if not i.size:
            return np.zeros(i.shape, np.int64)
        if self.apart and (far := self.lot[i] != self.lot[j]).any():
            out = np.full(i.shape, self.storage)
            out[~far] = self.place(i[~far], j[~far])
            return out
        swap = self.position[i] < self.position[j]
        late, early = np.where(swap, j, i), np.where(swap, i, j)
        front = self.front_of[early]
        return np.asarray(self.start[front] + self.ld[front] * self.row_in(front, early) + self.row_in(front, late))
