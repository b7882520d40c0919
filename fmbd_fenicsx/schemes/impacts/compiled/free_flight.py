"""Steps of elastic bodies before what they may touch, many in one call (``driver/contact/free_flight.c``)."""

from __future__ import annotations

import ctypes
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ....mechanics.contact.contact_set import NEAREST, ContactSet
from ....mechanics.contact.mortar import MortarPair
from ....mechanics.contact.obstacle_pair import ObstaclePair
from ....rotations import Array
from ....system.compiled.blocks import state_of
from ....system.compiled.choice import driver_of
from ....system.compiled.declarations import enumeration
from ....system.compiled.library import CONTACT
from ....system.compiled.march import March
from ....system.compiled.recording import Recorded
from ....system.compiled.states.evaluation import DriverStates
from ....system.compiled.tables.tables import Tables
from ....system.compiled.tape import Openness, Tape
from ....system.layout import State
from ....system.sensors.contact import WORKS, ContactForces, ContactState
from ....system.system import System
from ..contact_ledger import SHORT
from ..elastic_step import MARGIN, RELIED, Confirmed
from .pairs import PairTables, SurfacePoints
from .structures import FACING, FLIGHT, FREE_FLIGHT, Contacts

if TYPE_CHECKING:
    from ..flying_stepper import FlyingStepper

_NUMBERS = enumeration("LOADS", FLIGHT)  # of what is kept with a state
CONFIRMED, TIME, KEPT = (_NUMBERS[x] for x in ("CONFIRMED", "TIME", "KEPT"))


def looked_at(contacts: ContactSet) -> bool:
    """Whether compiled code sees where all that may touch stands: nodes of fields before obstacles, or before each other."""

    def on_field(side: Any) -> bool:
        return side.surface is not None and side.trace in contacts.on_fields

    return all(
        on_field(p.slave) and (type(p) is ObstaclePair or (type(p) is MortarPair and on_field(p.master)))
        for p in contacts.pairs
    )


class Surroundings(PairTables):
    """What bodies may touch, for a march of steps whose forces act at a ``share`` of them; ``smooth``: see :func:`.is_smooth`.

    Steps in which something is near are Python's.
    """

    def __init__(self, tables: Tables, system: System, share: float, *, smooth: bool) -> None:
        listed: list[Any] = []
        facing: list[Any] = []
        for pair in system.contacts.pairs:
            if type(pair) is MortarPair:
                facing.append(FACING(len(listed), len(listed) + 1, pair.sight))
                listed += [SurfacePoints(pair.slave), SurfacePoints(pair.master)]
            else:
                listed.append(pair)
        super().__init__(tables, system, listed)

        self._pairs()
        on, place = self._points()
        of = np.repeat(np.arange(len(listed)), [pair.count for pair in listed])
        searched = [pair.search if isinstance(pair, ObstaclePair) else None for pair in listed]
        m, s, d = len(on), tables.system, tables.dim
        self.c = Contacts(
            pairs=len(listed), points=m, components=d if self.contacts.frictional else 1,
            moving=int(any(pair.moving for pair in system.contacts.pairs)), pair=ctypes.addressof(self.pairs),
            on=self._array("on", on, np.int32), of=self._array("of", of, np.int32),
            place=self._array("place", place), own=self._zeros("own", m * (1 + 2 * d)),
            now=self._touch("now", m, d), end=self._touch("end", m, d), aside=self._touch("aside", m, d),
            python=self.function, system=ctypes.addressof(tables.c),
        )  # fmt: skip
        self._facing = (FACING * len(facing))(*facing)
        self.flight = FREE_FLIGHT(
            contacts=ctypes.addressof(self.c), facings=len(facing), facing=ctypes.addressof(self._facing), share=share,
            least=NEAREST * system.length, loaded=int(bool(system.forces)), smooth=int(smooth), length=system.length,
            linear=int(not any(part.field.nonlinear for _, part in system.fields)),
            search=self._array("search", [np.nan if far is None else far for far in searched]),
            room=self._zeros("room", 3 * s.n_v + s.n_q + 4 * s.n_lam), margin=MARGIN, relies=RELIED, brief=SHORT,
        )  # fmt: skip
        self.address = ctypes.addressof(self.flight)

    @property
    def kept(self) -> int:
        """Numbers with each state."""
        return KEPT

    def begin(self, stepper: FlyingStepper, own: Array) -> None:
        """A march begins from the newest state of a stepper; with that are kept ``own``."""
        self.c.known = self.flight.ready = 0
        known = stepper.confirmed
        own[:] = 0.0
        own[:CONFIRMED] = stepper.ledger.books
        if known is not None:
            own[CONFIRMED:TIME] = known.h, known.first, known.second, known.relied

    def end(self, stepper: FlyingStepper, s: State, own: Array) -> ContactState:
        """It has ended in a state ``s``, with which ``own`` are kept: the stepper takes them, and the state with its contacts."""
        h, first, second, relied = (float(x) for x in own[CONFIRMED:TIME])
        near = self._near(own)
        stepper.confirmed = Confirmed(h, near.tobytes().hex(), first, second, int(relied)) if h else None
        stepper.close = bool(near.any())
        return self._take_books(stepper, s, own)

    def _near(self, own: Array) -> np.ndarray:
        """Which candidates were near in the last step, (m,) bool."""
        return np.zeros(len(self.contacts.pair), dtype=bool)

    def _take_books(self, stepper: FlyingStepper, s: State, own: Array) -> ContactState:
        """Books of steps in which nothing was near, and the state."""
        return stepper.ledger.fly(s, own[:CONFIRMED], float(own[TIME]))

    def tape(self, march: FreeMarch, judged: Openness) -> Tape:
        """Room for records, with the works of contact; not for instants within steps."""
        return FlightTape(march, judged)


class FreeMarch(March):
    """The march of such steps, with what is ``around`` the bodies of the states."""

    def __init__(self, states: DriverStates, around: Surroundings, scheme: str, *, room: int) -> None:
        library = driver_of(states.twin.system, CONTACT)
        super().__init__(library, states.tables, states.calls, scheme, own=around.kept, room=room)
        self.around, self.whole = around, around.system
        self.impulse: Array = np.zeros(0)  # of contacts since the start, (pairs, d)

    def tape(self, judged: Openness) -> Tape:
        """Room for records, not for instants within steps. Made once."""
        if self._tape is None:
            self._tape = self.around.tape(self, judged)
        return self._tape


class FlightTape(Tape):
    """Room for the records of one march, with the works of contact."""

    def __init__(self, march: FreeMarch, judged: Openness) -> None:
        self.march = march
        super().__init__(march.tables, judged, contact=len(WORKS))

    def _records(self, which: slice) -> Recorded:
        return FlightRecorded(super()._records(which), self)


class FlightRecorded(Recorded):
    """Records of steps in which nothing touches."""

    def __init__(self, found: Recorded, tape: FlightTape) -> None:
        super().__init__(found.twin, found.looks, found.arrays, found.doubt)
        self.whole, self.impulse = tape.march.whole, tape.march.impulse
        del self.contact  # made where somebody asks

    @cached_property
    def contact(self) -> Untouched:  # type: ignore[override]
        """What sensors read of contacts."""
        return Untouched(self)

    def copied(self) -> Recorded:
        """As :meth:`Recorded.copied`."""
        out = super().copied()
        out.__dict__.pop("contact", None)
        return out

    def state(self, i: int) -> State:
        """One of the states, with where its contacts are."""
        s = super().state(i)
        return ContactState(s.t, s.q, s.v, s.a, s.lam, self.contact.record(i, s))


class Untouched:
    """As :class:`ContactForces` of many records, where nothing touches."""

    def __init__(self, seen: FlightRecorded) -> None:
        self.seen, self.contacts = seen, seen.whole.contacts
        self.names, self.pair = self.contacts.names, self.contacts.pair
        self.work: Array = seen.arrays["contact"]
        k, m, d = len(self.work), len(self.pair), seen.dim
        self.force: Array = np.zeros((k, m, d))
        self.normal_force = self.pressure = self.force[..., 0]
        self.impulse: Array = np.broadcast_to(seen.impulse, (k, *seen.impulse.shape))

    of = ContactForces.of

    @cached_property
    def gap(self) -> Array:
        """(k, m) m."""
        system, states = self.seen.whole, self.seen.arrays["block"]
        found = [self.seen.twin.state(state_of(self.seen.looks.system, x)) for x in states]
        return np.array([self.contacts.touch(system, s.t, s.q).geometric for s in found]).reshape(self.force.shape[:2])

    def record(self, i: int, s: State) -> ContactForces:
        """Those of one record, in a state."""
        at = self.contacts.touch(self.seen.whole, s.t, s.q)
        none = self.normal_force[i].copy()
        return ContactForces(
            self.names, s.t, self.pair, at.x, at.normal, at.geometric, none, self.force[i].copy(), none,
            self.impulse[i].copy(), self.work[i].copy(),
        )  # fmt: skip
