"""What couples with what in a system that the driver evaluates: patterns of its derivatives, and directions of differences.

The balance of a body depends on the coordinates of all bodies that a joint, a spring or a rod ties to it, a row of a constraint
on those of its own bodies. Coordinates of bodies that no row knows together may be moved together: derivatives of chains and
trees take the same number of evaluations whatever their length (Curtis, Powell and Reid, doi:10.1093/imamat/13.1.117). Of a body
with many others on it the balance knows all of them: what joints and springs between it and each one do is told apart there.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...sparsity import Pattern
from ..declarations import enumeration
from ..tables.bodies.rods import rod_pairs

if TYPE_CHECKING:
    from ..tables.tables import Tables

ROLES = enumeration("ROW")
MANY = 4  # bodies on one, as in nets, above which their shares of its balance are told apart


class Couplings:
    """Of the tables of a system without elastic fields, with the frames that rest."""

    def __init__(self, tables: Tables) -> None:
        system = self.system = tables.system
        self.n: int = system.n_v
        self.m: int = system.n_lam
        self.groups, self.pairs = tables.structure.shape.groups, tables.structure.shape.pairs
        self.answering = tables.listening.pairs
        twist = system.motions.n_twist

        # the numbers in v of each body's coordinates
        self.of_body: list[np.ndarray] = [np.arange(b * twist, (b + 1) * twist) for b in range(system.n_frames)]
        for k, part in enumerate(system.parts):
            own = system.slices[1][k]
            self.of_body[part.frame] = np.append(self.of_body[part.frame], np.arange(own.start, own.stop))
        self.order = self._order(tables)
        self.shares = self._shares(tables)

    def _order(self, tables: Tables) -> np.ndarray:
        """Coordinates, and n + the numbers of rows, in the order in which the fronts eliminate them."""
        every = [f.unknowns[: f.pivots] for f in tables.fronts.fronts]
        places = np.concatenate([*self.of_body, self.n + np.arange(self.m)])
        return np.asarray(places[np.concatenate(every)] if every else places)

    @cached_property
    def near(self) -> list[set[int]]:
        """The bodies that each body's balance depends on, itself among them; of a row of a sum those of each term by itself."""
        near = [{b} for b in range(len(self.of_body))]
        for a, b in self.pairs:
            near[a].add(b)
            near[b].add(a)
        for body, read in self.answering:
            near[body].add(read)
        return near

    def _shares(self, tables: Tables) -> dict[int, dict[int, list[tuple[int, int]]]]:
        """By bodies with many others on them, which nothing but items couples: of each of these the items between the two, by the
        numbers of batch and item.
        """
        between: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
        others = set(self.answering) | set(rod_pairs(tables.system.elements))
        for f in (*tables.loads, *tables.mounts):
            both: Any = tables.body_of(tables.frame[np.stack((f.a, f.b), axis=1)])
            others |= {(a, b) for a, b in both.tolist()}
        for number, items in enumerate(tables.sources):
            if items.role in (ROLES["READ"], ROLES["TERM"]):
                continue
            bodies: Any = tables.body_of(items.frames)
            of_two = items.frames.shape[1] == 2 and not (items.linked or items.terms)
            if not (of_two and (items.frames <= tables.nb).all()):
                others |= {(a, b) for pair in bodies.tolist() for a in pair for b in pair}
                continue
            for i, pair in enumerate(bodies.tolist()):
                if len({*pair} - {-1}) == 2:
                    between[min(pair), max(pair)].append((number, i))

        apart = {body for pair in others if len({*pair} - {-1}) > 1 for body in pair}
        own = {b: near - {b} for b, near in enumerate(self.near)}
        return {
            b: {x: between[min(b, x), max(b, x)] for x in sorted(on)}
            for b, on in own.items()
            if len(on) > MANY
            and b not in apart
            and all((min(b, x), max(b, x)) in between for x in on)
            and len(self.of_body[b]) == self.system.motions.n_twist
        }

    @cached_property
    def balance(self) -> Pattern:
        """Of derivatives of the balance, (n, n)."""
        return self._blocks([(b, a) for b, near in enumerate(self.near) for a in near])

    @cached_property
    def masses(self) -> Pattern:
        """Of M, whose bodies do not couple."""
        return self._blocks([(b, b) for b in range(len(self.of_body))])

    @cached_property
    def turns(self) -> Pattern:
        """Of derivatives of rates by increments: each frame by itself, and other coordinates one by one."""
        twist, count = self.system.motions.n_twist, self.system.n_frames
        frames = np.arange(count * twist).reshape(count, twist)
        rows, columns = np.repeat(frames, twist, axis=1).ravel(), np.tile(frames, (1, twist)).ravel()
        rest = np.arange(count * twist, self.n)
        return Pattern.of((self.n, self.n), np.append(rows, rest), np.append(columns, rest))

    @cached_property
    def rows(self) -> Pattern:
        """Of G, (m, n)."""
        found = [
            (np.repeat(group.rows, len(own)), np.tile(own, len(group.rows)))
            for group in self.groups
            for own in (self.of_body[b] for b in group.bodies)
        ]
        none = np.zeros(0, int)
        rows, columns = (np.concatenate([none, *x]) for x in zip(*found, strict=True)) if found else (none, none)
        return Pattern.of((self.m, self.n), rows, columns)

    def _blocks(self, pairs: list[tuple[int, int]]) -> Pattern:
        rows = [np.repeat(self.of_body[b], len(self.of_body[a])) for b, a in pairs]
        columns = [np.tile(self.of_body[a], len(self.of_body[b])) for b, a in pairs]
        return Pattern.of((self.n, self.n), np.concatenate(rows), np.concatenate(columns))

    @cached_property
    def together(self) -> np.ndarray:
        """For each coordinate the number of the difference that moves it, (n,)."""
        colours: list[int] = []
        rows = [{b} for b in range(len(self.near))]  # the bodies whose balance depends on each
        beside: list[set[int]] = [set() for _ in rows]  # the bodies that a row of constraints knows with each
        for a, near in enumerate(self.near):
            for b in near:
                rows[b].add(a)
        for group in self.groups:
            for body in group.bodies:
                beside[body].update(group.bodies)
        for body, depending in enumerate(rows):
            known = beside[body].union(self.near[body], *(self.near[a] for a in depending if a not in self.shares))
            taken = {colours[c] for c in known if c < len(colours)}
            colours.append(next(k for k in range(len(taken) + 1) if k not in taken))

        widths = np.zeros(max(colours, default=-1) + 1, int)
        for colour, own in zip(colours, self.of_body, strict=True):
            widths[colour] = max(widths[colour], len(own))
        first, out = np.cumsum(widths) - widths, np.zeros(self.n, int)
        for colour, own in zip(colours, self.of_body, strict=True):
            out[own] = first[colour] + np.arange(len(own))
        return out
