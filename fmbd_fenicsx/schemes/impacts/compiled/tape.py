"""Records of compiled steps with contact: beside those of all systems, where the contacts are and what they carry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ....mechanics.contact.contact_set import ContactSet
from ....rotations import Array
from ....system.compiled.recording import Recorded
from ....system.compiled.tables.layout import TableLayout
from ....system.compiled.tape import Openness, Tape
from ....system.layout import State, States
from ....system.sensors.contact import WORKS, ContactForces, ContactState, reads_gaps
from ....system.system import System

if TYPE_CHECKING:
    from ....system.compiled.kept import Kept

Gaps = Callable[
    [States, Array], bool
]  # writes those of all points in k states into numbers (k, ..); False where it cannot


class ContactTape(Tape):
    """Room for the records of one march."""

    def __init__(
        self,
        tables: TableLayout,
        judged: Openness,
        contacts: ContactSet,
        system: System,
        kept: Kept | None = None,
        gaps: Gaps | None = None,
    ) -> None:
        """``system``: with its contacts, which that of the tables lacks; ``gaps``: who writes those of states within steps."""
        m = len(contacts.pair)
        pairs = len(contacts.pairs)
        d = tables.dim
        self.contacts, self.whole_system, self._gaps = contacts, system, gaps
        # as record_contacts() of driver/impacts/moreau.c writes them
        self.shapes = [(m,), (m, d), (m, d), (m,), (m, d), (pairs, d), (len(WORKS),), ()]
        self.numbers = sum(int(np.prod(x)) for x in self.shapes)
        super().__init__(tables, judged, contact=self.numbers, kept=kept)

    def stops_at(self, crossings: np.ndarray, read: Sequence[tuple[Any, int, int]]) -> bool:
        """No: steps are cut by impacts, between which values may cross and come back."""
        return False

    def take_own(self, own: Array, states: States) -> None:
        """The contacts of the steps that records are within."""
        self.arrays["contact"][: len(own)] = self._within(own, states)

    def each(self, states: States, own: Array) -> list[State]:
        """With the contacts of their steps."""
        forces, times = self.forces(self._within(own, states))
        return [
            ContactState(s.t, s.q, s.v, s.a, s.lam, forces.record(i, float(times[i])))
            for i, s in enumerate(states.each())
        ]

    def _within(self, own: Array, states: States) -> Array:
        """Numbers of contacts of steps, with the gaps of states within them where sensors read these."""
        if not reads_gaps(self.whole_system):
            return own
        numbers = own.copy()
        if self._gaps is None or not self._gaps(states, numbers):
            gaps = self.contacts.gaps_in(self.whole_system, states.each())
            numbers[:, : gaps.shape[1]] = gaps
        return numbers

    def forces(self, numbers: Array) -> tuple[ContactForces, Array]:
        """What the numbers of contacts in many records (k, ..) tell, and the times (k,) at which the forces act."""
        parts, first = [], 0
        for shape in self.shapes:
            size = int(np.prod(shape))
            parts.append(numbers[:, first : first + size].reshape(len(numbers), *shape))
            first += size

        contacts = self.contacts
        gap, x, normal, carried, force, impulse, work, times = parts

        found = ContactForces(
            contacts.names,
            0.0,
            contacts.pair,
            x,
            normal,
            gap,
            carried,
            force,
            contacts.pressures(carried),
            impulse,
            work,
        )
        return found, times

    def _records(self, which: slice) -> Recorded:
        return ContactRecorded(super()._records(which), self)


class ContactRecorded(Recorded):
    """Records with contact; ``contact``: its :class:`ContactForces`, with the record as the first axis of all arrays."""

    def __init__(self, found: Recorded, tape: ContactTape) -> None:
        super().__init__(found.twin, found.looks, found.arrays, found.doubt)
        self.system, self.tape = tape.whole_system, tape
        self.contact, self._times = tape.forces(self.arrays["contact"])

    def copied(self) -> Recorded:
        """As :meth:`Recorded.copied`, contacts too."""
        out = super().copied()
        assert isinstance(out, ContactRecorded)
        out.contact, out._times = self.tape.forces(out.arrays["contact"])
        return out

    def state(self, i: int) -> State:
        """One of the states, with the contact forces of the step that led to it."""
        s = super().state(i)
        return ContactState(s.t, s.q, s.v, s.a, s.lam, self.contact.record(i, float(self._times[i])))
