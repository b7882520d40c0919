"""Constraints of a user's own on coordinates of his own, as a kind between points: what compiled steps know of them.

The coordinates p of a body are those of points that move with it, d of them each. A row g(p, t) is then one of several points,

    dg/dt = G . p' + g_t,    G = dg/dp                                                                       (1)

Rows that are formulas have compiled kernels; of others Python is asked for g and G of all rows by one call, for g_t and the rest
of g'' by another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ..kinds.derivation import DRIVE
from ..kinds.expressions import ZERO, Program
from ..kinds.frames import symbolic_frames
from ..kinds.own import OwnTerm, term_of_points
from ..kinds.python_kinds import Answers, At, PythonKind
from .port_constraint import PortConstraint

ROUNDOFF = 1e-9  # of the terms of a value, by which a formula may differ from its function


@dataclass(frozen=True, eq=False)
class PortKind(PythonKind):
    """The kind of the rows of one constraint, between as many points as its body needs."""

    law: PortConstraint = None  # type: ignore[assignment]

    def _numbers(self, at: At, first: int) -> Array:
        """Coordinates of the body, by where the places of its points begin in their frames, or their rates, (n,)."""
        return np.concatenate([f[first : first + self.dim] for f in at[:-2]])[: len(self.entries)]

    def _rows(self, at: At, t: float) -> Array:
        p = self._numbers(at, 0)
        return np.column_stack((self.law.values(p, t), self.law.jacobian(p, t)))

    def _in_time(self, at: At, t: float) -> Array:
        return np.append(1.0, self.law.rate(self._numbers(at, 0), t))

    def _second(self, at: At, t: float, moves: bool) -> Array:
        return self.law.gamma(self._numbers(at, 0), self._numbers(at, self.dim + self.dim**2), t)


def points_of(n: int, dim: int) -> int:
    """How many points have n coordinates."""
    return -(-n // dim)


def formulas_of(law: PortConstraint, start: Array, dim: int) -> list[tuple[OwnTerm, list[int]]]:
    """The rows of a constraint that symbols pass, and the points of each; none where they do not, or tell something else than
    numbers where it starts, and none where derivatives are given, which are asked.
    """
    if law.derivatives_given:
        return []
    n, count = len(start), points_of(len(start), dim)
    symbols = [x for frame in symbolic_frames(count, dim) for x in frame.x][:n]
    places = np.append(start, np.zeros(count * dim - n)).reshape(count, dim)
    raw: Any = law.raw
    try:
        found: Any = np.ravel(raw(np.array(symbols, dtype=object), DRIVE))
        terms = [term_of_points(f'The constraint of body "{law.name}"', y, dim, count) for y in found]
        rows = [_at(term, places[points]) for term, points in terms]
    except Exception:  # a function of numbers alone
        return []

    wanted = law.values(start, 0.0)
    if len(rows) != len(wanted) or not all(term.kind.entries for term, _ in terms):
        return []
    # what roundoff of the terms may do to their sum
    told, rough = np.transpose([(row[0], np.abs(row[1:]).max() * np.abs(start).max()) for row in rows])
    return terms if (np.abs(told - wanted) <= ROUNDOFF * (np.abs(wanted) + rough)).all() else []


def _at(term: OwnTerm, places: Array) -> Array:
    """The value and the row of a formula with its points at some places at time 0."""
    symbols = [x for frame in symbolic_frames(*places.shape) for x in frame.x]
    given = {x.arguments[0]: float(value) for x, value in zip([*symbols, DRIVE], [*places.ravel(), 0.0], strict=True)}
    numbers = {f"P_own_{i}": x for i, x in enumerate(term.constants.get("own", ()))}
    return np.array(Program(term.kind.outputs["value"])(given | numbers), dtype=float)


def port_kind(law: PortConstraint, n: int, dim: int) -> PortKind:
    """The kind of a constraint on n coordinates, in a scene of ``dim`` dimensions."""
    points, twist = points_of(n, dim), 3 * (dim - 1)
    entries = tuple(twist * (k // dim) + k % dim for k in range(n))
    constants = {"component": 1, "drive": 1, "drive1": 1, "drive2": 1}
    outputs = {"value": [ZERO] * (1 + n), "rates": [ZERO] * 2, "tangent": []}
    frames: Any = (None,) * points
    return PortKind(
        "own_rows", dim, constants, entries, (), outputs, [], frames, function=Answers(), between=points, law=law
    )
