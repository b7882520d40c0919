"""Rows of contacts in one configuration: gaps and their derivatives, and where candidates stand without these.

For a candidate point j of a slave with world position x_j and an obstacle with pose (r_o, R_o) and signed
distance d,

    g_j = d(R_o^T (x_j - r_o)) - radius,   n_j = R_o grad d,   g_j' = n_j . (x_j' - obstacle's velocity)   (1)

The derivative with respect to velocities is the matrix N; forces Lambda >= 0 on the candidates enter the balance as
-N^T Lambda. Rows of tangents have the same form; with friction they stand behind the normal row of their candidate.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...rotations import Array, tangents_of
from .nodal_rows import NodalRows


@dataclass(frozen=True)
class LinearRows:
    """Rows on velocities: ``core`` (m, n_core) and, for each trace, ``field``; those of a :class:`ModalTrace` see no node, as it
    acts on the core.
    """

    core: Array
    field: tuple[NodalRows, ...]

    def take(self, rows: np.ndarray) -> LinearRows:
        """Some of the rows."""
        return LinearRows(self.core[rows], tuple(f.take(rows) for f in self.field))


@dataclass(frozen=True)
class Rows:
    """All candidates: gap (m,) m, rows L (m c, ..) of normals, with friction each with its tangents behind it, laws.

    ``normal`` (m, d): from the obstacle to the slave, world axes; ``drift`` (m, d - 1) m: tangential motion
    of prescribed obstacles, along a ``way``; ``trace`` (m,): number of the trace that carries the multiplier, -1
    for a rigid point.
    """

    gap: Array
    L: LinearRows
    friction: Array
    restitution: Array
    normal: Array
    drift: Array
    trace: np.ndarray

    @property
    def components(self) -> int:
        """Rows of a candidate: 1, or with friction one for each direction."""
        return 1 + self.drift.shape[1]

    @cached_property
    def N(self) -> LinearRows:
        """Rows of the normals."""
        c = self.components
        return self.L if c == 1 else self.L.take(c * np.arange(len(self.gap)))

    def take(self, rows: np.ndarray) -> Rows:
        """Some of the candidates."""
        numbers = rows if self.components == 1 else in_turn(np.arange(len(self.gap))[rows], self.components)
        return Rows(
            gap=self.gap[rows],
            L=self.L.take(numbers),
            friction=self.friction[rows],
            restitution=self.restitution[rows],
            normal=self.normal[rows],
            drift=self.drift[rows],
            trace=self.trace[rows],
        )


@dataclass(frozen=True)
class Touch:
    """Where a pair stands, without derivatives: gap (m,), points x and normals (m, d).

    ``relative`` (m, d): position against the master, in the obstacle's axes or as the vector between two surfaces.
    ``true_gap``: where the step's constraint differs from the geometric gap (see ``mechanics.contact.mortar``),
    the latter.
    """

    gap: Array
    x: Array
    normal: Array
    relative: Array
    true_gap: Array | None = None

    @property
    def geometric(self) -> Array:
        """Geometric gap, m."""
        return self.gap if self.true_gap is None else self.true_gap


def in_turn(rows: np.ndarray, count: int) -> np.ndarray:
    """Numbers of ``count`` rows for each of some, one after the other."""
    return rows if count == 1 else (rows[:, None] * count + np.arange(count)).ravel()


def stacked(parts: list[Rows]) -> Rows:
    """Rows of all pairs, one after the other."""
    if len(parts) == 1:
        return parts[0]

    def join(linears: list[LinearRows]) -> LinearRows:
        n = len(linears[0].field)
        return LinearRows(
            np.concatenate([x.core for x in linears]),
            tuple(NodalRows.stacked([x.field[i] for x in linears]) for i in range(n)),
        )

    return Rows(
        gap=np.concatenate([p.gap for p in parts]),
        L=join([p.L for p in parts]),
        friction=np.concatenate([p.friction for p in parts]),
        restitution=np.concatenate([p.restitution for p in parts]),
        normal=np.concatenate([p.normal for p in parts]),
        drift=np.concatenate([p.drift for p in parts]),
        trace=np.concatenate([p.trace for p in parts]),
    )


def directions_of(normal: Array, *, frictional: bool) -> Array:
    """Each normal (m, d), with friction and the unit vectors across it, (m, 1 or d, d)."""
    if not frictional:
        return normal[:, None]
    return np.concatenate([x[:, None] for x in (normal, *tangents_of(normal))], axis=1)
