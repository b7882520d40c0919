"""Records that the compiled loop makes: what sensors look at, asked for before a run, and read from many states at a time.

A sensor says what it looks at (:class:`Look`): the motion of a marker, a coordinate between two markers, the effort of an
element, the reaction of a joint. The driver writes these numbers, the energies and where needed the state at each record; the
sensor computes its series from :class:`Recorded` with arrays over all records. A sensor that cannot say what it looks at is read
from the states one by one.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.forces.effort_laws import EffortLaw
from ...mechanics.forces.force_elements import Loads, ScalarLoads, TimeLoads
from ...mechanics.joints.relative import Relative
from ...mechanics.kinds.frames import FRAME
from ...rotations import Array
from ..system import State, System
from .blocks import block_size, state_of
from .structures import address_of, zeros_of

if TYPE_CHECKING:
    from .tables import Tables

FIRST, CAPACITY = 64, 2048  # records between two visits of Python, at first and at most
BYTES = 1_000_000  # that they may take, so that they stay in the cache


@dataclass(frozen=True)
class Look:
    """What a sensor needs of each record beside the state: the motion of a ``marker``, a ``relative`` coordinate with its rate,
    the ``element`` with this name, the wrench of the ``joint`` with this name on its first body; ``rows``: all multipliers,
    ``whole``: the state itself. What is told of contacts is recorded at any rate.
    """

    marker: int = -1
    relative: Relative | None = None
    element: str = ""
    joint: str = ""
    rows: bool = False
    whole: bool = False


def readable(system: System, look: Look) -> bool:
    """Whether the driver can write what is looked at."""
    if look.element:
        scalar = [f for f in system.forces if type(f) is ScalarLoads or f.formulas()]
        return any(look.element == x.name for f in scalar for x in f.forces)
    if look.relative is None:
        return True
    if not look.relative.angular:
        return True
    if system.motions.dim == 2 or system.counted is None:
        return system.counted is not None
    known = set(zip(system.counted.turn.a, system.counted.turn.b, strict=True))
    return all(pair in known for pair in zip(look.relative.a, look.relative.b, strict=True))


class Looks:
    """What all sensors of a system look at, with the places of their numbers in a record."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.of: dict[int, Look] = {}  # by the identity of the sensor
        for sensor, marker in system.sensed:
            look = sensor.looks_at(system, marker)
            if look is not None and readable(system, look):
                self.of[id(sensor)] = look

        self.markers = sorted({x.marker for x in self.of.values() if x.marker >= 0})
        self.rows = any(x.rows for x in self.of.values())
        self.complete = len(self.of) == len(system.sensed) and self.energies_known  # no state is read on its own
        self.whole = any(x.whole for x in self.of.values()) or not self.complete
        self.joints = sorted({x.joint for x in self.of.values() if x.joint})
        self.relatives = [(key, x.relative) for key, x in self.of.items() if x.relative is not None]
        self.elements = {x.element for x in self.of.values() if x.element}
        self.slots: dict[Any, slice] = {}  # of a sensor's identity or an element's name
        self.count = 0

    def take_slots(self, key: Any, count: int) -> np.ndarray:
        """Numbers for so many items that are read."""
        self.slots[key] = slice(self.count, self.count + count)
        self.count += count
        return np.arange(self.count - count, self.count)

    def slots_of(self, loads: Loads) -> np.ndarray | None:
        """Numbers of the elements of a batch that are read or store energy in a law, -1 for the others; None without any."""
        out = np.full(len(loads.forces), -1)
        for i, f in enumerate(loads.forces):
            if f.name in self.slots:
                out[i] = self.slots[f.name].start
            elif f.name in self.elements or f in self._storing:
                out[i] = self.take_slots(f.name, 1)[0]
        return out if (out >= 0).any() else None

    @cached_property
    def stores(self) -> list[tuple[slice, EffortLaw]]:
        """Laws that store energy, with the places of their elongations."""
        return [(self.slots[f.name], f.law) for f in self._storing]

    @cached_property
    def _storing(self) -> list[Any]:
        """Elements with a law that stores energy and has no formula that the driver knows."""
        every = [f for loads in self.system.forces if type(loads) is ScalarLoads for f in loads.forces]
        laws = [f for f in every if isinstance(f.law, EffortLaw) and f.law.formula is None]
        return [f for f in laws if type(f.law).stored is not EffortLaw.stored]

    @cached_property
    def energies_known(self) -> bool:
        """Whether the driver and the laws tell all energies."""
        known = ScalarLoads, TimeLoads
        rest = [f for f in self.system.forces if type(f) not in known and not f.formulas() and f.mounts() is None]
        return all(type(f).energy is Loads.energy for f in rest)


class _Tape(ctypes.Structure):
    """``Tape`` of tables.h."""

    _fields_ = [
        *((name, ctypes.c_long) for name in "every left capacity count whole rows doubtful".split()),
        *((name, ctypes.c_double) for name in "allowed roundoff length".split()),
        *(
            (name, ctypes.c_void_p)
            for name in "units block lam frames energy reading reaction drift doubt contact".split()
        ),
    ]


@dataclass(frozen=True)
class Openness:
    """What open constraints are judged by: units of the rows as lengths, (n_lam,); the length that is allowed (m), and its share
    of the distance from the origin.
    """

    units: Array
    allowed: float
    roundoff: float


class Tape:
    """Room for the records of one march; ``contact``: numbers that contacts take of each."""

    def __init__(self, tables: Tables, judged: Openness, *, contact: int = 0) -> None:
        s, looks = tables.system, tables.looks
        self.tables = tables
        self.units = np.ascontiguousarray(judged.units, dtype=float)
        size = block_size(s)

        self._sizes: dict[str, tuple[int, ...]] = {
            "block": (size if looks.whole else 1,),
            "lam": (s.n_lam if looks.rows else 0,),
            "frames": (len(looks.markers), FRAME[tables.dim]),
            "energy": (4,),
            "reading": (looks.count, 3),
            "reaction": (len(looks.joints), tables.twist),
            "drift": (4,),
            "contact": (contact,),
        }
        # as many records as fit in a few megabytes
        each = sum(math.prod(x) for x in self._sizes.values())
        self.most = min(max(BYTES // (8 * each), 16), CAPACITY)
        self.doubt = np.zeros(size)

        self.c = _Tape(
            whole=looks.whole, rows=looks.rows, units=address_of(self.units), allowed=judged.allowed,
            roundoff=judged.roundoff, length=s.length, doubt=address_of(self.doubt),
        )  # fmt: skip
        self._make_room(min(FIRST, self.most))

    def _make_room(self, capacity: int) -> None:
        """Room for so many records, none of them made."""
        room = zeros_of({name: (capacity, *shape) for name, shape in self._sizes.items()})
        self.arrays = {name: x for name, (x, _) in room.items()}
        self.capacity = self.c.capacity = capacity
        for name, (_, address) in room.items():
            setattr(self.c, name, address)

    @property
    def address(self) -> int:
        """For C."""
        return ctypes.addressof(self.c)

    def begin(self, every: int, left: int) -> None:
        """Nothing recorded; the first record after ``left`` steps, then every so many. One that was full has more room then."""
        if self.c.count == self.capacity < self.most:
            self._make_room(min(4 * self.capacity, self.most))
        self.c.every, self.c.left, self.c.count, self.c.doubtful = every, left, 0, -1

    def step_back(self) -> None:
        """Forget the record of the newest step, if it has one."""
        if self.c.count and self.c.left == self.c.every:
            self.c.count -= 1
            self.c.doubtful = -1 if self.c.doubtful == self.c.count else self.c.doubtful

    def recorded(self) -> Recorded:
        """What was recorded, copied."""
        n = int(self.c.count)
        doubtful = self.c.doubtful >= 0
        doubt = self.tables.twin.state(state_of(self.tables.system, self.doubt)) if doubtful else None
        return Recorded(self.tables, {name: x[:n].copy() for name, x in self.arrays.items()}, doubt)


class Recorded:
    """Records of one march, k of them: arrays with the record as their first axis. ``doubt``: the first state whose joints are
    open by more than is allowed, None where there is none.
    """

    def __init__(self, tables: Tables, arrays: dict[str, Array], doubt: State | None = None) -> None:
        self.tables, self.system, self.looks = tables, tables.system, tables.looks
        self.arrays, self.doubt = arrays, doubt
        self.contact: Any = None  # of contacts in all records, as a state has it of one
        self._frames: dict[int, tuple[Array, Array, Array]] = {}  # by the marker, for all of its sensors
        self.t, self.lam = arrays["block"][:, 0], arrays["lam"]

    def __len__(self) -> int:
        return len(self.t)

    def state(self, i: int) -> State:
        """One of the states."""
        return self.tables.twin.state(state_of(self.system, self.arrays["block"][i]))

    # -- markers ------------------------------------------------------------------------------------------------------------
    def _frame(self, marker: int) -> tuple[Array, Array, Array]:
        """Numbers of the marker's frame, its rotation, and the arm from the frame's origin to the marker (world axes)."""
        if marker not in self._frames:
            d = self.tables.dim
            place = self.tables.seen_place[marker]
            frame = self.arrays["frames"][:, self.looks.markers.index(marker)]
            R = frame[:, d : d + d * d].reshape(-1, d, d)
            self._frames[marker] = frame, R, sum(R[:, :, j] * place[j] for j in range(d))
        return self._frames[marker]

    def place(self, marker: int) -> Array:
        """x, (k, d) m."""
        frame, _, arm = self._frame(marker)
        return frame[:, : self.tables.dim] + arm

    def rotation(self, marker: int) -> Array:
        """R since the start, (k, d, d)."""
        return np.asarray(self._frame(marker)[1] @ self.system.markers.rotation[marker])

    def twist(self, marker: int) -> Array:
        """Velocity (m/s) and angular velocity (rad/s), world axes, (k, d + n_rot)."""
        m, d = self.system.motions, self.tables.dim
        frame, _, arm = self._frame(marker)
        at = d + d * d
        w = frame[:, at + d : at + d + m.n_rot]
        return np.concatenate((frame[:, at : at + d] + m.spin(w, arm), w), axis=1)

    def acceleration(self, marker: int) -> Array:
        """x'' of a marker on a rigid body, (k, d) m/s^2."""
        m = self.system.motions
        d = self.tables.dim
        n = self.tables.twist
        body = int(self.system.markers.frame[marker])
        frame, R, arm = self._frame(marker)
        if body == self.tables.nb:
            return np.zeros((len(self), d))
        at = d + d * d + d
        first = 1 + self.system.n_q + self.system.n_v + n * body
        w = frame[:, at : at + m.n_rot]
        a = self.arrays["block"][:, first : first + n]
        turning = a[:, d:] if d == 2 else (R @ a[:, d:, None])[..., 0]
        return np.asarray(a[:, :d] + m.spin(turning, arm) + m.spin(w, m.spin(w, arm)))

    # -- coordinates, elements, joints ------------------------------------------------------------------------------------------
    def reading(self, key: Any) -> Array:
        """s, s' and the restoring effort of a sensor's coordinates or of the element of this name, (k, n, 3)."""
        return self.arrays["reading"][:, self.looks.slots[key]]

    def wrench(self, joint: str) -> Array:
        """Force and torque of a joint on its first body, (k, d + n_rot)."""
        return self.arrays["reaction"][:, self.looks.joints.index(joint)]

    def energies(self) -> dict[str, Array]:
        """Kind -> J, (k,), as :meth:`Evaluation.energies`."""
        kinds = ("kinetic", "elastic", "weight", "springs")
        out: dict[str, Array] = dict(zip(kinds, self.arrays["energy"].T.copy(), strict=True))
        for place, law in self.looks.stores:
            s = self.arrays["reading"][:, place, 0]
            out["springs"] += np.array([law.stored(float(x)) for x in s[:, 0]])
        return out

    @property
    def drift(self) -> Array:
        """(k, 4): of each state the largest open constraint, the largest rate at which one opens, this as a speed, the largest
        speed.
        """
        return self.arrays["drift"]
