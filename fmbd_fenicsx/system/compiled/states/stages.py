"""The stage systems of implicit steps in the driver (stages.c): sparse derivatives, factors of all frequencies, increments.

With frequencies s, K = K0 + s K1 + s^2 K2, symbols as in linear/saddle/pencil.py:

    K0 = [by_q - by_v J, G^T, by_v U],     K1 = [by_v - by_a J, 0, by_a U],     K2 = [by_a, 0, 0]                    (1)
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ....rotations import Array
from ...sparsity import Pattern, Product
from ..tables.structures import address_of, enumeration, zeros_of
from .couplings import Couplings

if TYPE_CHECKING:
    from .evaluation import DriverStates

SIZE = enumeration("DONE")["SIZE"]  # a verdict: no room
FILLED = 4  # entries of L, and of U, over those of K, that there is room for at first
_INT, _LONG, _POINTER, _REAL = ctypes.c_int, ctypes.c_long, ctypes.c_void_p, ctypes.c_double


class SparseRows(ctypes.Structure):
    """``Sparse`` of stages.c."""

    _fields_ = (("rows", _INT), ("start", _POINTER), ("on", _POINTER), ("data", _POINTER))


class Lower(ctypes.Structure):
    """``Lower`` of stages.c."""

    _fields_ = tuple((name, _POINTER) for name in "L_start U_start L_row U_row place L U pivot".split())


NUMBERS = "n m size levels frequencies points first".split()
MATRICES = "by_v by_a J U W".split()
POINTS = "t q0 xi rate v vd mult couple inverse vectors kin low dxi dv dmult push weigh moved judged local".split()


class Stages(ctypes.Structure):
    """``Stages`` of stages.c."""

    _fields_ = (
        *((name, _INT) for name in NUMBERS),
        *((name, _POINTER) for name in "start row order".split()),
        *((name, _LONG) for name in "entries room".split()),
        *((name, _POINTER) for name in "K0 K1 K2 s A scales sizes lower x right mixed stack mark found next".split()),
        *((name, SparseRows) for name in MATRICES),
        *((name, _POINTER) for name in POINTS),
        ("relax", _REAL),
    )


@dataclass(frozen=True)
class SparseTangent:
    """Data of the coefficients of (1) in the order of their patterns: J, M, G, U, and derivatives of the lower rows."""

    J: Array
    M: Array
    G: Array
    U: Array
    by_q: Array
    by_v: Array
    by_a: Array


@dataclass(frozen=True)
class Rule:
    """How points hang together: d rate / d xi (k, k), what decouples the points, (p, k) and (k, p); ``relax``: of increments."""

    couple: Array
    inverse: Array
    vectors: Array
    relax: float = 1.0


class StageStructure:
    """Patterns of the equations of a step whose constraints hold on some levels, 0 and 1; and of (1), by columns."""

    def __init__(self, couplings: Couplings, states: DriverStates, levels: tuple[int, ...]) -> None:
        self.couplings, self.states, self.levels = couplings, states, levels
        n, m, count = couplings.n, couplings.m, len(levels)
        self.n, self.m, self.size = n, m, n + count * m
        G, balance, offsets = couplings.rows, couplings.balance, n + m * np.arange(count)

        rows, columns = (
            [balance.rows, *(at + G.rows for at in offsets)],
            [balance.columns, *(G.columns for _ in levels)],
        )
        self.low = Pattern.of((self.size, n), np.concatenate(rows), np.concatenate(columns))
        self.of_level = [self.low.places(at + G.rows, G.columns) for at in offsets]
        self.of_masses = self.low.places(couplings.masses.rows, couplings.masses.columns)

        across, self._across = G.transposed()
        self.normal = Product(couplings.masses, across)
        self.turned = Product(self.low, couplings.turns, within=self.low)
        self.crossed = Product(self.low, self.normal.pattern)
        blocks = [self.low, across, self.crossed.pattern][: 1 + count]
        self._lay_out(blocks, [0, n, n + m])

        unknowns = [np.arange(n)[:, None], n + np.arange(m)[:, None] + m * np.arange(count)]
        each = [*unknowns[0], *unknowns[1]]
        self.order = np.concatenate([each[x] for x in couplings.order]).astype(np.int32)

    def _lay_out(self, blocks: list[Pattern], offsets: list[int]) -> None:
        """K of blocks side by side from these columns on: by columns, and where its entries stand among those of the blocks."""
        rows = np.concatenate([block.rows for block in blocks])
        columns = np.concatenate([block.columns + at for block, at in zip(blocks, offsets, strict=False)])
        self.taken = np.lexsort((rows, columns))
        self.row = rows[self.taken].astype(np.int32)
        self.start = np.searchsorted(columns[self.taken], np.arange(self.size + 1)).astype(np.int32)

    @property
    def patterns(self) -> dict[str, Pattern]:
        """Those of a tangent, by its names."""
        c, low = self.couplings, self.low
        return {
            "J": c.turns, "M": c.masses, "G": c.rows, "U": self.normal.pattern, "by_q": low, "by_v": low, "by_a": low,
        }  # fmt: skip

    @property
    def multiplied(self) -> dict[str, Pattern]:
        """Those of matrices that C multiplies with."""
        return {name: (self.patterns | {"W": self.couplings.masses})[name] for name in MATRICES}

    def powers(self, T: SparseTangent) -> tuple[Array, Array, Array]:
        """K0, K1 and K2."""
        parts: tuple[list[Array], ...] = (
            [T.by_q - self.turned.data(T.by_v, T.J)],
            [T.by_v - self.turned.data(T.by_a, T.J)],
            [T.by_a],
        )
        if self.levels:
            across = T.G[self._across]
            for part, data in zip(parts, (across, 0.0 * across, 0.0 * across), strict=True):
                part.append(data)
        if len(self.levels) > 1:
            crossed = [self.crossed.data(x, T.U) for x in (T.by_v, T.by_a)]
            for part, data in zip(parts, (*crossed, 0.0 * crossed[0]), strict=True):
                part.append(data)
        K0, K1, K2 = (np.concatenate(part)[self.taken] for part in parts)
        return K0, K1, K2

    def normals(self, inverse_mass: Array, G: Array) -> Array:
        """The data of U = M^-1 G^T."""
        return self.normal.data(inverse_mass, G[self._across])

    def inverse_masses(self, M: Array) -> Array:
        """The data of M^-1, body by body."""
        of_body, out = self.couplings.of_body, np.empty(len(M))
        start = self.couplings.masses.start
        for width in {len(own) for own in of_body}:
            rows = np.array([own for own in of_body if len(own) == width])
            places = start[rows][..., None] + np.arange(width)
            out[places] = np.linalg.inv(M[places])
        return out


def _by_rows(pattern: Pattern, data: int) -> SparseRows:
    """A matrix of a pattern with its data at an address."""
    return SparseRows(pattern.shape[0], address_of(pattern.start), address_of(pattern.on), data)


class StageRoom:
    """Room in C for the factors of p frequencies and for k points."""

    def __init__(self, structure: StageStructure, frequencies: int, points: int) -> None:
        states = structure.states
        self.structure, self.states = structure, states
        n, m, size, entries = structure.n, structure.m, structure.size, len(structure.row)
        p, k, multipliers = frequencies, points, size - structure.n
        self.kept: list[Any] = [structure]
        c = self.c = Stages(
            n=n, m=m, size=size, levels=len(structure.levels), frequencies=p, points=k, entries=entries,
            first=structure.levels[0] if structure.levels else 0,
            start=address_of(structure.start), row=address_of(structure.row), order=address_of(structure.order), relax=1.0,
        )  # fmt: skip
        sizes: dict[str, int | tuple[int, ...]] = {
            "K0": entries, "K1": entries, "K2": entries, "s": (p, 2), "A": (p, 2 * entries), "scales": (p, 2, size),
            "sizes": entries,
            "x": 2 * size, "right": (4, 2 * size), "mixed": 6 * n + 4 * size,
            "t": k, "q0": states.tables.system.n_q, "xi": (k, n), "rate": (k, n), "v": (k, n), "vd": (k, n),
            "mult": (k, max(multipliers, m)), "couple": (k, k), "inverse": (p, k, 2), "vectors": (k, p, 2), "kin": (k, n),
            "low": (k, size), "dxi": (k, n), "dv": (k, n), "dmult": (k, max(multipliers, 1)), "push": (k, n), "weigh": (3, n),
            "moved": 6, "judged": 2, "local": states.tables.system.n_q + n,
        }  # fmt: skip
        sizes |= {name: len(pattern) for name, pattern in structure.multiplied.items()}
        made = zeros_of(sizes)
        self.arrays = {name: x for name, (x, _) in made.items()}
        for name, (_, address) in made.items():
            setattr(c, name, address if name not in MATRICES else _by_rows(structure.multiplied[name], address))
        self.moved, self.judged = self.arrays["moved"], self.arrays["judged"]
        for name in ("mult", "dmult"):
            self.arrays[name] = self.arrays[name].reshape(-1)[: k * multipliers].reshape(k, multipliers)
        for name in ("stack", "mark", "found"):
            setattr(c, name, self._integers(size, np.int32))
        c.next = self._integers(size, np.int64)
        self.address, self._room = ctypes.addressof(c), FILLED * entries + 2 * size
        self._make_room()

    def _integers(self, count: int, kind: Any) -> int:
        made = np.zeros(max(count, 1), kind)
        self.kept.append(made)
        return address_of(made)

    def _make_room(self) -> None:
        """Room for L and U."""
        size, room, p = self.structure.size, self._room, self.c.frequencies
        self._numbers = [np.empty(2 * count) for _ in range(p) for count in (room, room, size)]
        self._indices = [np.empty(room, np.int32) for _ in range(2 * p)]
        self.lower = (Lower * p)()
        for f, one in enumerate(self.lower):
            one.L_start, one.U_start = (self._integers(size + 1, np.int64) for _ in range(2))
            one.place = self._integers(size, np.int32)
            one.L_row, one.U_row = (address_of(x) for x in self._indices[2 * f : 2 * f + 2])
            one.L, one.U, one.pivot = (address_of(x) for x in self._numbers[3 * f : 3 * f + 3])
        self.c.room, self.c.lower = room, ctypes.addressof(self.lower)

    def factor(self, tangent: SparseTangent, s: Array) -> bool:
        """The factors of the frequencies s (p,); False where K is singular, or not finite."""
        for name, data in zip(("K0", "K1", "K2"), self.structure.powers(tangent), strict=True):
            self.arrays[name][:] = data
        self.arrays["s"][:, 0], self.arrays["s"][:, 1] = s.real, s.imag
        for name, data in (("by_v", tangent.by_v), ("by_a", tangent.by_a), ("J", tangent.J), ("U", tangent.U)):
            self.arrays[name][:] = data

        while (verdict := self.states.library.driver_stage_factors(self.address)) == SIZE:
            self._room *= 2
            self._make_room()
        return not verdict

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array, Array]:
        """Increments dxi, dv side by side and multipliers, a row for each of the first frequencies; residuals and scales."""
        p, n, multipliers = len(kin), self.structure.n, self.structure.size - self.structure.n
        given = [np.ascontiguousarray(x, dtype=complex) for x in (kin, low)]
        change, mult, judged = np.empty((p, 2 * n), complex), np.empty((p, multipliers), complex), np.empty((p, 2))
        places = [address_of(x) for x in (*given, change, mult, judged)]
        self.states.library.driver_stage_solve(self.address, p, *places)
        return change, mult, judged

    def put(self, t: Array, q0: Array, points: Any, inverse_mass: Array, given: tuple[Rule, Array]) -> None:
        """Points about q0 at the times t (k,), data of W, the rule, and weights of increments (3, n)."""
        rule, weights = given
        x = self.arrays
        x["t"][:], x["q0"][:], x["weigh"][:] = t, q0, weights
        x["xi"][:], x["rate"][:], x["v"][:], x["vd"][:] = points.xi, points.rate, points.v, points.vd
        x["mult"][:], x["couple"][:] = points.mult, rule.couple
        for name, mixing in (("inverse", rule.inverse), ("vectors", rule.vectors)):
            x[name][..., 0], x[name][..., 1] = mixing.real, mixing.imag
        self.c.relax = rule.relax
        x["W"][:] = inverse_mass

    def points(self) -> tuple[Array, ...]:
        """xi, its rate, v, its rate and multipliers of the points, the caller's own."""
        return tuple(self.arrays[name].copy() for name in ("xi", "rate", "v", "vd", "mult"))

    @property
    def left(self) -> Array:
        """What the last point left of the first rows, (m,)."""
        n, m = self.structure.n, self.structure.m
        return self.arrays["low"][-1, n : n + m] if self.structure.levels else np.zeros(m)

    def increment(self) -> bool:
        """One increment of the points that stand in the arrays; False where NumPy has something to say."""
        self.states.anew = True
        return self.states.ask(self.states.library.driver_stage_increment, self.address)
