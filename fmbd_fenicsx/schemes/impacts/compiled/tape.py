"""Records of compiled steps with contact: beside those of all systems, where the contacts are and what they carry."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....mechanics.contact.contact_set import ContactSet
from ....rotations import Array
from ....system.compiled.recording import Recorded
from ....system.compiled.tables.layout import TableLayout
from ....system.compiled.tape import Openness, Tape
from ....system.layout import State
from ....system.sensors.contact import WORKS, ContactForces, ContactState
from ....system.system import System


class ContactTape(Tape):
    """Room for the records of one march."""

    def __init__(self, tables: TableLayout, judged: Openness, contacts: ContactSet, system: System) -> None:
        """``system``: with its contacts, which that of the tables lacks."""
        m = len(contacts.pair)
        pairs = len(contacts.pairs)
        d = tables.dim
        self.contacts, self.whole_system = contacts, system
        # as record_contacts() of driver/moreau.c writes them
        self.shapes = [(m,), (m, d), (m, d), (m,), (m, d), (pairs, d), (len(WORKS),), ()]
        super().__init__(tables, judged, contact=sum(int(np.prod(x)) for x in self.shapes))

    def stops_at(self, crossings: np.ndarray, read: Sequence[tuple[Any, int, int]]) -> bool:
        """No: steps are cut by impacts, between which values may cross and come back."""
        return False

    def _records(self, which: slice) -> Recorded:
        return ContactRecorded(super()._records(which), self)


class ContactRecorded(Recorded):
    """Records with contact; ``contact``: its :class:`ContactForces`, with the record as the first axis of all arrays."""

    def __init__(self, found: Recorded, tape: ContactTape) -> None:
        super().__init__(found.twin, found.looks, found.arrays, found.doubt)
        self.system, self.tape = tape.whole_system, tape
        self._split()

    def copied(self) -> Recorded:
        """As :meth:`Recorded.copied`, contacts too."""
        out = super().copied()
        assert isinstance(out, ContactRecorded)
        out._split()
        return out

    def _split(self) -> None:
        """What the numbers tell of contacts."""
        contacts, shapes = self.tape.contacts, self.tape.shapes
        numbers, parts, first = self.arrays["contact"], [], 0
        for shape in shapes:
            size = int(np.prod(shape))
            parts.append(numbers[:, first : first + size].reshape(len(numbers), *shape))
            first += size

        gap, x, normal, carried, force, impulse, work, self._times = parts
        self.contact = ContactForces(
            contacts.names,
            0.0,
            contacts.pair,
            x,
            normal,
            gap,
            carried,
            force,
            _pressures(contacts, carried),
            impulse,
            work,
        )

    def state(self, i: int) -> State:
        """One of the states, with the contact forces of the step that led to it."""
        s = super().state(i)
        return ContactState(s.t, s.q, s.v, s.a, s.lam, self.contact.record(i, float(self._times[i])))


def _pressures(contacts: ContactSet, normal: Array) -> Array:
    """Pressures of normal forces (k, m)."""
    if all(pair.trace_nodes is None for pair in contacts.pairs):
        return normal
    return np.array([contacts.pressures(x) for x in normal]).reshape(normal.shape)
