"""Where the tangent of an implicit step and its stage matrices have their entries, as tangent.c reads it.

With frequencies s, K = K0 + s K1 + s^2 K2, symbols as in linear/implicit/pencil.py:

    K0 = [by_q - by_v J, G^T, by_v U, by_a U],     K1 = [by_v - by_a J, 0, by_a U, 0],     K2 = [by_a, 0, 0, 0]      (1)

and behind these, beside stiff ties, [R^T; -1] in K0. Where many joints meet at one body, G U would couple all of their rows: its
moves w = U dmu, or U dtau, are unknowns of the factors then, with by_v, or by_a, for columns, and rows [-U, 1] in K0.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, Any

import numpy as np

from ....kernel_cache import address_of, addresses_of
from ....rotations import Array
from ...sparsity import Pattern, Product
from ...tangents.step_tangent import StepTangent, crowded
from ..declarations import TABLES, structure_of
from .couplings import Couplings
from .exchange import Exchange

if TYPE_CHECKING:
    from ...layout import State
    from ...tangents.stiff_ties import StiffTies
    from ..tables.tables import Tables
    from .evaluation import DriverStates

Ties = structure_of(TABLES, "Ties")


class TiedItems:
    """Those of the tables; ``rows``: the pattern of R, (p, n_v); ``address``: of what C reads, None without ties."""

    def __init__(self, stiff: StiffTies, couplings: Couplings, tables: Tables) -> None:
        self._couplings = couplings
        found: list[tuple[int, int]] = []  # batch and item of each
        self._bodies: list[list[int]] = []
        for loads, which in stiff.springs:
            of_spring = {
                int(number): (batch, item)
                for batch, items in enumerate(tables.sources)
                if items.loads is loads and items.number is not None
                for item, number in enumerate(items.number)
            }
            found += [of_spring[int(i)] for i in which]
        for batch, item in found:
            both: Any = tables.body_of(tables.sources[batch].frames[item])
            self._bodies.append([b for b in dict.fromkeys(both.tolist()) if b >= 0])

        own = [np.concatenate([couplings.of_body[b] for b in bodies]) for bodies in self._bodies]
        none, lengths = np.zeros(0, int), [len(x) for x in own]
        self.rows = Pattern.of(
            (len(own), couplings.n), np.repeat(np.arange(len(own)), lengths), np.concatenate([none, *own])
        )
        self.address = self._tell(np.array(found, int).reshape(-1, 2), len(tables.batches))

    def _tell(self, found: np.ndarray, batches: int) -> int | None:
        """What C reads."""
        if not len(found):
            return None
        number = np.lexsort(found.T[::-1])
        start = np.searchsorted(found[number, 0], np.arange(batches + 1))
        self._kept = [np.ascontiguousarray(x, np.int32) for x in (start, found[number, 1], number)]
        self.c = Ties(len(found), *map(address_of, self._kept))
        return ctypes.addressof(self.c)

    def among(self, order: np.ndarray, first: int) -> np.ndarray:
        """An order of elimination with efforts, unknowns from number ``first`` on, behind the first body of each spring: their
        compliance is a pivot there, however stiff the spring.
        """
        place = dict(zip(order.tolist(), range(len(order)), strict=True))
        ends = [min(max(place[i] for i in self._couplings.of_body[b]) for b in bodies) + 0.5 for bodies in self._bodies]
        every = np.concatenate((np.arange(len(order), dtype=float), ends))
        return np.concatenate((order, first + np.arange(len(ends))))[np.argsort(every, kind="stable")]


DATA = "J M G U by_q by_v by_a slopes R".split()  # of a tangent, one behind the other


ProductPairs = structure_of("implicit/tangent.c", "Product")
Patterns = structure_of("implicit/tangent.c", "Patterns", Product=ProductPairs)


class StageStructure:
    """Patterns of the equations of a step whose constraints hold on some levels, 0 to 2; and of (1), by columns.

    ``pulls``: of rows of accelerations, see ``Form`` of tangent.c. ``frozen``: a step keeps the U of its start. ``stiff``: ties.
    """

    def __init__(
        self,
        couplings: Couplings,
        states: DriverStates,
        levels: tuple[int, ...],
        stiff: StiffTies,
        *,
        pulls: tuple[float, float] = (0.0, 0.0),
        frozen: bool = False,
    ) -> None:
        self.couplings, self.states, self.levels, self.pulls = couplings, states, levels, pulls
        self.keeps_directions = frozen
        n, m, count = couplings.n, couplings.m, len(levels)
        self.n, self.m, self.size = n, m, n + count * m + len(stiff)
        G, balance, offsets = couplings.rows, couplings.balance, n + m * np.arange(count)
        self.ties = TiedItems(stiff, couplings, states.tables)
        R, self.behind = self.ties.rows, n + count * m

        rows = np.concatenate([balance.rows, *(at + G.rows for at in offsets), self.behind + R.rows])
        columns = np.concatenate([balance.columns, *(G.columns for _ in levels), R.columns])
        self.low = Pattern.of((self.size, n), rows, columns)

        across, self._across = G.transposed()
        self.normal = Product(couplings.masses, across)
        self.turned = Product(self.low, couplings.turns, within=self.low)
        pulling, self._across_ties = R.transposed()

        # moves as unknowns, behind all others
        bears = crowded(G, couplings.masses)
        self.moves, number, U = np.flatnonzero(bears), np.cumsum(bears) - 1, self.normal.pattern
        first = self.size + len(self.moves) * np.arange(max(count - 1, 0))
        self.all = self.size + len(self.moves) * len(first)
        self.crossed = Product(self.low, U, through=~bears)
        on, of = self._on_moves, self._of_moves = np.flatnonzero(bears[self.low.columns]), np.flatnonzero(bears[U.rows])

        def diagonal(at: int, size: int) -> tuple[np.ndarray, np.ndarray]:
            return (at + np.arange(size),) * 2

        blocks = [(pulling.rows, self.behind + pulling.columns), diagonal(self.behind, len(stiff))]
        blocks += [(self.low.rows, self.low.columns), (across.rows, n + across.columns)]
        for level, at in enumerate(first, 1):
            mu, crossed = n + level * m, self.crossed.pattern
            blocks += [(crossed.rows, mu + crossed.columns), (self.low.rows[on], at + number[self.low.columns[on]])]
            blocks += [diagonal(int(at), len(self.moves)), (at + number[U.rows[of]], mu + U.columns[of])]
        # and what softens rows that depend on each other
        self._lay_out([*blocks, diagonal(n, count * m)])
        formulas = states.tables.formulas
        self.laws = Pattern.of((formulas, 2), *np.indices((formulas, 2)).reshape(2, -1))
        self.frozen = np.zeros(len(self.normal.pattern))  # data of U where a step began

        each = [np.array([i]) for i in range(n)]
        for i, move in enumerate(self.moves):
            each[move] = np.array([move, *(first + i)])
        each += [*(n + np.arange(m)[:, None] + m * np.arange(count))]
        order = np.concatenate([each[x] for x in couplings.order])
        self.order = self.ties.among(order, self.behind).astype(np.int32)
        self._tell(offsets)

    def _lay_out(self, blocks: list[tuple[np.ndarray, np.ndarray]]) -> None:
        """K by columns, and where its entries stand among those of the blocks, rows and columns."""
        rows, columns = map(np.concatenate, zip(*blocks, strict=True))
        self._taken = np.lexsort((rows, columns))
        self.row = rows[self._taken].astype(np.int32)
        self.start = np.searchsorted(columns[self._taken], np.arange(self.all + 1)).astype(np.int32)

    def _tell(self, offsets: np.ndarray) -> None:
        """All of it for C."""
        couplings, low, G = self.couplings, self.low, self.couplings.rows
        self._kept: list[Any] = []
        colour = couplings.together
        by_colour = colour[low.columns]
        coloured = np.argsort(by_colour, kind="stable")
        colours = int(colour.max(initial=-1)) + 1

        # where each matrix begins among the data of a tangent
        ends = np.cumsum([0, *(len(self.patterns[name]) for name in DATA)])
        self.count = int(ends[-1])
        self.parts = {name: slice(int(i), int(j)) for name, i, j in zip(DATA, ends[:-1], ends[1:], strict=True)}

        levels = [low.places(at + G.rows, G.columns) for at in offsets]
        shares = [(b, x, items) for b, on in couplings.shares.items() for x, items in on.items()]
        acting = [(*item, number) for number, (_, _, items) in enumerate(shares) for item in items]
        twist, row = couplings.system.motions.n_twist, low.rows.copy()
        for number, (b, x, _) in enumerate(shares):
            own, place = couplings.of_body[x], self.size + twist * number + np.arange(twist)
            at = low.places(np.repeat(couplings.of_body[b], len(own)), np.tile(own, twist))
            row[at] = np.repeat(place, len(own))
        self.c = Patterns(
            n=self.n, m=self.m, size=self.size, levels=len(levels), pulls=self.pulls, frozen=self.frozen_at,
            first=self.levels[0] if levels else 0, colours=colours, moves=len(self.moves),
            shares=len(shares), acting=len(acting),
            of_bodies=self._address(np.array([b for b, _, _ in shares])),
            acts=self._address(np.array(acting, int).reshape(-1, 3)),
            moving=len(self._on_moves), on_moves=self._address(self._on_moves),
            along=len(self._of_moves), of_moves=self._address(self._of_moves),
            low=len(low), crossings=len(self.crossed.pattern), columns=len(self._taken), masses=len(couplings.masses),
            G_start=address_of(G.start), G_on=address_of(G.on), M_start=address_of(couplings.masses.start),
            ties=self.ties.address, R_start=address_of(self.ties.rows.start), R_on=address_of(self.ties.rows.on),
            across_ties=self._address(self._across_ties),
            of_ties=self._address(low.places(self.behind + self.ties.rows.rows, self.ties.rows.columns)),
            colour=self._address(colour, np.int32),
            across=self._address(self._across), coloured=self._address(coloured),
            coloured_start=self._address(np.searchsorted(by_colour[coloured], np.arange(colours + 1))),
            row=self._address(row), column=self._address(low.columns), taken=self._address(self._taken),
            of_masses=self._address(low.places(couplings.masses.rows, couplings.masses.columns)),
            of_level=self._address(np.concatenate([np.zeros(0, int), *levels])),
            normal=self._pairs(self.normal), turned=self._pairs(self.turned), crossed=self._pairs(self.crossed),
            **{name: part.start for name, part in self.parts.items()},
        )  # fmt: skip

        self.address = ctypes.addressof(self.c)
        n, n_q = self.n, self.couplings.system.n_q
        masses, widest = len(couplings.masses), max(map(len, couplings.of_body), default=0)
        sizes = {"q": n_q, "v": n, "a": n, "mult": self.size - n, "M": masses, "W": masses}
        sizes["room"] = 4 * n + n_q + 3 * (self.size + twist * len(shares)) + 2 * widest**2
        self._given = Exchange(sizes | {"data": self.count})
        self.masses, self.inverse = self._given.arrays[4:6]  # data of M and of its inverse, of the last tangent
        self.room_address = self._given.at[6]

    def _address(self, values: np.ndarray, kind: Any = np.int64) -> int:
        """Where C finds integers."""
        self._kept.append(np.ascontiguousarray(values, kind))
        return address_of(self._kept[-1])

    def _pairs(self, product: Product) -> ctypes.Structure:
        places = (self._address(x) for x in (product.a, product.b, product.to))
        return ProductPairs(len(product.to), *places)

    @property
    def first(self) -> int:
        """The first of the levels."""
        return self.levels[0] if self.levels else 0

    @property
    def frozen_at(self) -> int | None:
        """Where C finds the U that a step keeps; None where it keeps none."""
        return address_of(self.frozen) if self.keeps_directions else None

    def directions(self, G: Array) -> Array:
        """Data of U for those of G."""
        return self.normal.data(self.inverse, G[self._across])

    @property
    def patterns(self) -> dict[str, Pattern]:
        """Those of a tangent, by its names."""
        c, low = self.couplings, self.low
        return {
            "J": c.turns, "M": c.masses, "G": c.rows, "U": self.normal.pattern, "by_q": low, "by_v": low, "by_a": low,
            "slopes": self.laws, "R": self.ties.rows,
        }  # fmt: skip

    def tangent(self, state: State, mult: Array) -> StepTangent | None:
        """The tangent at a state with all multipliers (n_mult,); None where it cannot be found."""
        given, states = self._given, self.states
        given.put(state.q, state.v, state.a, mult)
        states.anew = True
        length = self.couplings.system.length
        if not states.ask(states.implicit.driver_stage_tangent, self.address, length, state.t, *given.at):
            return None
        return self.parted(given.arrays[-1].copy())

    def parted(self, data: Array) -> StepTangent:
        """A tangent whose matrices are views of its data."""
        return StepTangent(**{name: data[part] for name, part in self.parts.items()})

    def data(self, tangent: StepTangent, out: Array) -> None:
        """Those of a tangent, in the order that C expects."""
        np.concatenate([getattr(tangent, name) for name in DATA], out=out)

    def turning(self, xi: Array, v: Array) -> tuple[Array, Array]:
        """d rate(xi, v) / d xi, and T with v = T rate(xi, v): data of their pattern."""
        J, T = np.empty((2, len(self.couplings.turns)))
        given = [np.ascontiguousarray(x) for x in (xi, v)]  # alive until C is done
        self.states.implicit.driver_stage_turning(self.states.address, *addresses_of((*given, J, T)))
        return J, T

    def weigh(self, M: Array) -> None:
        """Take the data of M, and of M^-1, body by body."""
        self.masses[:] = M
        of_body, out = self.couplings.of_body, self.inverse
        start = self.couplings.masses.start
        for width in {len(own) for own in of_body}:
            rows = np.array([own for own in of_body if len(own) == width])
            places = start[rows][..., None] + np.arange(width)
            out[places] = np.linalg.inv(M[places])
