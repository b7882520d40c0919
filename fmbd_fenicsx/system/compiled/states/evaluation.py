"""A system evaluated by the driver: one configuration, or many in a call.

What schemes in Python ask for at every stage, the balance and the constraints with their derivatives, comes from the driver's
tables, to roundoff the numbers of :class:`~...evaluation.Evaluation`, and so are energies. Markers and momenta are NumPy's, made
when someone asks for them (:mod:`.driver_evaluation`). Solutions are those of its :mod:`.factor`. Systems without elastic fields.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

import numpy as np

from ....errors import require
from ....kernel_cache import address_of, addresses_of
from ....rotations import Array
from ...evaluation import Evaluation
from ...evaluator import NumPyEvaluator, Seen
from ...system import System
from ..calls import Calls
from ..declarations import enumeration
from ..library import IMPLICIT, driver_library, units_of
from ..order import LOCKED
from ..tables.resting import Twin
from ..tables.structures import zeros_of
from ..tables.tables import Tables
from .driver_evaluation import DriverBatch, DriverEvaluation
from .exchange import Room
from .factor import DriverFactor
from .points import LocalPoints, Metric, PointsTold

if TYPE_CHECKING:
    from ...layout import State

NOWHERE = (None, 0)  # an array that is not given


class Widening(NamedTuple):
    """Arrays like q, or like v: how long they are, how they get as long as the driver's, and how long these are; the way back."""

    size: int
    widened: Callable[[Array], Array]
    wide: int
    narrowed: Callable[[Array], Array]


class CompiledGeometry:
    """What :class:`~...evaluator.NumPyEvaluator` tells of configurations, for systems that the driver knows."""

    system: System
    library: Any
    address: int
    twin: Twin  # between arrays of the system and those of the driver

    def compose(self, q: Array, xi: Array) -> Array:
        """q o exp(xi); leading axes broadcast."""
        made = self._made(self.library.driver_compose, self._places, (q, self._places), (xi, self._rates))
        return NumPyEvaluator(self.system).compose(q, xi) if made is None else made

    def difference(self, q0: Array, q1: Array, near: Array | None) -> Array:
        """The increment xi with q0 o exp(xi) = q1: of all rotations the smallest, or the one nearest to that of ``near``."""
        at = self._places
        made = self._made(self.library.driver_difference, self._rates, (q0, at), (q1, at), (near, self._rates))
        return NumPyEvaluator(self.system).difference(q0, q1, near) if made is None else made

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of local coordinates q o exp(xi) for the velocity v; leading axes broadcast."""
        made = self._made(self.library.driver_rate, self._rates, (xi, self._rates), (v, self._rates))
        return NumPyEvaluator(self.system).rate(xi, v) if made is None else made

    def know_twin(self) -> None:
        """Take the kinds of arrays of the system and of its twin."""
        own, twin = self.system, self.twin
        self._places = Widening(own.n_q, twin.configurations, twin.system.n_q, twin.places)
        self._rates = Widening(own.n_v, twin.velocities, twin.system.n_v, twin.forces)

    def _made(self, function: Any, kind: Widening, *given: tuple[Array | None, Widening]) -> Array | None:
        """Rows of a kind that C makes of arrays, each of its own; None where NumPy has to: of configurations of the core alone,
        of complex numbers, of leading axes that are neither alike nor missing, and where C has something to say.
        """
        lead: list[int] = []
        wide: list[int | None] = []
        kept = []  # alive until C is done
        for x, of in given:
            if x is None:
                wide.append(None)
                continue
            *axes, count = x.shape
            if count != of.size or x.dtype != np.float64 or (axes and lead and axes != lead):
                return None
            lead = axes or lead
            kept.append(np.ascontiguousarray(of.widened(x)))
            wide.append(of.wide if axes else 0)

        kept.append(made := np.empty((*lead, kind.wide)))
        known = iter(addresses_of(kept))
        places = [y for n in wide for y in (NOWHERE if n is None else (next(known), n))]
        failed = function(self.address, made.size // kind.wide, *places, next(known))
        return None if failed else kind.narrowed(made)


FORGETS, RECALLS, ANEW = enumeration("FORGETS").values()  # of what depends on time only
FEW, ROOMS = 4, 16  # configurations for which arrays are made at least; up to which they are kept

Configurations = tuple[Array, Array, Array]  # t (k,), q (k, n_q), v (k, n_v)


class DriverStates(CompiledGeometry):
    """The driver of a system, for states that Python asks for; arrays have the configurations in front, (k, ..)."""

    solves = True  # whether it factors matrices too

    def __init__(self, system: System, library: Any) -> None:
        self.system, self.library = system, library
        self.factor = DriverFactor(self)
        self.taken: bool = False
        self.dependent = 0  # corrections of rows that depend on each other: multipliers are the smallest then
        self.address: int = 0
        self.renew()

    def renew(self) -> None:
        """Tables of its own, after steps have taken the former ones."""
        self.tables = self.tables_of()
        self.calls = Calls(self.tables)
        self.address = ctypes.addressof(self.tables.c)
        self.taken = False
        self.anew = True  # whether laws are asked again: a state was taken since, or the tables are new
        self.twin = self.tables.twin  # between arrays of the system and those of the tables
        self.same_rows = self.twin.system is self.system  # whether the driver's configurations are the system's own
        self.know_twin()
        self.factor.renew()
        self._kept_room: Room | None = None
        self._last: DriverEvaluation | None = None  # made by :meth:`at`
        self._points = LocalPoints(self)
        tables = self.tables
        self.recalls = bool(tables.sampled or tables.remembering)  # whether elements have a memory

    @cached_property
    def implicit(self) -> Any:
        """The driver with the stages of implicit schemes beside, which are compiled where one of these runs."""
        made = driver_library(self.system.motions.dim, (*units_of(self.twin.system), IMPLICIT))
        require(
            made is not None,
            "The steps of implicit schemes are not compiled, for the reason above; CC=none runs all in NumPy.",
        )
        return made

    def tables_of(self) -> Tables:
        """New tables of the system."""
        return Tables(self.system, redundant=self.dependent)

    def unlock(self) -> bool:
        """Let rows that others lock wait for their loops, as the newest factor has found them; whether there are new ones."""
        known = self.system.cache.get(LOCKED, frozenset())
        locked = known.union(np.flatnonzero(self.tables.arrays["locked"]).tolist())
        if locked == known:
            return False
        self.system.cache[LOCKED] = locked
        self.renew()
        return True

    def let_depend(self, corrections: int) -> None:
        """Solve for rows that depend on each other from now on, with so many corrections of a solution."""
        if not self.dependent:
            self.dependent, self.factor.held = corrections, None
            self.tables.c.redundant = corrections

    @property
    def remembers(self) -> bool:
        """Whether forces depend on more than a state: elements have a memory."""
        return bool(self.tables.c.remembers or self.tables.sampled)

    def give(self) -> tuple[Tables, Calls]:
        """The tables, for steps; they begin with new slopes of forces in Python."""
        if self.taken:
            self.renew()
        self.taken, self.factor.held = True, None
        for loads in self.tables.whole:
            loads.astray[0] = 1
        return self.tables, self.calls

    @contextmanager
    def back(self) -> Iterator[None]:
        """Tables that steps have taken are one's own meanwhile, between two of them."""
        self.taken, self.factor.held = False, None
        try:
            yield
        finally:
            self.give()

    def begin_anew(self) -> None:
        """Serve another run, the one before is over: tables that remember nothing of its steps serve again."""
        if self.taken and (self.remembers or self.tables.whole):
            self.renew()
        self.taken, self.factor.held = False, None

    def at(self, t: float, q: Array, v: Array | None = None) -> DriverEvaluation:
        """The system in one configuration (and velocity); what was found of the one before is taken where it is the same."""
        last = self._last
        if last is not None and last.is_at(t, q, v):
            return last.again()
        self.anew = True
        # apart from arrays that a caller may write into later
        made = DriverEvaluation(self, t, q.copy(), None if v is None else v.copy())
        # what depends on time may be an input, and another one when it is asked again
        self._last = None if self.remembers or self.tables.c.samples else made
        return made

    def evaluated(self, ev: Evaluation) -> TypeGuard[DriverEvaluation]:
        """Whether a state is one of :meth:`at`."""
        return isinstance(ev, DriverEvaluation) and ev.states is self

    def batch(self, t: Array, q: Array, v: Array) -> DriverBatch:
        """Configurations at the times t (k,): q (k, n_q), v (k, n_v)."""
        self.anew = True
        return DriverBatch(self, t, q, v)

    def points(
        self, t: Array, q0: Array, points: tuple[Array, Array, Array], forces: tuple[Array, Array | None, Metric | None]
    ) -> PointsTold | None:
        """What an implicit step asks of points in local coordinates, see :class:`.LocalPoints`."""
        return self._points.told(t, q0, points, forces) if self.same_rows else None

    def glance(self, units: Array, *, energies: bool, balance: bool) -> DriverGlance | None:
        """Who looks at many states for the judges of a run, see :class:`.Glance`; None where rows or forces are NumPy's too."""
        if not self.same_rows or self.system.fields:
            return None
        return DriverGlance(self, units, energies=energies, balance=balance)

    def balances(self, at: Configurations, a: Array, lam: Array) -> Array | None:
        """M a + h + G^T lambda, (k, n_v); None where NumPy has something to say."""
        room, places = self._loaded_room(at, a, lam)
        told = self.ask(self.library.driver_balances, *room.at, *places)
        return self.twin.forces(room.sums[: room.count]).copy() if told else None

    def together(self, at: Configurations, a: Array, lam: Array | None) -> tuple[Array, Array] | None:
        """:meth:`balances` and :meth:`constraints` in one call; None as above."""
        room, places = self._loaded_room(at, a, lam)
        if not self.ask(self.library.driver_batch, *room.at, *places, *room.constraints_at):
            return None
        sums, rows = room.sums[: room.count], room.constraints[:, : room.count]
        return self.twin.forces(sums).copy(), rows.copy()

    def _loaded_room(self, at: Configurations, a: Array, lam: Array | None) -> tuple[Room, list[int | None]]:
        """Room with configurations, accelerations and multipliers in it, and where the last two and the balance are."""
        room = self._room(at)
        room.a[: room.count] = self.twin.velocities(a)
        if lam is not None:
            room.lam[: room.count] = lam
        return room, [room.places["a"], None if lam is None else room.places["lam"], room.places["sums"]]

    def constraints(self, at: Configurations) -> Array | None:
        """g, G v + g_t, g_t and gamma, (4, k, n_lam). None as above."""
        found = self._constraints(at)
        return None if found is None else found.copy()

    def _constraints(self, at: Configurations) -> Array | None:
        """The same, a view."""
        room = self._room(at)
        asked = self.ask(self.library.driver_constraints, *room.at, *room.constraints_at)
        return room.constraints[:, : room.count] if asked else None

    def along(self, at: Configurations) -> Array | None:
        """G v, (k, n_lam), without G; None as above."""
        found = self._constraints(at)
        return None if found is None else found[1] - found[2]

    def rows(self, at: Configurations) -> Array | None:
        """G, (k, n_lam, n_v); None as above."""
        out = np.empty((len(at[0]), self.system.n_lam, self.tables.system.n_v))
        asked = self.ask(self.library.driver_rows, *self._room(at).at, address_of(out))
        return self.twin.forces(out) if asked else None

    def energies(self, at: Configurations) -> Array | None:
        """Kinetic, elastic, of the weight and of springs, J, (k, 4); None as above, or where laws in Python store some."""
        looks = self.tables.looks
        if not looks.energies_known:
            return None
        room = self._room(at)
        asked = self.ask(self.library.driver_energies, *room.at, room.places["energies"])
        return room.energies[: room.count].copy() if asked else None

    def work(self, at: Configurations, xi: Array) -> float | None:
        """Work of force elements in one configuration along an increment xi; None as above."""
        room = self._room(at)
        room.a[0] = self.twin.velocities(xi)
        of_state = room.places["q"], room.places["v"], room.places["a"], room.places["energies"]
        asked = self.ask(self.library.driver_work, float(at[0][0]), *of_state)
        return float(room.energies[0, 0]) if asked else None

    def _room(self, at: Configurations) -> Room:
        """Arrays for so many configurations, with these in them."""
        (t, q, v), twin = at, self.twin
        count = len(t)
        room = self._kept_room
        if room is None or room.most < count:
            room = Room(self.tables.system, max(count, FEW))
            if count <= ROOMS:
                self._kept_room = room
        room.at[0] = room.count = count
        for x, value in zip(room.state, (t, twin.configurations(q), twin.velocities(v)), strict=True):
            x[:count] = value
        return room

    def sway(self, corrected: bool) -> None:
        """Nothing sways where there are no fields."""

    def ask(self, function: Any, *given: float | None) -> bool:
        """One call of C for many configurations, with numbers and addresses; whether they have been evaluated."""
        if self.recalls:
            self.tables.recall()
        c = self.tables.c
        c.recalls = ANEW if self.anew else RECALLS
        verdict = function(self.address, *given)
        c.recalls, self.anew = FORGETS, c.recalls == ANEW
        if self.calls.error is not None or self.calls.asked:
            self.calls.raise_error()
        return not verdict


class DriverGlance:
    """A :class:`.Glance` of one system: what the judges of a run ask of every state that a step ends in, in one call of C."""

    def __init__(self, states: DriverStates, units: Array, *, energies: bool, balance: bool) -> None:
        """``units``: what turns values of constraints into lengths, (n_lam,)."""
        self.states, self.length = states, states.tables.system.length
        s, looks = states.tables.system, states.tables.looks
        made = zeros_of({
            "q": s.n_q, "v": s.n_v, "a": s.n_v, "lam": s.n_lam, "units": s.n_lam,
            "found": len(Seen._fields), "energies": 4, "sums": s.n_v, "room": 2 * s.n_lam,
        })  # fmt: skip
        known = energies and looks.energies_known
        self.q, self.v, self.a, self.lam = (made[name][0] for name in ("q", "v", "a", "lam"))
        self.found = made["found"][0]
        self._energies: Array | None = made["energies"][0] if known else None
        self.energies: list[float] | None = None
        self.sums: Array | None = made["sums"][0] if balance else None

        made["units"][0][:] = units
        told = {"energies": known, "sums": balance}
        names = "units", "q", "v", "a", "lam", "found", "energies", "sums", "room"
        self.at = [made[name][1] if told.get(name, True) else None for name in names]

    def of(self, state: State) -> Seen | None:
        """What a state shows; None where NumPy has to look."""
        states = self.states
        if states.taken:
            return None
        self.q[:], self.v[:], self.a[:], self.lam[:] = state.q, state.v, state.a, state.lam
        states.anew = True
        told = states.ask(states.library.driver_look, state.t, self.length, *self.at)
        if not told:
            return None
        if self._energies is not None:
            self.energies = list(map(float, self._energies))
        return Seen(*map(float, self.found))
