"""Contacts in compiled steps of elastic bodies (``driver/contact/elastic_contact.c``): room for those near, and their books."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING

import numpy as np

from ....kernel_cache import address_of
from ....linear.complementarity.delassus import Compliance
from ....linear.driver_solver import FieldDriverSolver
from ....mechanics.contact.contact_set import ContactSet
from ....mechanics.contact.obstacle_pair import ObstaclePair
from ....rotations import Array
from ....system.compiled.states.evaluation import DriverStates
from ....system.compiled.tables.tables import Tables
from ....system.compiled.tape import Openness, Tape
from ....system.layout import State
from ....system.sensors.contact import ContactForces, ContactState
from ....system.system import System
from ..contact_newton import small_problem
from .free_flight import CONFIRMED, KEPT, TIME, FreeMarch, Surroundings
from .pairs import COMPLEMENTARITY, NEARBY
from .problem import CompiledProblem
from .structures import NODES
from .tape import ContactTape

if TYPE_CHECKING:
    from ..flying_stepper import FlyingStepper


def meets_obstacles(contacts: ContactSet) -> bool:
    """Whether all that may touch are nodes of fields before obstacles."""
    return all(type(pair) is ObstaclePair and pair.slave.trace in contacts.on_fields for pair in contacts.pairs)


class Encounters(Surroundings):
    """Obstacles whose contacts compiled steps find too: ``problem`` finds forces by the ``compliance``, of a ``driver``."""

    def __init__(
        self,
        about: tuple[Tables, System, float],
        by: tuple[CompiledProblem, Compliance, FieldDriverSolver],
        *,
        smooth: bool,
    ) -> None:
        """``about``: what :class:`Surroundings` takes."""
        super().__init__(*about, smooth=smooth)
        self.problem, self.compliance, self.driver = by
        c, o = self.contacts, self.flight
        counts = [pair.count for pair in self.listed]
        self.node = np.concatenate([pair.slave.surface.nodes for pair in self.listed])
        self.trace = np.repeat([pair.slave.trace for pair in self.listed], counts)
        self.traces = list(c.on_fields)
        self._nodes_of_traces = (NODES * len(self.traces))()
        self._first = self.c.now.gap  # of the two rooms that C takes in turn
        self._room = 0, 0  # rows that there is room for, and columns

        o.problem, o.most = ctypes.addressof(self.problem.c), self.compliance.most
        o.nodes = ctypes.addressof(self._nodes_of_traces)
        o.nodes_of = self._array("nodes of", [self.traces.index(pair.slave.trace) for pair in self.listed], np.int32)
        o.node = self._array("node", self.node, np.int32)
        o.listed, o.near = (self._zeros(name, self.c.points, np.int32) for name in ("listed", "near"))
        o.sways = self._zeros("sways", self.tables.system.n_frames, np.int32)
        o.factored = self._zeros("factored", self.tables.system.n_q)
        self._share_out()

    def _share_out(self) -> None:
        """Where what is kept with a state stands."""
        m, pairs, d, o = self.c.points, self.c.pairs, self.tables.dim, self.flight
        shapes = {
            "since": (pairs,),
            "impulse": (pairs, d),
            "held": (m, self.c.components),
            "force": (m, d),
            "near": (m,),
        }
        self._places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        self._kept = KEPT
        for name, shape in shapes.items():
            self._places[name] = slice(self._kept, self._kept + math.prod(shape)), shape
            self._kept += math.prod(shape)
        o.at_since, o.at_impulse, o.at_held, _, o.at_near = (span.start for span, _ in self._places.values())

    @property
    def kept(self) -> int:
        """As :attr:`Surroundings.kept`."""
        return self._kept

    def _part(self, own: Array, name: str) -> Array:
        """Some of the numbers that are kept with a state, in their shape."""
        span, shape = self._places[name]
        return own[span].reshape(shape)

    def begin(self, stepper: FlyingStepper, own: Array) -> None:
        """As :meth:`Surroundings.begin`."""
        super().begin(stepper, own)
        books, known = stepper.ledger, stepper.confirmed
        self.counts = books.counts
        self._part(own, "since")[:] = books.touching
        self._part(own, "impulse")[:] = books.impulse
        self._part(own, "held")[:] = books.force
        if known is not None:
            self._part(own, "near")[:] = np.frombuffer(bytes.fromhex(known.candidates), dtype=bool)
        sways = self.arrays["sways"]
        for field in self.tables.fields:
            sways[field.part.frame] = field.c.sways

    def _near(self, own: Array) -> np.ndarray:
        return self._part(own, "near") != 0.0

    def _take_books(self, stepper: FlyingStepper, s: State, own: Array) -> ContactState:
        books, c = stepper.ledger, self.contacts
        books.take(own[:CONFIRMED])
        books.touching = [int(x) for x in self._part(own, "since")]
        books.impulse, books.force = self._part(own, "impulse").copy(), self._part(own, "held").copy()
        self.problem.count(books.counts)

        m, carried = self.c.points, books.force[:, 0].copy()
        x, normal = (self._looked_at(name).reshape(m, -1).copy() for name in ("x", "normal"))
        found = ContactForces(
            c.names, float(own[TIME]), c.pair, x, normal, self._looked_at("gap").copy(), carried, self._part(own, "force").copy(),
            c.pressures(carried), books.impulse, books.work.copy(),
        )  # fmt: skip
        return ContactState(s.t, s.q, s.v, s.a, s.lam, found)

    def _looked_at(self, name: str) -> Array:
        """What C has seen of all points in the newest state."""
        found: Array = self.arrays[f"{'now' if self.c.now.gap == self._first else 'end'} {name}"]
        return found

    def tape(self, march: FreeMarch, judged: Openness) -> Tape:
        """As :meth:`Surroundings.tape`, with all that is told of contacts."""
        return EncounterTape(march.tables, judged, self.contacts, self.system)

    def _answer(self, what: int, number: int, t: float) -> None:
        if what == NEARBY:
            self._make_ready(number)
        elif what == COMPLEMENTARITY:
            W, opening, mu, force = self.problem.posed
            force[:] = small_problem(None, W, (opening, mu), force, self.counts)
        else:
            super()._answer(what, number, t)

    def _make_ready(self, count: int) -> None:
        """Compliances of those near, and room for so many."""
        near = self.arrays["near"][:count]
        o, blocks, system = self.flight, self.driver.blocks, self.system
        self.problem.take_size(count)
        first = np.cumsum([0, *(block.Y.shape[1] for block in blocks)])
        for i, one in zip(self.traces, self._nodes_of_traces, strict=True):
            k = system.field_number(self.contacts.traces[i].part)
            C, Y = self.compliance.on_surface(i, blocks[k], self.node[near[self.trace[near] == i]])
            self.arrays[f"C {i}"], self.arrays[f"Y {i}"] = C, Y
            one.size, one.columns, one.at = len(C), Y.shape[1], int(first[k])
            one.C, one.Y = address_of(C), address_of(Y)
        o.columns = int(first[-1])
        on = self.arrays["on"]
        moving = any(self.contacts.traces[i].moving for i in self.traces)
        o.coupled = int(moving or o.columns > 0 or bool((on[:, 1] >= 0).any()))

        self._make_room(count * self.c.components, o.columns)

    def _make_room(self, rows: int, columns: int) -> None:
        """Room for so many rows of those near, and for columns of the fields."""
        if rows <= self._room[0] and columns == self._room[1]:
            return
        self._room, d, core = (rows, columns), self.tables.dim, self.tables.system.n_core
        sizes = {"rows": d + 2 * self.tables.twist, **dict.fromkeys(("direction", "axes"), d)}
        sizes |= dict.fromkeys(("start", "change", "stopped", "rates"), 1) | dict.fromkeys(("push", "answer"), core)
        for name, size in (sizes | dict.fromkeys(("seen", "acting"), columns)).items():
            setattr(self.flight, name, self._zeros(name, rows * size))


class EncounterTape(ContactTape):
    """Room for the records of such steps."""

    stops_at = Tape.stops_at  # no impact cuts them


def march_of(stepper: FlyingStepper, states: DriverStates, room: int) -> FreeMarch:
    """The march of a stepper by some states, with so much room to work in."""
    driver, problem = stepper.solver.driver, stepper.problem
    assert isinstance(driver, FieldDriverSolver)
    about = states.tables, stepper.system, stepper.share
    if stepper.meets and problem is not None:
        by = problem, stepper.compliance, driver
        around: Surroundings = Encounters(about, by, smooth=stepper.smooth)
    else:
        around = Surroundings(*about, smooth=stepper.smooth)
    return FreeMarch(states, around, stepper.maker, room=room)
