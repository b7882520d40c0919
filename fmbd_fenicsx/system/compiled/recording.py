"""Records that the compiled loop makes: what sensors look at, asked for before a run, and read from many states at a time.

A sensor says what it looks at (:class:`Look`): the motion of a marker, a coordinate between two markers, the effort of an
element, the reaction of a joint. The driver writes these numbers, the energies and where needed the state at each record; the
sensor computes its series from :class:`Recorded` with arrays over all records. A sensor that cannot say what it looks at is read
from the states one by one; what it asks for most, the motion of markers, the driver has told.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.forces.effort_laws import EffortLaw
from ...mechanics.forces.force_elements import Loads, ScalarLoads, TimeLoads
from ...mechanics.frames import Kinematics, SeenKinematics
from ...mechanics.joints.relative import RelativeCoordinates
from ...mechanics.kinds.frames import FRAME
from ...rotations import Array
from ..layout import State
from ..system import System
from .blocks import state_of
from .tables.resting import Twin

if TYPE_CHECKING:
    from ..evaluation import Evaluation

KINDS = "kinetic", "elastic", "weight", "springs"  # of energies

Numbers = tuple[Array, float]  # what values in all records are multiples of, (k, ..), and by which factor


@dataclass(frozen=True)
class Look:
    """What a sensor needs of each record beside the state: the motion of a ``marker``, a ``relative`` coordinate with its rate,
    the ``element`` with this name, the wrench of the ``joint`` with this name on its first body; ``rows``: all multipliers,
    ``accelerated``, ``angled``: the acceleration of the marker too, in the plane its angle; ``side``: the wrench of the element
    on its first (0) or second (1) body; ``states``: the states themselves. What is told of contacts is recorded at any rate.
    """

    marker: int = -1
    relative: RelativeCoordinates | None = None
    element: str = ""
    joint: str = ""
    rows: bool = False
    accelerated: bool = False
    angled: bool = False
    side: int = -1
    states: bool = False

    @property
    def wrench(self) -> tuple[str, int] | None:
        """The name and side of a joint (first body, -1) or element whose wrench is looked at."""
        if self.joint:
            return self.joint, -1
        return (self.element, self.side) if self.side >= 0 else None


def readable(system: System, look: Look) -> bool:
    """Whether the driver can write what is looked at."""
    if look.element:
        scalar = [f for f in system.forces if type(f) is ScalarLoads or f.told]
        count = sum([look.element == x.name for f in scalar for x in f.forces])
        return count == 1 or (count > 1 and look.side < 0)  # wrenches on several coordinates have no point in common
    if look.relative is None:
        return True
    angles = [term for term in look.relative.summands if term.angular]
    if not angles:
        return True
    if system.motions.dim == 2 or system.counted is None:
        return system.counted is not None
    known = set(zip(system.counted.turn.a, system.counted.turn.b, strict=True))
    return all(pair in known for term in angles for pair in zip(term.a, term.b, strict=True))


def first_alike(system: System, markers: set[int]) -> dict[int, int]:
    """Of each marker the first among these that is in the same place, turned alike."""
    m, first = system.markers, dict[Any, int]()
    ports = {k: port.tobytes() for k, port in zip(m.surface, m.port, strict=True)}
    where = {k: (m.frame[k], ports.get(k), m.position[k].tobytes(), m.rotation[k].tobytes()) for k in sorted(markers)}
    return {k: first.setdefault(place, k) for k, place in where.items()}


class Looks:
    """What all sensors of a system look at, with the places of their numbers in a record."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.of: dict[int, Look] = {}  # by the identity of the sensor
        for sensor, marker in system.sensed:
            look = sensor.looks_at(system, marker)
            if look is not None and readable(system, look):
                self.of[id(sensor)] = look

        self.complete = len(self.of) == len(system.sensed)  # no state is read on its own
        every_marker = not self.complete or bool(self.shown)
        looks = self.of.values()

        # markers in the same place are seen once; who reads a state on its own may look at any
        every = range(len(system.markers.frame))
        asked = {look.marker for look in looks if look.marker >= 0}
        self.alike = dict(zip(every, every, strict=True)) if every_marker else first_alike(system, asked)
        self.markers = sorted(set(self.alike.values()))
        self.rows = any(look.rows for look in looks)
        self.whole = every_marker or any(look.states for look in looks)
        self.accelerated = any(look.accelerated for look in looks)
        self.angled = {self.alike[look.marker] for look in looks if look.angled}
        self.wrenches = sorted({look.wrench for look in looks if look.wrench is not None})
        self.relatives = [(key, look.relative) for key, look in self.of.items() if look.relative is not None]
        self.elements = {look.element for look in looks if look.element}
        self.slots: dict[Any, slice] = {}  # of a sensor's identity or an element's name
        self.count = 0

    def take_slots(self, key: Any, count: int) -> np.ndarray:
        """Numbers for so many items that are read."""
        self.slots[key] = slice(self.count, self.count + count)
        self.count += count
        return np.arange(self.count - count, self.count)

    def slots_of(self, loads: Loads, number: int | None = None) -> np.ndarray | None:
        """Numbers of the elements of a batch, or of one, that are read or store energy in a law, -1 for the others; None without
        any.
        """
        out: np.ndarray = np.full(len(loads.forces), -1)
        for i, f in enumerate(loads.forces):
            if f.name in self.elements or f in self._storing:
                if f.name not in self.slots:
                    self.take_slots(f.name, loads.forces.count(f))
                out[i] = self.slots[f.name].start + i - loads.forces.index(f)
        out = out if number is None else out[number : number + 1]
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
    def shown(self) -> list[Loads]:
        """Elements whose energy the driver does not know: they tell it themselves of their markers."""
        known = ScalarLoads, TimeLoads
        rest = [f for f in self.system.forces if type(f) not in known and not f.formulas() and f.mounts() is None]
        return [f for f in rest if type(f).energy is not Loads.energy]

    @cached_property
    def of_motion(self) -> bool:
        """Whether sensors read the motion alone, which tells nothing of a memory."""
        forces = self.elements or self.wrenches or any(sensor.derivative > 1 for sensor, _ in self.system.sensed)
        return self.complete and not forces

    @property
    def energies_known(self) -> bool:
        """Whether the driver tells all energies of a state."""
        return not self.stores and not self.shown


class Recorded:
    """Records of one march, k of them: arrays with the record as their first axis. ``doubt``: the first state whose joints are
    open by more than is allowed, None where there is none. ``straight``: whether C has written series itself; ``worst``: of all
    states the largest open constraint, the largest rate at which one opens, this as a speed, the largest speed, the fastest
    turning.
    """

    def __init__(self, twin: Twin, looks: Looks, arrays: dict[str, Array], doubt: State | None = None) -> None:
        self.twin, self.system, self.looks = twin, looks.system, looks
        self.dim = looks.system.motions.dim
        self.arrays, self.doubt = arrays, doubt
        self.contact: Any = None  # of contacts in all records, as a state has it of one
        self.t, self.lam = arrays["block"][:, 0], arrays["lam"]
        self.count: int = len(self.t)
        self.straight: bool = False
        self.worst: tuple[float, ...] = (0.0,) * 5

    def __len__(self) -> int:
        return self.count

    def copied(self) -> Recorded:
        """The records with arrays of their own, which the next records leave as they are."""
        out = copy(self)
        out.arrays = {name: x.copy() for name, x in self.arrays.items()}
        out.t, out.lam = out.arrays["block"][:, 0], out.arrays["lam"]
        return out

    def newest(self, sensor: Any, marker: int) -> Array | None:
        """What a sensor reads in the newest record, (size,); None where it has to be read from the state."""
        return sensor.series(self, marker)[-1] if id(sensor) in self.looks.of else None

    def state(self, i: int) -> State:
        """One of the states."""
        return self.twin.state(state_of(self.looks.system, self.arrays["block"][i]))

    def evaluation(self, s: State, i: int) -> Evaluation:
        """The system in one of the states, with the motion of its markers as the driver told it."""
        ev = self.twin.original.at(s.t, s.q, s.v)
        ev.kin = self._kinematics(i, ev.markers)
        return ev

    def _kinematics(self, i: int, whole: Callable[[], Kinematics]) -> SeenKinematics:
        """Motion of the markers in one of the states."""
        x, R, twist = self._markers
        return SeenKinematics(x[i], R[i], twist[i], whole)

    @cached_property
    def _markers(self) -> tuple[Array, Array, Array]:
        """x, R and twist of all markers in all records, (k, n, ..)."""
        d, sight = self.dim, self.arrays["sight"]
        turn, speed = slice(d, d + d * d), slice(d + d * d, 2 * d + d * d + self.system.motions.n_rot)
        return sight[..., :d], sight[..., turn].reshape(*sight.shape[:2], d, d), sight[..., speed]

    # -- states of all records ------------------------------------------------------------------------------------------------
    @cached_property
    def motion(self) -> tuple[System, Array, Array, Array]:
        """The system, and q, v and a in all records, (k, ..)."""
        s, twin, block = self.looks.system, self.twin, self.arrays["block"]
        n, at = s.n_v, 1 + s.n_q
        q, v, a = block[:, 1:at], block[:, at : at + n], block[:, at + n : at + 2 * n]
        return twin.original, twin.places(q), twin.forces(v), twin.forces(a)

    # -- markers ------------------------------------------------------------------------------------------------------------
    def _sight(self, marker: int, first: int, count: int) -> Array:
        """Some of a marker's numbers in all records: x, R by rows, v, w .. x'', world axes."""
        return self.arrays["sight"][:, self.looks.markers.index(self.looks.alike[marker]), first : first + count]

    def place(self, marker: int) -> Array:
        """x, (k, d) m."""
        return self._sight(marker, 0, self.dim)

    def rotation(self, marker: int) -> Array:
        """R since the start, by rows, (k, d^2)."""
        return self._sight(marker, self.dim, self.dim**2)

    def twist(self, marker: int) -> Array:
        """Velocity (m/s) and angular velocity (rad/s), world axes, (k, d + n_rot)."""
        d = self.dim
        return self._sight(marker, d + d * d, d + self.system.motions.n_rot)

    def acceleration(self, marker: int) -> Array:
        """x'' of a marker, (k, d) m/s^2."""
        return self._sight(marker, FRAME[self.dim], self.dim)

    def angle(self, marker: int) -> Array:
        """That of a marker in the plane, counted over revolutions where its frame has one, (k, 1) rad."""
        return self._sight(marker, FRAME[self.dim] + self.dim, 1)

    # -- coordinates, elements, joints ------------------------------------------------------------------------------------------
    def reading(self, key: Any) -> Array:
        """s, s' and the restoring effort of a sensor's coordinates or of the element of this name, (k, n, 3)."""
        return self.arrays["reading"][:, self.looks.slots[key]]

    def wrench(self, name: str, side: int = -1) -> Array:
        """Force and torque of a joint on its first body, or of an element on that of a side (0, 1), (k, d + n_rot)."""
        return self.arrays["reaction"][:, self.looks.wrenches.index((name, side))]

    @property
    def written(self) -> dict[str, Array]:
        """Those of :meth:`energies` that the driver has written."""
        every: dict[str, Array] = dict(zip(KINDS, self.arrays["energy"].T, strict=True))
        return every if self.looks.energies_known else {kind: every[kind] for kind in KINDS if kind != "springs"}

    def energies(self) -> dict[str, Array]:
        """Kind -> J, (k,), as :meth:`Evaluation.energies`."""
        out: dict[str, Array] = dict(zip(KINDS, self.arrays["energy"].T, strict=True))
        for place, law in self.looks.stores:
            s = self.arrays["reading"][:, place, 0]
            out["springs"] = out["springs"] + np.array([law.stored(float(x)) for x in s[:, 0]])
        if self.looks.shown:
            out["springs"] = out["springs"] + np.array([self._shown(i) for i in range(len(self))])
        return out

    def _shown(self, i: int) -> float:
        """Energy that elements tell of their markers in one of the states, J."""

        def whole() -> Kinematics:
            return self.evaluation(self.state(i), i).markers()

        kin, t = self._kinematics(i, whole), float(self.t[i])
        return sum([loads.energy(kin, t) for loads in self.looks.shown])
