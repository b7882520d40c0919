"""The matrix of an implicit step (:mod:`.pencil`) as a sparse one, of stages that have a tangent each.

With D = S - J and S the rates of all stages, d rate / d xi, the unknowns (dxi, dlambda, dmu, dtau, dN) have the columns

    by_q + (by_v + by_a S) D,      G^T,      (by_v + by_a S) U,      by_a U,      [R^T; -1]                          (1)

whose factors grow with the length of a chain. Where many joints meet at a body its moves U dmu and U dtau are unknowns too,
as in :mod:`...system.compiled.states.stage_patterns`. Rows that depend on each other are softened, as compiled factors do it
(lu.c): with the phase of their compliance by the masses, so that the two never cancel.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.linalg import SuperLU, splu

from ...errors import LinearSolveError
from ...rotations import Array
from ...system.mobility import SOFT
from ...system.sparsity import Pattern, Product, Total
from ...system.tangents.step_tangent import StepTangent, crowded
from ..redundancy import corrections
from ..residual import Judge
from .pencil import OPEN_ROWS, REFINED, SINGULAR_MATRIX

USED = "J", "M", "G", "U", "by_q", "by_v", "by_a", "R"  # of a tangent


class WholeStructure:
    """Where (1) of k ``stages`` has its entries; ``patterns``: of the tangent of one, by its names."""

    def __init__(self, patterns: Mapping[str, Pattern], stages: int) -> None:
        self.stages = k = stages
        self.patterns = of = {name: patterns[name].repeated(k) for name in USED}
        self.m, self.n = patterns["G"].shape
        self.ties, self.size = patterns["R"].shape[0], patterns["by_q"].shape[0]
        self.levels = (self.size - self.n - self.ties) // self.m if self.m else 0

        moved = np.arange(k * self.n)
        together = np.arange(k) * self.n + (moved % self.n)[:, None]
        self.rates = Pattern((len(moved), len(moved)), np.repeat(moved, k), together.ravel())
        self.D = Total(self.rates, of["J"])
        self.a = Product(of["by_a"], self.rates)
        self.va = Total(of["by_v"], self.a.pattern)
        self.moves = Product(self.va.pattern, self.D.pattern)
        # of multipliers on levels behind the first
        self.bears = bears = crowded(of["G"], of["M"])
        self.moving = (self.va.pattern, of["by_a"])[: max(self.levels - 1, 0)]
        self.across = [Product(x, of["U"], through=~bears) for x in self.moving]
        self.on_moves = [np.flatnonzero(bears[x.columns]) for x in self.moving]
        self.of_moves = np.flatnonzero(bears[of["U"].rows])
        self.bearing = int(bears.sum())  # moves of each level that are unknowns

    @cached_property
    def ends(self) -> list[int]:
        """Where columns of each level of multipliers begin, and those of ties."""
        return [self.stages * (self.n + i * self.m) for i in range(self.levels + 1)]

    def places(self, first: int, count: int, numbers: np.ndarray) -> np.ndarray:
        """Where rows stand among all, of which each stage has so many from a row of its own on."""
        return np.asarray(numbers // count * self.size + first + numbers % count if count else numbers)

    @cached_property
    def whole(self) -> Total:
        """Of (1), column by column, with softness of the rows of all levels before the ties."""
        of, n, m, k, ends = self.patterns, self.n, self.m, self.stages, self.ends
        across = [(self.places(0, n, of["G"].columns), of["G"].rows)][: self.levels]
        across += [(x.pattern.rows, x.pattern.columns) for x in self.across]
        soft = [(self.places(n + i * m, m, self.soft.rows), self.soft.columns) for i in range(self.levels)]
        efforts = np.arange(k * self.ties)
        tied = [
            (self.places(0, n, of["R"].columns), of["R"].rows),
            (self.places(self.size - self.ties, self.ties, efforts), efforts),
        ]

        parts = [(x.rows, x.columns) for x in (of["by_q"], self.moves.pattern)]
        for entries in (across, soft):
            parts += [(rows, end + columns) for (rows, columns), end in zip(entries, ends, strict=False)]
        parts += [(rows, ends[-1] + columns) for rows, columns in tied]

        number, first, U = np.cumsum(self.bears) - 1, ends[-1] + k * self.ties, of["U"]
        for i, (x, on) in enumerate(zip(self.moving, self.on_moves, strict=True)):
            at = first + i * self.bearing  # of rows too
            parts += [(x.rows[on], at + number[x.columns[on]]), (at + np.arange(self.bearing),) * 2]
            parts += [(at + number[U.rows[self.of_moves]], ends[i + 1] + U.columns[self.of_moves])]
        size = (first + len(self.moving) * self.bearing,) * 2
        return Total(*(Pattern(size, columns, rows) for rows, columns in parts))

    @cached_property
    def soft(self) -> Pattern:
        """Of what rows that depend on each other have on their multipliers, of each level."""
        k, m, rows = self.stages, self.m, np.arange(self.stages * self.m)
        together = np.arange(k) * m + (rows % max(m, 1))[:, None]
        return Pattern((len(rows), len(rows)), np.repeat(rows, k), together.ravel())


class WholePencil:
    """(1) for the rates S of k stages, (k, k); ``tangents``: the data of that of each.

    ``first``: level of the first rows; ``units``: of the multipliers of rows that depend on each other, (m,), None: none
    do; ``corrections``: of their solutions.
    """

    def __init__(
        self,
        structure: WholeStructure,
        tangents: list[StepTangent],
        S: Array,
        judge: Judge,
        *,
        first: int,
        units: Array | None,
        corrections: int,
    ) -> None:
        o = self.structure = structure
        self.judge, self.softened, self.corrections = judge, units is not None, corrections
        self.data = data = {name: np.concatenate([getattr(one, name) for one in tangents]) for name in o.patterns}
        rates = np.repeat(S, o.n, axis=0).ravel()
        self.D = o.D.data(rates, -data["J"])
        self.va = o.va.data(data["by_v"], o.a.data(data["by_a"], rates))

        # the columns of (1)
        moves = o.moves.data(self.va, self.D)
        gradients = [data["G"]] if o.levels else []
        across = [of.data(left, data["U"]) for of, left in zip(o.across, (self.va, data["by_a"]), strict=False)]
        self.softness = self._softness(S, first, units)
        efforts = -np.ones(o.stages * o.ties)
        moving = []  # columns of moves, and their rows
        for left, on in zip((self.va, data["by_a"]), o.on_moves, strict=False):
            moving += [left[on], np.ones(o.bearing), -data["U"][o.of_moves]]
        entries = o.whole.data(data["by_q"], moves, *gradients, *across, *self.softness, data["R"], efforts, *moving)
        self._factor(o.whole.pattern.matrix(entries).T.copy())  # its own entries, which are made fewer

    def _softness(self, S: Array, first: int, units: Array | None) -> list[Array]:
        """What rows that depend on each other have on their multipliers, level by level, by the masses."""
        o = self.structure
        if units is None:
            return [np.zeros(len(o.soft))] * o.levels
        M, G = o.patterns["M"], o.patterns["G"]
        masses = np.bincount(M.rows, np.where(M.rows == M.columns, self.data["M"], 0.0), M.shape[0])
        moved = np.where(masses > 0, 1.0 / np.where(masses > 0, masses, 1.0), 0.0)  # by a force of one

        # a share of what moves most, in the units of the multipliers
        squares = np.tile(units, o.stages) ** 2
        softest = (squares * G.times(self.data["G"] ** 2, moved[None])[0]).max(initial=0.0)
        soft = (SOFT * softest / squares)[o.soft.columns]
        compliance = -np.linalg.matrix_power(np.linalg.inv(S), 2 - first)
        of_first = np.repeat(compliance, o.m, axis=0).ravel() * soft
        of_others = np.where(o.soft.rows == o.soft.columns, soft, 0.0)
        return [of_first, *[of_others] * (o.levels - 1)]

    def _factor(self, K: Any) -> None:
        judge = self.judge
        K.eliminate_zeros()
        if not np.isfinite(K.data).all():
            raise LinearSolveError(f"{judge.what}: the matrix is not finite.")
        self.rows, self.columns = _equilibrate(K)
        self.matrix = K
        try:
            self.lu: SuperLU = splu(K)
        except RuntimeError as error:
            raise LinearSolveError(f"{judge.what}: {SINGULAR_MATRIX}") from error

    def solve(self, kin: Array, low: Array) -> tuple[Array, Array]:
        """As :meth:`.Pencil.solve` of all stages: increments dxi, dv side by side, (k, 2 n), and multipliers (k, ..)."""
        o, low, kin = self.structure, low.ravel(), kin.ravel()
        rhs = np.zeros(len(self.rows))
        rhs[: len(low)] = low + o.va.pattern.times(self.va, kin[None])[0]
        rhs *= -self.rows
        y = self._back(rhs)
        left, size = self._left(rhs, y, o.size)
        if left > REFINED * size:
            y = y + self._back(rhs - self.matrix @ y)
            left, size = self._left(rhs, y, o.size)
        for times in corrections(self.corrections):
            y = y + self._back(times * self._open(y))
        if self.softened:  # rows that contradict each other stay open
            left, size = self._left(rhs, y, o.n)
            if left > REFINED * size:
                missing = rhs - self.matrix @ y
                missing[: len(low)].reshape(o.stages, -1)[:, o.n :] = 0.0
                y = y + self._back(missing)
                left, size = self._left(rhs, y, o.n)
        self.judge.check(left, size, OPEN_ROWS)

        k, n, m = o.stages, o.n, o.m
        z = self.columns * y
        dxi, by_level = z[: k * n], z[k * n : k * (n + o.levels * m)].reshape(o.levels, k, m)
        dv = o.D.pattern.times(self.D, dxi[None])[0] + kin
        if o.levels > 1:
            dv = dv + o.patterns["U"].times(self.data["U"], by_level[1].reshape(1, -1))[0]
        change = np.concatenate((dxi.reshape(k, n), dv.reshape(k, n)), axis=1)
        efforts = z[o.ends[-1] : o.ends[-1] + k * o.ties].reshape(k, o.ties)
        return change, np.concatenate((*by_level, efforts), axis=1)

    def _open(self, y: Array) -> Array:
        """By what softness leaves rows open."""
        o, every_row = self.structure, np.zeros(len(self.rows))
        open_rows = every_row[: o.stages * o.size].reshape(o.stages, o.size)
        every = (self.columns * y)[o.ends[0] : o.ends[-1]].reshape(o.levels, -1)
        for i, (soft, one) in enumerate(zip(self.softness, every, strict=True)):
            open_rows[:, o.n + i * o.m : o.n + (i + 1) * o.m] = o.soft.times(soft, one[None])[0].reshape(o.stages, o.m)
        return np.asarray(self.rows * every_row)

    def _back(self, b: Array) -> Array:
        return np.asarray(self.lu.solve(b.astype(self.matrix.dtype)))

    def _left(self, rhs: Array, y: Array, rows: int) -> tuple[float, float]:
        """Largest residual of the first rows of each stage, and its scale."""
        o = self.structure
        left = np.abs(self.matrix @ y - rhs)[: o.stages * o.size].reshape(o.stages, -1)[:, :rows]
        size = np.abs(rhs).max(initial=0.0) + np.abs(y).max(initial=0.0)
        return float(left.max(initial=0.0)), float(size)


def _equilibrate(K: Any) -> tuple[Array, Array]:
    """Scale the rows and columns of a matrix so that all largest entries are near one, by powers of two, which are returned."""
    A, at = np.abs(K.data), (K.indices, np.repeat(np.arange(K.shape[1]), np.diff(K.indptr)))
    scales = np.ones(K.shape[0]), np.ones(K.shape[1])
    for side, root in ((0, 2), (1, 2), (0, 2), (1, 2), (0, 1)):
        most = np.zeros(K.shape[side])
        np.maximum.at(most, at[side], A)
        share = np.exp2(np.rint(np.log2(np.where(most > 0, most, 1.0)) / root))
        A = A / share[at[side]]
        scales[side][:] /= share
    K.data *= scales[0][at[0]] * scales[1][at[1]]
    return scales
