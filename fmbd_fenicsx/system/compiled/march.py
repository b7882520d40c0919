"""Many steps of a scheme in one call of C (driver/marches/march.c): a ring of states, parameters, room for records."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from ..layout import State
from ..system import System
from .blocks import Block, Ring
from .calls import Calls
from .declarations import TABLES, enumeration, structure_of
from .kept import Kept
from .tables.tables import Tables
from .tape import Openness, Tape

# fmt: off
(H, AM, AF, GAMMA, BETA, TOL, FLOOR, CEILING, LENGTH, THETA, SLOW, MAXIT, HISTORY, PATIENCE, NEW_TANGENT, FAR, ITERATIONS, LOCAL,
 GUARDED, HIGHEST, TURNOVER, WEIGHT, SHARE, SETTLING, LEFT, FEWEST, WASTED, BEGIN_ANEW, WAIT, STABILISED, CHOSEN, EVENS,
 PARAMETERS) = enumeration("H", "parts.h").values()
# fmt: on
COUNTED = [ITERATIONS, LOCAL, LEFT]  # by a march, from zero
DONE, NEWTON, SINGULAR, LOOK, FAILED, GAIN, SIZE, DOUBT = enumeration("DONE").values()
SCHEMES = enumeration("ALPHA")
Closed = structure_of(TABLES, "Closed")


@dataclass(frozen=True)
class JointLimits:
    """By what the joints of every state of a march are judged: what is ``open`` (m); the rates at which they open, up to
    ``opening`` (m/s), infinite where these do not count, and a ``share`` of the ``fastest`` speed so far.
    """

    open: Openness
    opening: float
    share: float
    fastest: float


class March:
    """Steps of one scheme with the tables of one system: a ring of four states, the newest first, each with so many numbers of
    the scheme's ``own``, and so much ``room`` to work in.
    """

    def __init__(self, library: Any, tables: Tables, calls: Calls, scheme: str, *, own: int = 0, room: int = 0) -> None:
        self.library, self.tables, self.calls = library, tables, calls
        self.system: System = tables.system
        self.address = ctypes.addressof(tables.c)
        self.scheme = SCHEMES[scheme]
        self.ring = Ring(tables.system, 4, own)
        self.parameters, self.room = np.zeros(PARAMETERS), np.zeros(room)
        self.closed = Closed()
        self._units: Array | None = None
        self._verdict = ctypes.c_int(0)
        self._tape: Tape | None = None

    def load(self, states: Sequence[Block]) -> None:
        """Take the last states, the newest first, at most three."""
        self.ring.load([self.tables.twin.widened(x) for x in states])
        self.parameters[HISTORY] = len(states) - 1

    def block(self, i: int) -> Block:
        """The i-th newest state, with its algorithmic acceleration."""
        return self.tables.twin.narrowed(self.ring.block(i))

    def state(self, i: int = 0) -> State:
        """The i-th newest state."""
        return self.tables.twin.state(self.ring.state(i))

    def tape(self, judged: Openness) -> Tape:
        """Room for records; ``judged``: how open joints are told. Made once."""
        if self._tape is None:
            kept = Kept(self.library, self.tables, self.calls, Tape(self.tables, judged), own=self.ring.width)
            self._tape = Tape(self.tables, judged, kept=kept)
        return self._tape

    def judge(self, limits: JointLimits, most: float) -> None:
        """How the joints of every state are judged; the march ends with one that is faster than ``most`` (m/s)."""
        of, c = limits.open, self.closed
        if self._units is None:
            self._units = np.ascontiguousarray(of.units, dtype=float)
            c.units, c.length = address_of(self._units), self.system.length
        c.allowed, c.roundoff, c.opening, c.share = of.allowed, of.roundoff, limits.opening, limits.share
        c.fastest, c.speed, c.most = limits.fastest, 0.0, most

    def steps(
        self,
        count: int,
        tape: Tape | None = None,
        control: int | None = None,
        *,
        judged: bool = False,
        contact: int | None = None,
    ) -> tuple[int, int]:
        """Make up to so many steps; the number made, and the verdict of the one that stopped them. ``control``: address of
        the one that judges errors, ``judged``: whether :meth:`judge` has said how joints are, ``contact``: address of
        what elastic bodies may touch.
        """
        self.parameters[COUNTED] = 0.0

        made = self.library.march(
            self.address,
            self.scheme,
            address_of(self.parameters),
            address_of(self.room),
            count,
            self.ring.address,
            ctypes.byref(self._verdict),
            None if tape is None else tape.address,
            control,
            ctypes.addressof(self.closed) if judged else None,
            contact,
        )
        return int(made), int(self._verdict.value)
