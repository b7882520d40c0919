"""Generalized-alpha in the compiled driver: many steps in one call, for systems of rigid, reduced and floating bodies and rods.

Joints, drives, gears, springs, dampers, loads and laws of the user's own are all items of the driver's tables; Python is entered
once a step where something depends on time, and at evaluations where a law is given in Python.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ...rotations import Array
from ...system.compiled.calls import Calls
from ...system.compiled.evaluation import STORAGE_LIMIT, DriverStates
from ...system.compiled.fields import Block
from ...system.compiled.items import covers, other_loads
from ...system.compiled.library import driver_library
from ...system.compiled.recording import Openness, Tape
from ...system.compiled.structures import address_of
from ...system.compiled.tables import Tables, covers_bodies
from ...system.system import System

if TYPE_CHECKING:
    from ..newton import Newton

# fmt: off
(H, AM, AF, GAMMA, BETA, TOL, FLOOR, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, NEW_TANGENT, FAR, ITERATIONS, LOCAL,
 GUARDED, HIGHEST, TURNOVER, WEIGHT, SHARE, SETTLING, LEFT, STABILISED) = range(25)
# fmt: on
DONE, NEWTON, SINGULAR, LOOK, FAILED, GAIN = range(6)


class AlphaDriver:
    """The driver for one system: its tables, its calls into Python, and a ring of four states."""

    def __init__(self, library: Any, tables: Tables, calls: Calls, *, blocks: Sequence[Block] = ()) -> None:
        system = tables.system
        self.system, self.library, self.field_blocks = system, library, blocks
        self.tables, self.calls = tables, calls
        self.address = ctypes.addressof(self.tables.c)
        self.n, self.nq, self.m = system.n_v, system.n_q, system.n_lam
        self.block_size = 1 + self.nq + 3 * self.n + self.m

        self.parameters = np.zeros(25)
        self.blocks = np.zeros((4, self.block_size))
        self._places = np.array([address_of(x) for x in self.blocks], dtype=np.uintp)
        self.ring = self._places.copy()
        self._verdict = ctypes.c_int(0)
        self._tape: Tape | None = None

    def load(self, states: list[tuple[float, Array, Array, Array, Array, Array]]) -> None:
        """Take t, q, v, a, A, lambda of the last states, the newest first, at most three."""
        for block, (t, *arrays) in zip(self.blocks, states, strict=False):
            np.concatenate(([t], *arrays), out=block)
        self.ring[:] = self._places
        self.parameters[HISTORY] = len(states) - 1

    @property
    def slopes(self) -> Array | None:
        """What the next step knows of forces that Python gives as a whole; None without any."""
        tables = self.tables
        if not tables.whole:
            return None
        return np.concatenate(([tables.c.ck], tables.arrays["diagonal"], *(x.memory for x in tables.whole)))

    @slopes.setter
    def slopes(self, kept: Array | None) -> None:
        tables = self.tables
        if kept is None:
            for x in tables.whole:
                x.astray[0] = 1
            return
        diagonal, at = tables.arrays["diagonal"], 1 + len(tables.arrays["diagonal"])
        tables.c.ck, diagonal[:] = kept[0], kept[1:at]
        for x in tables.whole:
            x.recall(kept[at : at + len(x.memory)])
            at += len(x.memory)

    def tape(self, judged: Openness) -> Tape:
        """Room for records; ``judged``: how open joints are told. Made once."""
        if self._tape is None:
            self._tape = Tape(self.tables, judged)
        return self._tape

    def march(self, steps: int, tape: Tape | None = None) -> tuple[int, int]:
        """Make up to so many steps; the number made, and the verdict of the one that stopped them."""
        for slot in (LOCAL, ITERATIONS, LEFT):
            self.parameters[slot] = 0.0
        made = self.library.march(
            self.address,
            address_of(self.parameters),
            steps,
            address_of(self.ring),
            ctypes.byref(self._verdict),
            None if tape is None else tape.address,
        )
        self.calls.raise_error()
        return int(made), int(self._verdict.value)

    def block(self, i: int) -> Array:
        """The i-th newest state, a view: t, q, v, a, A, lambda."""
        return self.blocks[(int(self.ring[i]) - int(self._places[0])) // (8 * self.block_size)]


def settings(p: Array, parameters: tuple[float, float, float, float], system: System, newton: Newton) -> None:
    """Fill the driver's parameters from a scheme's, a system and Newton's settings."""
    p[1:5] = parameters
    p[TOL], p[LENGTH], p[FLOOR] = newton.tolerance, system.length, 64 * np.finfo(float).eps * system.length
    p[SLOW], p[MAXIT], p[NEW_TANGENT] = newton.slow, newton.max_iterations, newton.patience


def drivable(system: System) -> Any:
    """The library of the driver where it knows all of a system, else None.

    It takes the symmetric half of the tangents of forces that Python gives as a whole: cheap iterations may make up for that,
    those with the factor of a field do not.
    """
    known = covers_bodies(system) and covers(system) and not (system.fields and other_loads(system))
    return driver_library(system.motions.dim) if known else None


def alpha_driver(
    system: System, *, redundant: bool, blocks: Sequence[Block] = (), states: DriverStates | None = None
) -> AlphaDriver | None:
    """The driver for a system, or None where the NumPy path has to do; ``blocks``: of its fields for the size of a step;
    ``states``: what made its start, whose tables are taken.
    """
    if states is not None:
        tables, calls = states.give()
        tables.c.redundant = int(redundant)
        return AlphaDriver(states.library, tables, calls)

    library = drivable(system)
    if library is None:
        return None
    tables = Tables(system, redundant=redundant, blocks=blocks)
    small = tables.fronts.storage <= STORAGE_LIMIT
    return AlphaDriver(library, tables, Calls(tables), blocks=blocks) if small else None
