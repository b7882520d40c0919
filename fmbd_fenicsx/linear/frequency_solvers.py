"""Solvers of a constrained system for motions exp(s t): with M + C / s + K / s^2 for real and complex frequencies s (1/s).

Implicit schemes of several stages ask for a few frequencies, over the size of the step. Those that come back step after step get
elastic factors of their own, complex ones too, so that no vibration is left to an iteration, however stiff it is. Others, and all
of large bodies, take the real factor whose frequency is next to |s|, of a geometric grid of three for a decade.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..rotations import Array
from ..system.compiled.states.field_states import FactoredFieldStates
from ..system.evaluation import Evaluation
from ..system.serialisation import Remembering, plain
from ..system.system import System
from .blocks.field_blocks import Weights
from .condensation import StepSolver

DECADE = 3  # real factors for a decade of frequencies
SAME = 1e-8  # relative difference below which frequencies are the same: steps of one size differ by roundoff
# times that a frequency is asked for before it gets own factors, which cost what one to five steps gain by them
SETTLED = 4
MANY = 32  # frequencies that are remembered
KEPT = 12  # sets of elastic factors, that of the mass included
LARGE_KEPT = 5  # the same of large bodies: those of a decade, one more and the mass
# of the matrices of all fields, up to which there are complex factors: measured, these have four entries for each of them in the
# plane and six in space (450 000 entries, 39 MB), and more in larger bodies
ENTRIES = 1_000_000


@dataclass(frozen=True)
class FrequencySolver:
    """A solver and the weights of its matrix; ``exact``: whether these are those of the frequency."""

    solver: StepSolver
    weights: Weights
    exact: bool

    @classmethod
    def of(cls, solver: StepSolver, s: complex, exact: bool) -> FrequencySolver:
        """For the matrix of a frequency."""
        used = s if s.imag else s.real
        return cls(solver, Weights(1.0, 1.0 / used, 1.0 / used**2), exact)

    @property
    def tables(self) -> FactoredFieldStates | None:
        """Those of compiled code that have the matrix prepared last; None where it is NumPy's."""
        driver = self.solver.driver
        states = driver.states if driver is not None and driver.ready else None
        return states if isinstance(states, FactoredFieldStates) else None

    def prepare(self, ev: Evaluation) -> None:
        """The matrix of a configuration, unless it is there; collective."""
        self.solver.prepare_once(ev, self.weights)


class FrequencySolvers(Remembering):
    """Those of one run. ``real``: of real matrices, which others use too. ``settles``: whether steps keep to a few sizes, so that
    factors of one frequency pay.
    """

    keeps: ClassVar = dict.fromkeys(("asked", "anchor"), plain())

    def __init__(self, system: System, solver: StepSolver) -> None:
        self.real = solver
        solver.elastic.kept = KEPT if _entries(system) <= ENTRIES else LARGE_KEPT
        self.settles = False
        self.asked: list[tuple[complex, int]] = []  # the last frequencies, and how often
        self.anchor: float | None = None  # first frequency of the grid, 1/s
        self._possible = solver.linear is None and solver.iterated is None and _sparse_blocks(system)
        self._complex: list[StepSolver] = []  # each with a matrix of its own

    def of_all(self, s: Array) -> list[FrequencySolver]:
        """Who solves for the frequencies s (p,) of one stage system, whose matrices are there at one time."""
        places = np.cumsum(s.imag != 0) - 1
        return [self.of(complex(x), int(place)) for x, place in zip(s, places, strict=True)]

    def of(self, s: complex, place: int = 0) -> FrequencySolver:
        """Who solves for a frequency; ``place``: of a complex one among those of its stage system."""
        nearest = self._on_grid(abs(s))
        if abs(s - nearest) <= SAME * nearest:
            return FrequencySolver.of(self.real, complex(nearest), True)
        if not self.settles:
            return FrequencySolver.of(self.real, complex(nearest), False)
        s, count = self._noted(s)
        if count > SETTLED and self._possible:
            return FrequencySolver.of(self._complex_at(place) if s.imag else self.real, s, True)
        return FrequencySolver.of(self.real, complex(nearest), False)

    def at_hand(self, s: float) -> Weights:
        """Those of the real matrix that steps with a frequency s (1/s) were solved by: its own, or the next one of the grid."""
        known = [x for x, count in self.asked if abs(x - s) <= SAME * s and count > SETTLED]
        own = known and self.settles and self._possible
        return FrequencySolver.of(self.real, complex(known[0] if own else self._on_grid(s)), True).weights

    def _complex_at(self, place: int) -> StepSolver:
        """The solver for complex matrices at a place."""
        while len(self._complex) <= place:
            made = StepSolver(self.real.system, place=len(self._complex))
            made.elastic, made.core.redundant = self.real.elastic, self.real.core.redundant
            self._complex.append(made)
        return self._complex[place]

    def expect(self, s: Array) -> None:
        """Frequencies (p,) that every step will ask for: they get their own factors at once."""
        for x in s:
            first, _ = self._noted(complex(x))
            self.asked[-1] = first, max(SETTLED, self.asked[-1][1])

    def settled(self, s: complex) -> bool:
        """Whether who asks for a frequency next gets its own factors; this is no such question."""
        nearest = self._on_grid(abs(s))
        known = max((count for known, count in self.asked if abs(known - s) <= SAME * abs(s)), default=0)
        return abs(s - nearest) <= SAME * nearest or (self.settles and known >= SETTLED)

    def _noted(self, s: complex) -> tuple[complex, int]:
        """A frequency as it was asked for first, and how often it has been, with this time."""
        same = [known for known in self.asked if abs(known[0] - s) <= SAME * abs(s)]
        first, count = same[0] if same else (complex(s), 0)
        others = [known for known in self.asked if known[0] != first]
        self.asked = [*others[-MANY:], (first, count + 1)]
        return first, count + 1

    def _on_grid(self, frequency: float) -> float:
        """The frequency of the grid that is next to one."""
        if self.anchor is None:
            self.anchor = float(frequency)
        places = round(DECADE * float(np.log10(frequency / self.anchor)))
        return float(self.anchor * 10.0 ** (places / DECADE))


def often(sizes: Array) -> Array:
    """The sizes of all steps to come (k,), s, that come so often that their frequencies get factors."""
    near = np.sort(sizes)
    first = np.flatnonzero(np.append(True, np.diff(near) > SAME * near[1:]))
    return near[first[np.diff(np.append(first, len(near))) > SETTLED]]


def _sparse_blocks(system: System) -> bool:
    """Whether all elastic blocks are sparse matrices with few entries."""
    parts = [part for _, part in system.fields]
    sparse = all(p.heavier is None for p in parts)
    return sparse and _entries(system) <= ENTRIES


def _entries(system: System) -> float:
    """Of the matrices of all fields, on all ranks."""
    return float(sum(p.field.M.getInfo()["nz_used"] * p.field.dim**2 for _, p in system.fields))
