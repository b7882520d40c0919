"""Contacts in compiled steps of elastic bodies (``driver/contact/elastic_contact.c``): room for those near, and their books."""

from __future__ import annotations

import ctypes
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from ....kernel_cache import address_of
from ....linear.complementarity.delassus import Compliance
from ....linear.driver_solver import FieldDriverSolver
from ....mechanics.contact.contact_set import NEAREST
from ....rotations import Array
from ....system.compiled.choice import driver_of
from ....system.compiled.declarations import enumeration
from ....system.compiled.library import CONTACT
from ....system.compiled.march import March
from ....system.compiled.states.evaluation import DriverStates
from ....system.compiled.tables.tables import Tables
from ....system.compiled.tape import Openness, Tape
from ....system.layout import State
from ....system.sensors.contact import ContactForces, ContactState
from ..contact_ledger import SHORT
from ..contact_newton import small_problem
from ..elastic_step import MARGIN, RELIED, Confirmed
from .pairs import COMPLEMENTARITY, NEARBY, PairTables
from .problem import CompiledProblem
from .structures import BOOKS, ELASTIC_CONTACT, NODES, Contacts
from .tape import ContactTape

if TYPE_CHECKING:
    from ..elastic_contact_stepper import ElasticContactStepper

_NUMBERS = enumeration("LOADS", BOOKS)  # of what is kept with a state
CONFIRMED, TIME, KEPT = (_NUMBERS[x] for x in ("CONFIRMED", "TIME", "KEPT"))


class Encounters(PairTables):
    """What the fields of a stepper may touch, and the books of it; ``by``: who finds forces, a compliance, and its driver."""

    def __init__(
        self, tables: Tables, stepper: ElasticContactStepper, by: tuple[CompiledProblem, Compliance, FieldDriverSolver]
    ) -> None:
        super().__init__(tables, stepper.system)
        laws = self.contacts.pairs
        self.problem, self.compliance, self.driver = by
        self.laws, self.candidates = len(laws), len(self.contacts.pair)

        s, m = tables.system, self.candidates
        self.c = Contacts(**self._common())

        system = self.system
        self.structure = ELASTIC_CONTACT(
            contacts=ctypes.addressof(self.c), share=stepper.share, least=NEAREST * system.length,
            loaded=int(bool(system.forces)), smooth=int(stepper.smooth), length=system.length,
            linear=int(not any(part.field.nonlinear for _, part in system.fields)),
            search=self._array("search", [np.nan if pair.search is None else pair.search for pair in laws]),
            room=self._zeros("room", 3 * s.n_v + s.n_q + 4 * s.n_lam), margin=MARGIN, relies=RELIED, brief=SHORT,
            problem=ctypes.addressof(self.problem.c), most=self.compliance.most_stored(self.c.components),
            utmost=self.compliance.most,
            listed=self._zeros("listed", m, np.int32), near=self._zeros("near", m, np.int32),
            sways=self._zeros("sways", s.n_frames, np.int32), factored=self._zeros("factored", s.n_q),
        )  # fmt: skip

        self.address: int = ctypes.addressof(self.structure)
        self._first = self.c.now.gap  # of the two rooms that C takes in turn
        self._room = 0, 0  # rows that there is room for, and columns
        self._take_traces()
        self._share_out()

    # -- what rows act on ----------------------------------------------------------------------------------------------------
    def _take_traces(self) -> None:
        """The nodes of all traces."""
        contacts, o = self.contacts, self.structure
        self.traces = list(contacts.on_fields)
        self._nodes_of_traces = (NODES * len(self.traces))()
        first = 0
        for i, one in zip(self.traces, self._nodes_of_traces, strict=True):
            trace = contacts.traces[i]
            one.size, one.first, one.body = trace.n, first, self.tables.system.parts[trace.part].frame
            one.numbers = self._array(f"numbers {i}", trace.own * self.tables.dim, np.int32)
            first += trace.n

        o.traces, o.nodes = len(self.traces), ctypes.addressof(self._nodes_of_traces)
        o.nodes_of = self._array("nodes of", [self.traces.index(pair.slave.trace) for pair in self.listed], np.int32)
        o.node = self._array("node", np.concatenate([pair.trace_nodes for pair in self.listed]), np.int32)
        o.touched, o.place, o.answered = (
            self._zeros(name, first, np.int32) for name in ("touched", "among", "answered")
        )
        o.reply = self._zeros("reply", first * self.tables.dim * self.c.components)

    # -- what is kept with a state -------------------------------------------------------------------------------------------
    def _share_out(self) -> None:
        """Where it stands."""
        m, d, o = self.candidates, self.tables.dim, self.structure
        shapes = {
            "since": (self.laws,),
            "impulse": (self.laws, d),
            "held": (m, self.c.components),
            "force": (m, d),
            "near": (m,),
        }
        self._places: dict[str, tuple[slice, tuple[int, ...]]] = {}
        self.kept = KEPT  # numbers with each state
        for name, shape in shapes.items():
            self._places[name] = slice(self.kept, self.kept + math.prod(shape)), shape
            self.kept += math.prod(shape)
        o.at_since, o.at_impulse, o.at_held, _, o.at_near = (span.start for span, _ in self._places.values())

    def _part(self, own: Array, name: str) -> Array:
        """Some of the numbers that are kept with a state, in their shape."""
        span, shape = self._places[name]
        return own[span].reshape(shape)

    def begin(self, stepper: ElasticContactStepper, own: Array) -> None:
        """A march begins from the newest state of a stepper; with that are kept ``own``."""
        self.c.known = self.structure.ready = 0
        self.arrays["answered"][:] = 0
        books, known = stepper.ledger, stepper.confirmed
        self.counts = books.counts
        own[:] = 0.0
        own[:CONFIRMED] = books.books
        self._part(own, "since")[:] = books.touching
        self._part(own, "impulse")[:] = books.impulse
        self._part(own, "held")[:] = books.force

        if known is not None:
            own[CONFIRMED:TIME] = known.h, known.first, known.second, known.relied
            self._part(own, "near")[:] = np.frombuffer(bytes.fromhex(known.candidates), dtype=bool)
        sways = self.arrays["sways"]
        for field in self.tables.fields:
            sways[field.part.frame] = field.c.sways

    def end(self, stepper: ElasticContactStepper, s: State, own: Array) -> ContactState:
        """It has ended in a state ``s``, with which ``own`` are kept: the stepper takes them, and the state with its contacts."""
        h, first, second, relied = (float(x) for x in own[CONFIRMED:TIME])
        near = self._part(own, "near") != 0.0
        stepper.confirmed = Confirmed(h, near.tobytes().hex(), first, second, int(relied)) if h else None

        books, c = stepper.ledger, self.contacts
        books.take(own[:CONFIRMED])
        books.touching = [int(x) for x in self._part(own, "since")]
        books.impulse, books.force = self._part(own, "impulse").copy(), self._part(own, "held").copy()
        self.problem.count(books.counts)

        m, carried = self.candidates, books.force[:, 0].copy()
        x, normal = (self._looked_at(name).reshape(-1, self.tables.dim)[:m].copy() for name in ("x", "normal"))
        found = ContactForces(
            c.names, float(own[TIME]), c.pair, x, normal, self._looked_at("gap")[:m] + self.arrays["offset"], carried,
            self._part(own, "force").copy(), c.pressures(carried), books.impulse, books.work.copy(),
        )  # fmt: skip
        return ContactState(s.t, s.q, s.v, s.a, s.lam, found)

    def _looked_at(self, name: str) -> Array:
        """What C has seen of all points in the newest state."""
        found: Array = self.arrays[f"{'now' if self.c.now.gap == self._first else 'end'} {name}"]
        return found

    # -- what Python is asked ------------------------------------------------------------------------------------------------
    def _answer(self, what: int, number: int, t: float) -> None:
        if what == NEARBY:
            self._make_ready(number)
        elif what == COMPLEMENTARITY:
            W, opening, mu, force = self.problem.posed
            force[:] = small_problem(None, W, (opening, mu), force, self.counts)
        else:
            super()._answer(what, number, t)

    def _make_ready(self, count: int) -> None:
        """Compliances of the nodes that those near act on, and room for so many."""
        o, blocks, system, a = self.structure, self.driver.blocks, self.system, self.arrays
        if o.applied:
            self._take_lumped(count)
            return
        self.problem.take_size(count)
        first = np.cumsum([0, *(block.Y.shape[1] for block in blocks)])
        for i, one in zip(self.traces, self._nodes_of_traces, strict=True):
            k, nodes = system.field_number(self.contacts.traces[i].part), a["touched"][one.begin : one.end]
            C, Y = self.compliance.on_surface(i, blocks[k], nodes)
            a[f"C {i}"], a[f"Y {i}"] = C, Y
            one.columns, one.at = Y.shape[1], int(first[k])
            one.C, one.Y = address_of(C), address_of(Y)
            a[f"Z {i}"] = Z = self.compliance.held(i)
            one.Z = address_of(Z) if Z.size else None
            a["answered"][one.first + nodes] = 1

        o.columns = int(first[-1])
        moving = any(self.contacts.traces[i].moving for i in self.traces)
        o.coupled = int(moving or o.columns > 0 or self._on_core)

        self._make_room(count * self.c.components, o.columns)

    def _take_lumped(self, count: int) -> None:
        """What is nearly the inverse of the compliance of so many that are near, and room for them."""
        coupled: Any = sp.csr_matrix((count, count))
        for i, one in zip(self.traces, self._nodes_of_traces, strict=True):
            acts = self._acting(i, count)
            if not acts.nnz:
                continue

            E, d = self.compliance.blocks.of(i), self.tables.dim
            blocks = sp.bsr_matrix(E, blocksize=(d, d))
            blocks.sort_indices()
            one.start, one.column = (
                self._array(f"{name} of E {i}", x, np.int32)
                for name, x in (("start", blocks.indptr), ("column", blocks.indices))
            )
            one.E = self._array(f"E {i}", blocks.data.ravel())
            beside = sp.csr_matrix((np.ones(len(blocks.indices)), blocks.indices, blocks.indptr), shape=(one.size,) * 2)
            coupled = coupled + acts @ beside @ acts.T
        self.problem.take_lumped(sp.csr_matrix(coupled + sp.identity(count)))
        self._make_room(count * self.c.components, 0)

    def _acting(self, i: int, count: int) -> Any:
        """Which nodes of a trace carry the multipliers of so many that are near, (count, n) sparse, with ones."""
        near, surface = self.arrays["near"][:count], self.arrays["surface"].reshape(-1, 2)[:, 0]
        n = self._nodes_of_traces[self.traces.index(i)].size
        found = sp.csr_matrix((count, n))

        for law, points in enumerate(map(int, surface)):
            if self.traces[self.arrays["nodes of"][points]] != i:
                continue
            mean, one, law_of = self._means[2 * law], self.pairs[points], self.pairs[law]
            first = np.array((ctypes.c_int * (law_of.count + 1)).from_address(mean.first))
            local = np.array((ctypes.c_int * int(first[-1])).from_address(mean.node), dtype=int)
            node = self.arrays["node"][one.first + local]
            acts = sp.csr_matrix((np.ones(len(node)), node, first), shape=(law_of.count, n))
            mine = np.flatnonzero((near >= law_of.first) & (near < law_of.first + law_of.count))
            chosen = sp.csr_matrix((np.ones(len(mine)), (mine, near[mine] - law_of.first)), shape=(count, law_of.count))
            found = found + chosen @ acts
        return sp.csr_matrix(found)

    @property
    def _on_core(self) -> bool:
        """Whether bodies without a field carry obstacles."""
        return any(one.carrier >= 0 for one in self.pairs if not one.meeting)

    def _make_room(self, rows: int, columns: int) -> None:
        """Room for so many rows of those near, and for columns of the fields."""
        if rows <= self._room[0] and columns == self._room[1]:
            return
        self._room, d, core = (rows, columns), self.tables.dim, self.tables.system.n_core
        sizes = {"rows": 2 * (d + self.tables.twist), "direction": d, "axes": 2 * d}
        sizes |= {"slopes": sizes["rows"], "sensed": sizes["axes"]}
        sizes |= dict.fromkeys(("start", "change", "stopped", "rates"), 1) | dict.fromkeys(("push", "answer"), core)
        for name, size in (sizes | dict.fromkeys(("seen", "acting"), columns)).items():
            setattr(self.structure, name, self._zeros(name, rows * size))


class EncounterTape(ContactTape):
    """Room for the records of such steps."""

    stops_at = Tape.stops_at  # no impact cuts them


class ContactMarch(March):
    """The march of a stepper by some states, with what its bodies meet, and so much room to work in."""

    def __init__(self, stepper: ElasticContactStepper, states: DriverStates, room: int) -> None:
        driver, problem = stepper.solver.driver, stepper.problem
        assert isinstance(driver, FieldDriverSolver) and problem is not None
        self.around = Encounters(states.tables, stepper, (problem, stepper.compliance, driver))
        library = driver_of(states.twin.system, CONTACT)
        super().__init__(library, states.tables, states.calls, stepper.maker, own=self.around.kept, room=room)

    def tape(self, judged: Openness) -> Tape:
        """Room for records with all that is told of contacts, not for instants within steps. Made once."""
        if self._tape is None:
            self._tape = EncounterTape(self.tables, judged, self.around.contacts, self.around.system)
        return self._tape
