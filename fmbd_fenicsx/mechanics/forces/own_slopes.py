"""Slopes of a law of the motions of one or two markers by the formulas that it writes, where it takes symbols.

The law is asked once with symbols for x, R, v and w of its markers. What it returns is differentiated along their displacements
and velocities, a small turn theta being dR = theta x R. A law with cases, tables or other libraries writes no formulas; one
whose numbers are changed from outside writes others later, which its values show.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ...rotations import Array
from ..kinds.expressions import Expression, Program, as_expression, gradient, passing, symbol
from ..kinds.frames import Vector, cross
from .force_elements import MarkerMotion

SEEN = ("x", "R", "v", "w")
TIME = symbol("t")


@dataclass(frozen=True)
class WrenchFormula:
    """Force and torque of a law of ``sides`` markers, (n,), and their slopes, one row after the other."""

    program: Program
    names: Sequence[str]
    sides: int

    def __call__(self, t: float, motions: Sequence[MarkerMotion]) -> tuple[Array, Array] | None:
        """Force and torque (n,), derivatives by displacements and by velocities (2, n, sides n); None without finite ones."""
        seen = [np.ravel(getattr(x, name)) for x in motions for name in SEEN]
        given = dict(zip(self.names, np.concatenate(seen).tolist(), strict=True))
        try:
            found = self.program({**given, "t": t})
        except (ArithmeticError, ValueError):
            return None
        if not isfinite(sum(found)):
            return None
        n = len(motions[0].v) + len(motions[0].w)
        table = np.reshape(found, (n, 1 + 2 * self.sides * n))
        return table[:, 0], table[:, 1:].reshape(n, 2, -1).swapaxes(0, 1)


def wrench_formula(law: Callable[..., Any], sides: int, dim: int) -> WrenchFormula | None:
    """The formulas of law(t, *markers); None for a law that does not take symbols."""
    with passing():
        markers = [_marker(side, dim) for side in range(sides)]
        try:
            answer = [as_expression(y) for part in law(TIME, *markers) for y in np.ravel(part)]
        except Exception:
            return None
        if len(answer) != len(markers[0].v) + len(markers[0].w):
            return None

        rows = [row for y in answer for row in (y, *_along(y, markers))]
        names = [s.arguments[0] for x in markers for name in SEEN for s in np.ravel(getattr(x, name))]
        return WrenchFormula(Program(rows, numbers=True), names, sides)


def _marker(side: int, dim: int) -> MarkerMotion:
    """A motion of symbols."""
    turns = 2 * dim - 3
    shapes = {"x": (dim,), "R": (dim, dim), "v": (dim,), "w": (turns,)}
    made = {
        name: np.array([symbol(f"{name}{side}_{i}") for i in range(int(np.prod(shape)))], dtype=object).reshape(shape)
        for name, shape in shapes.items()
    }
    return MarkerMotion(**made)


def _along(y: Expression, markers: Sequence[MarkerMotion]) -> list[Expression]:
    """Derivatives of y by the displacements of all markers, then by their velocities."""
    seen = [z for x in markers for name in SEEN for z in np.ravel(getattr(x, name))]
    by = dict(zip(seen, gradient(y, seen), strict=True))
    displaced: list[Expression] = []
    for marker in markers:
        turns = Vector([0.0] * len(marker.w))
        for axis in marker.R.T:
            turns = turns + cross(axis, [by[z] for z in axis])
        displaced += [by[z] for z in marker.x] + list(turns)
    return displaced + [by[z] for x in markers for z in (*x.v, *x.w)]
