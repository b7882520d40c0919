"""Steps in which somebody waits for an instant: a march keeps the states at their ends, and goes on.

Polynomials through them tell the states between afterwards, of all instants at once.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...kernel_cache import address_of
from ...rotations import Array
from ..layout import State, States
from .blocks import block_size, state_of
from .calls import Calls
from .declarations import TABLES, fields_of
from .recording import Recorded
from .tables.resting import Twin
from .tables.structures import zeros_of
from .tables.tables import Tables
from .tape import Tape

BYTES = 4_000_000  # that they may take
FEW, CAPACITY = 16, 2048  # steps between two visits of Python, at least and at most


class _Kept(ctypes.Structure):
    """``Kept`` of tables.h."""

    _fields_ = fields_of(TABLES, "Kept")


@dataclass(frozen=True)
class KeptSteps:
    """The step of each of k instants: its ``number`` in the march (k,), states at its beginning, at its end, and at the beginning
    of the step before, nan where forces jump between; algorithmic accelerations at its beginning and end, and what the scheme
    keeps with the end (k, ..), as compiled code has it.
    """

    t: Array  # (k, 1) s
    number: np.ndarray
    before: States
    after: States
    earlier: States
    A: tuple[Array, Array]
    own: Array

    @property
    def h(self) -> Array:
        """Sizes, (k, 1) s."""
        return self.after.t - self.before.t

    def chosen(self, which: np.ndarray) -> KeptSteps:
        """Some of them."""
        before, after, earlier = (x.chosen(which) for x in (self.before, self.after, self.earlier))
        A, A_end = self.A[0][which], self.A[1][which]
        return KeptSteps(self.t[which], self.number[which], before, after, earlier, (A, A_end), self.own[which])


class Kept:
    """Room for such steps of a march with these tables, and on a ``tape`` for the records of what lies within them.

    ``own``: numbers that the scheme keeps with a state, ``parts``: into how many at most it cuts a step, each with states at its
    ends.
    """

    def __init__(self, library: Any, tables: Tables, calls: Calls, tape: Tape, *, own: int, parts: int = 1) -> None:
        self.library, self.tables, self.calls, self._tape = library, tables, calls, tape
        size = block_size(tables.system)
        # a memory of elements is that of the newest step
        self.many, self._parts = not (tables.c.remembers or tables.sampled), parts
        most = min(max(BYTES // (8 * (3 * size + own)), FEW + parts), CAPACITY + parts)
        self._sizes = {"newest": (most, size + own), "begin": (most, size), "earlier": (most, size), "last": (size,)}
        self._number = np.zeros(most, dtype=np.int64)
        self.c: _Kept = _Kept(capacity=most, own=own, most=parts, number=address_of(self._number))
        self.address: int = ctypes.addressof(self.c)
        self.most = most  # instants that are told together
        self._instants: Array = np.zeros(0)

    @cached_property
    def _room(self) -> dict[str, Array]:
        """Megabytes, which most marches, for whom nobody waits, do without."""
        room = zeros_of(self._sizes)
        for name, (_, address) in room.items():
            setattr(self.c, name, address)
        return {name: x for name, (x, _) in room.items()}

    @property
    def full(self) -> bool:
        """Whether there is room for no more."""
        return bool(self.c.count + self.c.most > self.c.capacity)

    def clear(self) -> None:
        """Nothing is kept."""
        self.c.count = 0

    def begin(self, instants: Array, roundoff: float, began: State | None, *, each: bool, motion: bool) -> None:
        """The next march keeps steps in which one of these lies (s, rising), but for so much roundoff (s), or ``each``;
        ``began``: where the step before it did, None where forces jump between; ``motion``: only this is read.
        """
        self._instants, c = np.ascontiguousarray(instants), self.c
        c.instant, c.instants, c.roundoff = address_of(self._instants), len(instants), roundoff
        c.passed = c.steps = c.count = 0
        c.capacity = self.most if self.many or motion else self._parts
        c.each = each
        self._room["last"][:] = np.nan if began is None else blocks_of(self.tables.twin, States.of([began]))[0]

    @property
    def began(self) -> State | None:
        """Where the newest step began, or, if an event is met in that, the one before; None where forces jump between."""
        twin, last = self.tables.twin, self._room["last"]
        return None if np.isnan(last[0]) else twin.state(state_of(self.tables.system, last))

    def steps(self, t: float) -> Iterator[KeptSteps]:
        """The steps of all instants up to a time t (s), a state of the march, some at a time."""
        roundoff, ends = self.c.roundoff, self._ends(t)
        if len(ends):
            instants = self._instants[: np.searchsorted(self._instants, ends[-1] + roundoff, side="right")]
            yield from self._some(np.searchsorted(ends + roundoff, instants), instants)

    def inside(self, t: float, places: Array) -> Iterator[KeptSteps]:
        """The steps up to a time t (s), a state of the march, some at a time, each at these ``places``: shares of it."""
        ends = self._ends(t)
        begins = self._room["begin"][: len(ends), 0]
        instants = begins[:, None] + places * (ends - begins)[:, None]
        yield from self._some(np.repeat(np.arange(len(ends)), len(places)), instants.ravel())

    def _ends(self, t: float) -> Array:
        """When the steps that are kept end, s: the newest one may have been taken back; times are told with roundoff."""
        ends = self._room["newest"][: self.c.count, 0]
        return ends[: np.searchsorted(ends, t + self.c.roundoff, side="right")]

    def _some(self, every: np.ndarray, instants: Array) -> Iterator[KeptSteps]:
        """The steps with these places in the room, at an instant (s) each."""
        room, size, twin = self._room, block_size(self.tables.system), self.tables.twin
        for first in range(0, len(instants), self.most):
            which = every[first : first + self.most]
            newest = room["newest"][which]
            (after, A), (before, past), (earlier, _) = (
                _states_of(twin, x) for x in (newest[:, :size], room["begin"][which], room["earlier"][which])
            )
            t_of = instants[first : first + self.most, None]
            yield KeptSteps(t_of, self._number[which], before, after, earlier, (past, A), newest[:, size:])

    def told_of(self, states: States, steps: KeptSteps) -> Recorded | None:
        """Records of states within steps, as compiled code tells them; None where NumPy has something to say."""
        self._tape.hold(len(steps.t))
        self._tape.take_own(steps.own, states)
        return self._recorded(states, ends=False)

    def told_at(self, state: State) -> Recorded | None:
        """The record of the end of a step that was made alone, with memories as they are now; None where NumPy has something to
        say, or contacts have.
        """
        if self._tape.arrays["contact"].size:
            return None
        self._tape.hold(1)
        self.tables.recall()
        return self._recorded(States.of([state]), ends=True)

    def _recorded(self, states: States, *, ends: bool) -> Recorded | None:
        """Records of states, of ``ends`` of steps or within."""
        blocks, tape = blocks_of(self.tables.twin, states), self._tape
        system = ctypes.addressof(self.tables.c)
        if self.library.driver_record(system, tape.address, ends, len(blocks), address_of(blocks)):
            self.calls.forget_error()  # who reads them one by one meets it again
            return None
        return tape.recorded()

    def each(self, states: States, steps: KeptSteps) -> list[State]:
        """The states within steps one by one, for who reads them so."""
        return self._tape.each(states, steps.own)


def _states_of(twin: Twin, blocks: Array) -> tuple[States, Array]:
    """The states in many blocks of a twin as those of its system, their own arrays, and algorithmic accelerations."""
    n, at = twin.system.n_v, 1 + twin.system.n_q
    rates = blocks[:, at : at + 3 * n].reshape(len(blocks), 3, n)
    v, a, A = np.moveaxis(np.array(twin.forces(rates)), 1, 0)
    q = np.array(twin.places(blocks[:, 1:at]))
    return States(blocks[:, :1].copy(), q, v, a, blocks[:, at + 3 * n :].copy()), A


def blocks_of(twin: Twin, states: States) -> Array:
    """The other way, without algorithmic accelerations, (k, numbers of a block)."""
    v, a = twin.velocities(states.v), twin.velocities(states.a)
    return np.concatenate((states.t, twin.configurations(states.q), v, a, np.zeros_like(a), states.lam), axis=1)
