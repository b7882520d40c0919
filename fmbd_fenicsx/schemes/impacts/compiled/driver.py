"""Contact of points with obstacles, and stops, in the compiled driver: tables, and the march through flights, contacts, impacts.

Frames, joints and forces are those of the driver's tables; Python is entered for the poses of obstacles that move as prescribed
and for distances to shapes of the user's own; steps whose contact forces are hard to find are NumPy's, which pivots.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ....errors import ConvergenceError
from ....kernel_cache import address_of
from ....linear.complementarity.coulomb import PAINLEVE, PIVOTED
from ....mechanics.contact.contact_set import SIGHT, ContactSet
from ....mechanics.contact.limits import LimitPair
from ....mechanics.contact.obstacle_pair import ObstaclePair
from ....mechanics.joints.relative import ExpressedCoordinate
from ....rotations import Array
from ....system.compiled import march as slots
from ....system.compiled.blocks import Ring, block_size, state_of
from ....system.compiled.calls import Calls
from ....system.compiled.choice import driver_of
from ....system.compiled.declarations import enumeration
from ....system.compiled.kept import Kept, blocks_of
from ....system.compiled.library import CONTACT
from ....system.compiled.tables.tables import Tables
from ....system.layout import State, States
from ....system.speed_rows import speed_rows
from ....system.system import System
from ...marching import lend_newton
from ..contact_detection import tell_rest
from .pairs import RESTED, PairTables
from .spheres import Spheres
from .structures import BY_COMPONENT, Blocks, Contacts, Graph, Problem, Tree, structure
from .tape import ContactTape

if TYPE_CHECKING:
    from ....system.compiled.tape import Openness, Tape
    from ...newton import Newton
    from ..moreau import Moreau


@dataclass(frozen=True, eq=False)
class Trees:
    """Parts of a system that nothing couples: a force on a body moves its own part only (``driver/contact/compliance.c``). Fronts
    and bodies of each, ascending; ``tree_of`` (bodies,): which one a body is in.
    """

    fronts: list[np.ndarray]
    bodies: list[np.ndarray]
    tree_of: np.ndarray


def trees_of(tables: Tables) -> Trees:
    """Those of the step's matrix; a single one where efforts may answer to bodies that they do not act on."""
    fronts = tables.fronts
    root = np.arange(len(fronts.fronts))

    # a front is added to one that comes later
    for k in reversed(range(len(root))):
        following = fronts.fronts[k].following
        if following >= 0:
            root[k] = root[following]
    if tables.c.linkable:
        root[:] = 0

    # attitudes that nothing but rows of their own acts on go with their bodies
    root[fronts.front_of[tables.at_u + tables.twist - 1]] = root[fronts.front_of[tables.at_u]]

    _, tree = np.unique(root, return_inverse=True)
    tree_of = tree[fronts.front_of[tables.at_u]]
    count = int(tree.max(initial=-1)) + 1
    return Trees(_split(tree, count), _split(tree_of, count), tree_of)


def _split(number: np.ndarray, count: int) -> list[np.ndarray]:
    """Places of each number from 0 to count - 1, ascending."""
    order = np.argsort(number, kind="stable")
    return np.split(order, np.searchsorted(number[order], np.arange(1, count)))


BOUNDED = slots.AM
STRUCK = enumeration("STRUCK", "impacts/moreau.c")["STRUCK"]
MOST = 1024  # contacts closed at once: a step with more is NumPy's


def known(contacts: ContactSet, pair: Any) -> bool:
    """Whether the driver knows a pair: stops of a coordinate; points of bodies without a field, and an obstacle or a surface."""
    if type(pair) is LimitPair:
        return not isinstance(pair.relative, ExpressedCoordinate)
    if pair.slave.trace in contacts.on_fields:
        return False
    if not pair.searches:
        return type(pair) is ObstaclePair
    from .facets import is_known

    return pair.master.trace not in contacts.on_fields and is_known(pair)


def numbers(address: int, size: int) -> Array:
    """So many numbers at an address, as C sees them."""
    return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), (size,))


class ContactDriver(PairTables):
    """The driver for one system with contact: tables, calls into Python, and three states in turn."""

    def __init__(self, system: System, plain: System, library: Any, rule: Moreau, *, redundant: int) -> None:
        self.rule, self.accumulations = rule, 0
        self.library = library
        stops = [pair.relative for pair in system.contacts.pairs if isinstance(pair, LimitPair)]
        super().__init__(Tables(plain, redundant=redundant, coordinates=stops), system)
        self.calls = Calls(self.tables)
        self.n, self.nq, self.m = system.n_v, system.n_q, system.n_lam
        self.ring = Ring(system, 3)
        self.parameters = np.zeros(slots.PARAMETERS)
        self.parameters[BOUNDED] = float(np.isfinite(self.contacts.thickness).any())

        self.c = self._contacts()
        self._verdict = ctypes.c_int(0)
        self._tape: ContactTape | None = None

    def _contacts(self) -> ctypes.Structure:
        """The structure, with all of its arrays."""
        s, contacts = self.system, self.contacts
        m = len(contacts.pair)
        d = s.motions.dim
        k = d if contacts.frictional else 1
        room = min(m, MOST)
        rows = room * k
        wide = s.motions.n_twist + int(self.tables.modes.max(initial=0))
        common, pairs = self._common(), self.pairs[: len(contacts.pairs)]
        spheres = Spheres(contacts.pairs, [one.carrier for one in pairs], d)
        for one, first in zip(pairs, spheres.first, strict=True):
            one.mover = int(first)

        sizes = {
            "held": m * k, "force": m * d, "normal": m, "impulse": len(contacts.pairs) * d, "works": 5, "drift": rows, "rate": m,
            "before": rows, "rebound": room, "slip": rows,
            "rows": 2 * (rows + k) * wide, "Y": rows * self.n, "push": self.n + self.m, "open": rows, "old": rows,
            "turns": self.tables.nb * d * d, "least": (41 + 4 * k) * rows, "ahead": self.nq, "xi": self.n, "still": self.n,
            "kept": self.m + 1,
            "saved": m * k + len(contacts.pairs) * d + 7, "rested": m,
            "struck": STRUCK, "path": (2 * self.rule.impacts + 2) * block_size(s),
        }  # fmt: skip
        counts = {"carrying": m, "closed": m, "bouncing": m, "hits": 2 * m, "was": m, "candidate": m, "known_of": room}
        counts |= {"states": 2 * room, "near": len(contacts.pairs), "listed": len(contacts.pairs)}
        sizes |= {"lower": len(spheres.spheres), "stood": len(spheres.spheres) * (d + d * d)}
        places = {name: self._zeros(name, size) for name, size in sizes.items()}

        return Contacts(
            **common, **self._spheres(spheres), **self._trees(), **self._problem(room, k),
            room=room, stops=len(self.stops), wide=wide,
            **{name: self._zeros(name, size, np.int32) for name, size in counts.items()},
            loaded=int(bool(s.forces)), size=self.n, most=2 * self.rule.impacts, early=int(self.rule.early),
            **places,
        )  # fmt: skip

    def _problem(self, room: int, k: int) -> dict[str, Any]:
        """The small problem of so many closed contacts in k components, the graph of those that move each other, and factors."""
        pairs = room * (room - 1)
        ints = dict.fromkeys(
            ("gathered", "arranged", "next", "seen", "taken", "member", "found", "place", "order"), room
        )
        ints |= {"group": room + 1, "next": 2 * room, "head": len(self.tree), "bits": 2 * (room + 1) * (room // 64 + 1)}
        pattern = {"first": room + 1, "near": pairs, "slot": pairs, "start": room + 1, "behind": pairs // 2}
        at = {name: self._zeros(f"graph {name}", size, np.int32) for name, size in (ints | pattern).items()}
        values = {"own": room * k * k, "W": pairs * k * k, "mu": room, **dict.fromkeys(BY_COMPONENT, room * k)}
        problem = {name: self._zeros(f"problem {name}", size) for name, size in values.items()}
        factor = {"own": room * k * k, "size": room, "upper": pairs // 2 * k * k, "lower": pairs // 2 * k * k}
        blocks = {name: self._zeros(f"factor {name}", size) for name, size in factor.items()}

        return {
            "all": Problem(**{name: at[name] for name in pattern}, **problem),
            "graph": Graph(**at),
            "blocks": Blocks(**blocks),
        }

    def _trees(self) -> dict[str, int]:
        """Parts of the system that nothing couples."""
        found = trees_of(self.tables)
        made = [
            Tree(len(f), len(b), self._array(f"fronts {i}", f, np.int32), self._array(f"bodies {i}", b, np.int32))
            for i, (f, b) in enumerate(zip(found.fronts, found.bodies, strict=True))
        ]
        self.tree = (Tree * len(made))(*made)
        tree_of = self._array("tree_of", found.tree_of, np.int32)
        return {"trees": len(made), "tree": ctypes.addressof(self.tree), "tree_of": tree_of}

    def _spheres(self, found: Spheres) -> dict[str, int]:
        """What the driver reads of spheres."""
        kind = structure("Mover", self.tables.dim)
        made = [kind(x.body, tuple(x.place), x.extent, x.reach) for x in found.spheres]
        self.movers = (kind * len(made))(*made)
        order = np.arange(len(made))
        tables = {"single": found.single, "start": found.start, "partner": found.partner, "order": order}
        addresses = {name: self._array(name, x, np.int32) for name, x in tables.items()}
        return {"movers": len(made), "singles": len(found.single), "mover": ctypes.addressof(self.movers), **addresses}

    # -- calls of C ----------------------------------------------------------------------------------------------------------
    def _answer(self, what: int, number: int, t: float) -> None:
        """As :meth:`PairTables._answer`, of rests too."""
        if what == RESTED:
            self.accumulations += 1
            tell_rest(self.contacts, number, t)
        else:
            super()._answer(what, number, t)

    # -- the march -----------------------------------------------------------------------------------------------------------
    def load(self, t: float, state: tuple[Array, Array, Array, Array]) -> None:
        """Begin from t, q, v, a, lambda."""
        q, v, a, lam = state
        self.ring.load([(t, q, v, a, np.zeros(self.n), lam)])
        self.c.known = 0

    def tape(self, judged: Openness) -> ContactTape:
        """Room for records, the same for all marches."""
        if self._tape is None:
            about = self.tables, judged, self.contacts, self.system
            within = ContactTape(*about, gaps=self._gaps)
            kept = Kept(
                self.library, self.tables, self.calls, within, own=within.numbers, parts=2 * self.rule.impacts + 1
            )
            self._tape = ContactTape(*about, kept)
        return self._tape

    def _gaps(self, states: States, numbers: Array) -> bool:
        """Write gaps (m) of all points in k states in front of ``numbers`` (k, ..); whether there are some."""
        blocks = blocks_of(self.tables.twin, states)
        count, wide = numbers.shape
        into, reach = address_of(numbers), SIGHT * self.system.length
        found = self.library.moreau_gaps(ctypes.addressof(self.c), count, address_of(blocks), wide, into, reach)
        return not found

    def march(self, h: float, steps: int, newton: Newton, tape: Tape | None = None) -> int:
        """Make up to so many steps, recorded on the ``tape``; the number made."""
        p = self.parameters
        lend_newton(p, self.system, newton)
        p[slots.H], p[slots.THETA], p[slots.COUNTED], self.c.unsolved = h, newton.theta, 0.0, 0
        made = self.library.moreau_march(
            ctypes.addressof(self.tables.c), ctypes.addressof(self.c), p.ctypes.data, steps, self.ring.address,
            ctypes.byref(self._verdict), None if tape is None else tape.address,
        )  # fmt: skip
        self.calls.error = None  # NumPy's step raises it again, with the name of the law
        return int(made)

    @property
    def unsolved(self) -> ConvergenceError | None:
        """Why forces of the last step were not found, where NumPy, which pivots in small groups, would not find them either."""
        m = self.c.unsolved
        if self.c.components == 1 or m <= PIVOTED:
            return None
        return ConvergenceError(f"Forces of {m} contacts that move each other were not found.{PAINLEVE}")

    def stations(self) -> list[State]:
        """States at the start of the last step and at the ends of its parts."""
        blocks = self.arrays["path"].reshape(-1, block_size(self.system))
        return [state_of(self.system, x) for x in blocks[: self.c.parts + 1]]

    def touching(self) -> tuple[Array, Array, Array]:
        """Gaps (m,), places and normals (m, d) of all points at the newest state."""
        m = self.c.points
        d = self.system.motions.dim

        now = self.c.now
        places, normals = (numbers(at, m * d).reshape(m, d).copy() for at in (now.x, now.normal))
        return numbers(now.gap, m).copy(), places, normals


def contact_driver(system: System, rule: Moreau, *, redundant: int) -> ContactDriver | None:
    """The driver for a system with contact under a rule for impacts, or None where the NumPy path has to do."""
    contacts = system.contacts
    if system.fields:
        return None
    if not all(known(contacts, pair) for pair in contacts.pairs):
        return None
    plain = replace(system, contacts=None, cache={})
    if speed_rows(plain).size:
        return None
    library = driver_of(plain, CONTACT)
    return None if library is None else ContactDriver(system, plain, library, rule, redundant=redundant)
