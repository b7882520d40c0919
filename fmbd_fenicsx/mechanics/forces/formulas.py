"""Efforts whose formula compiled steps know: motors, PID controllers, dry and smooth friction, stops.

An element says which formula it follows and with which numbers; ``formulas.c`` of the compiled driver has the same formulas as
the elements themselves. Laws of the user's own have none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...rotations import Array
from .effort_laws import EffortLaw, Feedback, Held

WIDTH, MEMORY = 6, 47  # numbers of an element: constants, and memory of accepted steps, see PidMemory of tables.h
TARGET = 4  # of SERVO and PID: where the target and its rate stand


@dataclass(frozen=True)
class Formula:
    """The formula of some elements of a batch on its coordinates ``on``: its name ``kind`` in ``formulas.c``, numbers ``which``
    (n,) in the batch, ``constants`` (n, WIDTH), and the targets of motors.

    ``kept``: the memory (n, MEMORY) of these elements, and ``keep`` takes it back; None without one.
    """

    on: Any
    kind: str
    which: np.ndarray
    constants: Array
    targets: list[Any] = field(default_factory=list)
    kept: Callable[[], Array] | None = None
    keep: Callable[[Array], None] | None = None

    def part(self, some: np.ndarray) -> Formula:
        """That of some of the elements, memory included."""
        if len(some) == len(self.which):
            return self
        kept = self.kept
        keep = self.keep
        targets = [self.targets[i] for i in some] if self.targets else []
        if kept is None or keep is None:
            return replace(self, which=self.which[some], constants=self.constants[some], targets=targets)

        def keep_some(memory: Array) -> None:
            whole = kept().copy()
            whole[some] = memory
            keep(whole)

        return replace(
            self, which=self.which[some], constants=self.constants[some], targets=targets,
            kept=lambda: kept()[some], keep=keep_some,
        )  # fmt: skip

    @property
    def moves(self) -> bool:
        """Whether a target depends on time."""
        return not all(isinstance(x, Held) for x in self.targets)


@dataclass(frozen=True)
class SampledEffort:
    """An effort on one coordinate ``on`` that stays the same between samples; ``effort`` (1,): what it is now, N or N m, positive
    where it pulls the coordinate back.
    """

    on: Any
    effort: Array


def table(rows: list[Any]) -> Array:
    """Rows of numbers, filled up to (n, WIDTH)."""
    out = np.zeros((len(rows), WIDTH))
    for i, row in enumerate(rows):
        out[i, : len(row)] = row
    return out


def formulas_of(laws: list[Any], on: Any) -> list[Formula]:
    """Formulas of the laws of a batch on its coordinates, one for each kind; laws without a formula (or None) are in none."""
    stated = [(i, law, law.formula) for i, law in enumerate(laws) if isinstance(law, EffortLaw)]
    known = [(i, law, *formula) for i, law, formula in stated if formula is not None]

    found = []
    for kind in sorted({one[2] for one in known}):
        mine = [one for one in known if one[2] == kind]
        which = np.array([i for i, *_ in mine])
        targets = [law.target for _, law, *_ in mine if isinstance(law, Feedback)]
        found.append(Formula(on, kind, which, table([numbers for *_, numbers in mine]), targets))
    return found
