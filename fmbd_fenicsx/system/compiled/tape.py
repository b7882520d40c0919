"""Room in which the compiled loop leaves its records, and what it looks at while it makes them: events, open joints, series."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...kernel_cache import address_of
from ...mechanics.kinds.frames import FRAME
from ...rotations import Array
from .blocks import block_size, state_of
from .declarations import TABLES, structure_of
from .recording import KINDS, Numbers, Recorded
from .tables.layout import TableLayout
from .tables.structures import zeros_of

if TYPE_CHECKING:
    from ..layout import State, States
    from .kept import Kept

FIRST, CAPACITY = 64, 2048  # records between two visits of Python, at first and at most
BYTES = 1_000_000  # that they may take, so that they stay in the cache
TAPE = structure_of(TABLES, "Tape")

# what events are about, and what grows with every record
CROSSING, SERIES = (np.dtype(structure_of(TABLES, name)) for name in ("Crossing", "Series"))
MOST = 10_000_000  # records between two visits where all goes into series


@dataclass(frozen=True)
class Openness:
    """What open constraints are judged by: units of the rows as lengths, (n_lam,); the length that is allowed (m), and its share
    of the distance from the origin.
    """

    units: Array
    allowed: float
    roundoff: float


class Tape:
    """Room for the records of one march; ``contact``: numbers that contacts take of each, ``kept``: room for steps in which
    somebody waits for an instant.
    """

    def __init__(self, tables: TableLayout, judged: Openness, *, contact: int = 0, kept: Kept | None = None) -> None:
        s, looks = tables.system, tables.looks
        self.tables, self.kept = tables, kept
        self.units = np.ascontiguousarray(judged.units, dtype=float)
        size = block_size(s)

        self._sizes: dict[str, tuple[int, ...]] = {
            "block": (size if looks.whole else 1,),
            "lam": (s.n_lam if looks.rows else 0,),
            "sight": (len(looks.markers), FRAME[tables.dim] + tables.dim + (tables.dim == 2)),
            "energy": (len(KINDS),),
            "reading": (looks.count, 3),
            "reaction": (len(looks.wrenches), tables.twist),
            "contact": (contact,),
        }
        # as many records as fit in a few megabytes
        each = sum([math.prod(x) for x in self._sizes.values()])
        self.most = min(max(BYTES // (8 * each), 16), CAPACITY)
        self.doubt = np.zeros(size)

        self.c = TAPE(
            whole=looks.whole, rows=looks.rows, units=address_of(self.units), allowed=judged.allowed,
            roundoff=judged.roundoff, length=s.length, doubt=address_of(self.doubt),
        )  # fmt: skip
        self._watched: tuple[np.ndarray, Sequence[tuple[Any, int, int]]] | None = None
        self._asked: Callable[[Recorded], dict[Any, Numbers]] | None = None
        self.series: np.ndarray = np.zeros(0, dtype=SERIES)
        self._make_room(min(FIRST, self.most))

    def _make_room(self, capacity: int) -> None:
        """Room for so many records, none of them made, and for a step that is only looked at."""
        room = zeros_of({name: (capacity + 1, *shape) for name, shape in self._sizes.items()})
        self.arrays = {name: x for name, (x, _) in room.items()}
        self.capacity = capacity
        for name, (_, address) in room.items():
            setattr(self.c, name, address)
        self._find_watched()
        self._find_series()

    def told(self, numbers: Array) -> bool:
        """Whether these are numbers of the records themselves."""
        return any(np.may_share_memory(numbers, x) for x in self.arrays.values())

    def follow(self, asked: Callable[[Recorded], dict[Any, Numbers]]) -> dict[Any, tuple[int, ...]]:
        """The shapes of those numbers that are ``asked`` of records which C can write into series itself."""
        self._asked = asked
        return {name: numbers.shape[1:] for name, (numbers, _) in self._find_series().items()}

    def prolong(self, ends: Sequence[int], *, single: bool) -> None:
        """The next march writes what it follows to these addresses on; ``single``: nobody asks for more than that."""
        self.series["to"] = ends
        self.c.straight, self.c.single = len(ends), single

    def _find_series(self) -> dict[Any, Numbers]:
        """What is asked of records and is told in them, and where they have it."""
        if self._asked is None:
            return {}
        every = self._asked(self._records(slice(None)))
        found = {name: x for name, x in every.items() if self.told(x[0])}
        places = []
        for numbers, scale in found.values():
            stride, apart = (x // numbers.itemsize for x in (*numbers.strides, numbers.itemsize)[:2])
            places.append((numbers.ctypes.data, stride, apart, math.prod(numbers.shape[1:]), scale, 0))
        self.series = np.array(places, dtype=SERIES)
        self.c.series = address_of(self.series)
        return found

    def stops_at(self, crossings: np.ndarray, read: Sequence[tuple[Any, int, int]]) -> bool:
        """Whether marches end with the step in which one of these is met: ``read`` are the sensor, marker and component of each,
        ``crossings`` (n,) of the type CROSSING. What a sensor has to compute of a record is not looked at in C.
        """
        if self._watched is None or self._watched[0] is not crossings:
            self._watched = crossings, read
            self._find_watched()
        return bool(self.c.crossings)

    def _find_watched(self) -> None:
        """Where the records have what events are about, when all of them are numbers of records."""
        self.c.crossings = 0
        if self._watched is None:
            return

        crossings, read = self._watched
        every = self._records(slice(None))
        for one, (sensor, marker, component) in zip(crossings, read, strict=True):
            if id(sensor) not in self.tables.looks.of:
                return
            numbers, one["scale"] = sensor.numbers(every, marker)
            found = numbers[:, component]
            if not self.told(found):
                return
            one["at"], one["stride"] = found.ctypes.data, found.strides[0] // found.itemsize

        self.c.crossing, self.c.crossings = address_of(crossings), len(crossings)

    @property
    def address(self) -> int:
        """For C."""
        return ctypes.addressof(self.c)

    @property
    def room(self) -> int:
        """Records that the next march may make."""
        return MOST if self.c.single else self.capacity

    def hold(self, records: int) -> None:
        """Room for so many at least, of each step; nothing is recorded."""
        if records > self.capacity:
            self._make_room(records)
        self.begin(1, 1)

    def take_own(self, own: Array, states: States) -> None:
        """What a scheme keeps with the ends of steps, (k, ..), may tell something of records within them, in these states."""

    def each(self, states: States, own: Array) -> list[State]:
        """States within steps one by one, with what that tells of them."""
        return states.each()

    def begin(self, every: int, left: int) -> None:
        """Nothing recorded; the first record after ``left`` steps, then every so many. One that was full has more room then."""
        if self.c.count == self.capacity < self.most and not self.c.single:
            self._make_room(min(4 * self.capacity, self.most))
        self.c.every, self.c.left, self.c.count, self.c.doubtful, self.c.crossed = every, left, 0, -1, 0
        self.c.straight = self.c.single = self.c.meets = 0
        self.c.kept, self.c.judged = None, np.nan
        if self.kept is not None:
            self.kept.clear()
        self.c.worst[:] = [0.0] * len(self.c.worst)

    @property
    def ended(self) -> bool:
        """Whether the march has ended because of an event, or for want of room."""
        return bool(self.c.crossed) or (self.kept is not None and self.kept.full)

    def wait(self, instants: Array, roundoff: float, began: State | None, *, each: bool, forces: bool) -> None:
        """The next march keeps the steps of these instants, or ``each``, see :meth:`.Kept.begin`; ``forces``: these are read."""
        assert self.kept is not None
        motion = not forces and self.tables.looks.of_motion
        self.kept.begin(instants, roundoff, began, each=each, motion=motion)
        self.c.kept = self.kept.address

    def step_back(self, t: float) -> None:
        """Forget the record of the newest step, which has ended at t (s), if it has one, and how open its joints were."""
        if self.c.count and self.c.left == self.c.every:
            self.c.count -= 1
        if self.c.judged == t:
            self.c.worst[:] = self.c.before
        if self.c.doubtful >= 0 and self.doubt[0] == t:
            self.c.doubtful = -1
        self.c.crossed = 0

    def recorded(self) -> Recorded:
        """What was recorded, until the tape begins anew; where all is in series the newest of it."""
        n = int(self.c.count)
        found = self._records(slice(min(n, 1) if self.c.single else n))
        found.count, found.straight, found.worst = n, bool(self.c.straight), tuple(self.c.worst)
        return found

    def looked_at(self) -> Recorded | None:
        """The step at which an event has ended the march, with arrays of its own; None where none has."""
        n = 0 if self.c.single else int(self.c.count)
        return self._records(slice(n, n + 1)).copied() if self.c.crossed else None

    def _records(self, which: slice) -> Recorded:
        doubtful = self.c.doubtful >= 0
        doubt = self.tables.twin.state(state_of(self.tables.system, self.doubt)) if doubtful else None
        return Recorded(self.tables.twin, self.tables.looks, {name: x[which] for name, x in self.arrays.items()}, doubt)


def on_the_way(tables: TableLayout) -> bool:
    """Whether steps can be recorded as they are made: not where states would be read one by one, afterwards, that depend on a
    memory, which later steps have changed.
    """
    return tables.looks.complete or not (tables.c.remembers or tables.sampled)
