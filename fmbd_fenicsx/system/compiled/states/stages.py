"""The stage systems of implicit steps in the driver (stages.c): factors of all frequencies, increments."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ....kernel_cache import address_of, addresses_of
from ....rotations import Array
from ...sparsity import Pattern
from ...tangents.step_tangent import StepTangent
from ..declarations import enumeration, structure_of
from ..tables.structures import Sizes, zeros_of
from .evaluation import DriverStates
from .stage_patterns import StageStructure

SIZE = enumeration("DONE")["SIZE"]  # a verdict: no room
CLOSING = enumeration("CONJUGATE")["CLOSING"]
ENDINGS = enumeration("MOST_STAGES")["ENDINGS"]  # of steps that rates are made of, at most
FILLED = 4  # entries of L, and of U, over those of K, that there is room for at first


Sparse, Lower = structure_of("implicit/stages.c", "Sparse"), structure_of("implicit/stages.c", "Lower")
Stages = structure_of("implicit/stages.c", "Stages", Sparse=Sparse)
MATRICES = "by_v by_a J U R".split()  # of a tangent, that C multiplies with
POINTS = "t q0 xi rate v vd mult couple inverse vectors past ends kin low dxi dv dmult push".split()
POINTS += "sampled weigh moved judged local".split()


@dataclass(frozen=True)
class StageRule:
    """How points hang together: d rate / d xi (k, k), what decouples the points, (p, k) and (k, p); ``relax``: of increments;
    ``past``: d rate / d values where steps have ended, at the times ``ends`` (l,), the newest first, (k, l).
    """

    couple: Array
    inverse: Array
    vectors: Array
    relax: float = 1.0
    past: Array = field(default_factory=lambda: np.zeros((0, 0)))
    ends: Array = field(default_factory=lambda: np.zeros(0))


class PointRoom:
    """The points of an implicit step in ``arrays`` of the structure ``c``, a :class:`Stages`."""

    c: Any
    arrays: dict[str, Array]
    address: int
    states: DriverStates

    def of_tangents(self) -> dict[str, int | None]:
        """Addresses of what whole steps take tangents with, by their names in implicit.c."""
        return {}

    def _count_moving(self) -> None:
        """Tell of what norms take means, see :attr:`.Twin.kinds`."""
        self._kinds = ends, counts = self.states.twin.kinds
        self.c.kinds, self.c.kind_end, self.c.counted = len(ends), address_of(ends), address_of(counts)

    def lend(self, rule: StageRule, weights: Array) -> None:
        """The rule, and weights of increments (3, n)."""
        x = self.arrays
        x["couple"][:], x["weigh"][:] = rule.couple, weights
        self.c.behind = len(rule.ends)
        x["past"][: rule.past.size], x["ends"][: len(rule.ends)] = rule.past.ravel(), rule.ends
        for name, mixing in (("inverse", rule.inverse), ("vectors", rule.vectors)):
            x[name][..., 0], x[name][..., 1] = mixing.real, mixing.imag
        self.c.relax = rule.relax

    @property
    def shared(self) -> int:
        """Frequencies that points have a share in: all but one that filters errors only."""
        return int(self.arrays["inverse"].any(axis=(1, 2)).sum())


def _by_rows(pattern: Pattern, data: int) -> ctypes.Structure:
    """A matrix of a pattern with its data at an address."""
    return Sparse(pattern.shape[0], address_of(pattern.start), address_of(pattern.on), data)


class StageRoom(PointRoom):
    """Room in C for the factors of p frequencies and for k points."""

    def __init__(self, structure: StageStructure, frequencies: int, points: int) -> None:
        states = structure.states
        self.structure, self.states = structure, states
        n, m, size, entries, every = structure.n, structure.m, structure.size, len(structure.row), structure.all
        p, k, multipliers = frequencies, points, size - structure.n
        self.kept: list[Any] = [structure]
        self._units = structure.couplings.system.multiplier_units

        c = self.c = Stages(
            n=n, m=m, size=size, all=every, levels=len(structure.levels), frequencies=p, points=k, entries=entries,
            frames=states.tables.system.motions.n_twist * len(states.tables.system.frame_names),
            pulls=structure.pulls, frozen=structure.frozen_at,
            first=structure.first, ties=structure.ties.address,
            start=address_of(structure.start), row=address_of(structure.row), order=address_of(structure.order), relax=1.0,
        )  # fmt: skip

        sizes: Sizes = {
            "K0": entries, "K1": entries, "K2": entries, "s": (p, 2), "A": (p, 2 * entries), "scales": (p, 2, every),
            "sizes": entries, "blocks": entries, "data": structure.count,
            "softness": m, "soft": (p, 2 * size), "faint": (2 * (CLOSING + 1), multipliers),
            "x": 2 * every, "right": (4, 2 * every), "mixed": 6 * n + 4 * size,
            "t": k, "q0": states.tables.system.n_q, "xi": (k, n), "rate": (k, n), "v": (k, n), "vd": (k, n),
            "mult": (k, max(multipliers, m)), "couple": (k, k), "inverse": (p, k, 2), "vectors": (k, p, 2), "past": k * ENDINGS,
            "ends": ENDINGS, "kin": (k, n), "low": (k, size), "dxi": (k, n), "dv": (k, n), "dmult": (k, max(multipliers, 1)),
            "push": (2 * k, n), "weigh": (3, n),
            "sampled": (k, states.calls.written),
            "moved": 6, "judged": 2, "local": states.tables.system.n_q + 2 * n,
            "given": k * (n + size) + n + states.tables.system.n_q,
        }  # fmt: skip

        made = zeros_of(sizes)
        self.arrays = {name: x for name, (x, _) in made.items()}
        self.data, self._data_at = made.pop("data")
        for name, (_, address) in made.items():
            setattr(c, name, address)

        c.W = _by_rows(structure.couplings.masses, address_of(structure.inverse))
        for name in MATRICES:
            first = structure.parts[name].start
            setattr(c, name, _by_rows(structure.patterns[name], self._data_at + 8 * first))
        c.slopes = self._data_at + 8 * structure.parts["slopes"].start

        self.tangent = structure.parted(self.data)  # of the factors
        self.judged = self.arrays["judged"]
        for name in ("mult", "dmult"):
            self.arrays[name] = self.arrays[name].reshape(-1)[: k * multipliers].reshape(k, multipliers)

        for name in ("stack", "mark", "found"):
            setattr(c, name, self._integers(every, np.int32))
        c.next = self._integers(every, np.int64)
        self._count_moving()
        self.address, self._room = ctypes.addressof(c), FILLED * entries + 2 * every
        self._make_room()

    def _integers(self, count: int, kind: Any) -> int:
        made = np.zeros(max(count, 1), kind)
        self.kept.append(made)
        return address_of(made)

    def _make_room(self) -> None:
        """Room for L and U of each frequency."""
        size, room = self.structure.all, self._room
        self.lower = (Lower * self.c.frequencies)()
        self._factors: list[np.ndarray] = []  # that C writes
        for one in self.lower:
            numbers = [np.empty(2 * count) for count in (room, room, size)]
            rows = [np.empty(room, np.int32) for _ in range(2)]
            self._factors += numbers + rows
            one.L, one.U, one.pivot = map(address_of, numbers)
            one.L_row, one.U_row = map(address_of, rows)
            one.L_start, one.U_start = (self._integers(size + 1, np.int64) for _ in range(2))
            one.place = self._integers(size, np.int32)
        self.c.room, self.c.lower = room, ctypes.addressof(self.lower)

    def of_tangents(self) -> dict[str, int | None]:
        """As of all points."""
        o = self.structure
        masses = address_of(o.masses)
        of_rows = np.zeros(len(o.couplings.rows))
        self.kept.append(of_rows)
        return {
            "patterns": o.address,
            "data": self._data_at,
            "masses": masses,
            "room": o.room_address,
            "directions": address_of(of_rows),
        }

    def let_depend(self, *, redundant: int) -> None:
        """Say whether rows depend on each other, and how many corrections solutions take then."""
        self.c.units, self.c.corrections = address_of(self._units) if redundant else None, redundant

    @property
    def frequencies(self) -> Array:
        """Those of the factors, complex where one is."""
        s = self.arrays["s"]
        return s[:, 0] + 1j * s[:, 1] if s[:, 1].any() else s[:, 0].copy()

    def factor(self, tangent: StepTangent, s: Array, *, redundant: int) -> bool:
        """The factors of the frequencies s (p,); False where K is singular, or not finite. ``redundant``: corrections of rows
        that depend.
        """
        self.let_depend(redundant=redundant)
        structure = self.structure
        structure.data(tangent, self.data)
        self.arrays["s"][:, 0], self.arrays["s"][:, 1] = s.real, s.imag
        factors = self.states.implicit.driver_stage_factors
        while (verdict := factors(self.address, structure.address, self._data_at)) == SIZE:
            self._room *= 2
            self._make_room()
        return not verdict

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array, Array]:
        """Increments dxi, dv side by side and multipliers, a row for each of the first frequencies; residuals and scales."""
        p, n, multipliers = len(kin), self.structure.n, self.structure.size - self.structure.n
        given = [np.ascontiguousarray(x, dtype=complex) for x in (kin, low)]
        change, mult, judged = np.empty((p, 2 * n), complex), np.empty((p, multipliers), complex), np.empty((p, 2))
        self.states.implicit.driver_stage_solve(self.address, p, *addresses_of((*given, change, mult, judged)))
        return change, mult, judged
