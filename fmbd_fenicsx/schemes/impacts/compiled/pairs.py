"""Pairs that may touch as the compiled driver reads them (``driver/contact/contact.c``), and what it asks Python about them."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ....mechanics.contact.contact_set import ContactSet
from ....mechanics.contact.limits import LimitPair
from ....mechanics.contact.obstacle_pair import ObstaclePair
from ....mechanics.contact.pair import Side
from ....mechanics.contact.trace import FieldTrace
from ....mechanics.shapes import KNOWN, Shape
from ....rotations import Array
from ....system.compiled.declarations import PYTHON, enumeration
from ....system.compiled.tables.tables import Tables
from ....system.system import System
from .structures import MEANS, SOURCE, Touch, structure
from .structures import MEETING as MET

if TYPE_CHECKING:
    from .facets import FacingSurfaces

POSE_OF, COMPLEMENTARITY, DISTANCES, RESTED, NEARBY, FACETS = enumeration("POSE_OF", SOURCE).values()
*_, SURFACE, LIMIT, OWN, MEETING = enumeration("HALF_SPACE", SOURCE).values()  # behind the shapes that the driver knows


@dataclass(frozen=True)
class SurfacePoints:
    """The nodes of a surface that touches no obstacle but another surface, which stand among the pairs."""

    slave: Side

    @property
    def count(self) -> int:
        """Nodes."""
        assert self.slave.surface is not None
        return len(self.slave.surface.nodes)

    @property
    def trace_nodes(self) -> np.ndarray:
        """Their numbers in the trace."""
        assert self.slave.surface is not None
        return self.slave.surface.nodes


def shape_data(shape: Shape, dim: int) -> tuple[int, list[float]]:
    """Kind and numbers of a shape as ``driver/contact/contact.c`` reads them."""
    if type(shape) not in KNOWN:
        return OWN, []
    return KNOWN.index(type(shape)), [float(x) for part in shape.numbers(dim) for x in np.ravel(part)]


class PairTables:
    """Pairs of contacts of a system, with the bodies of some tables; ``arrays``: what C reads and writes.

    ``listed``: the pairs with laws first, then the surfaces of those that meet, slave and master.
    """

    c: Any  # the structure Contacts
    pairs: Any  # and those of the pairs

    def __init__(self, tables: Tables, system: System) -> None:
        self.tables, self.system = tables, system
        self.contacts: ContactSet = system.contacts
        laws = self.contacts.pairs
        self.facing = [k for k, pair in enumerate(laws) if pair.searches]
        surfaces = [SurfacePoints(side) for k in self.facing for side in (laws[k].slave, laws[k].master)]
        self.listed: list[Any] = [*laws, *surfaces]
        self.stops = [pair for pair in laws if isinstance(pair, LimitPair)]
        self.arrays: dict[str, np.ndarray] = {}
        self.function = PYTHON(self.answer)

    def _array(self, name: str, values: Any, dtype: Any = np.float64) -> int:
        """The address of an array that is kept under its name."""
        self.arrays[name] = np.array(values, dtype=dtype, order="C")
        return int(self.arrays[name].ctypes.data)

    def _zeros(self, name: str, size: int, dtype: Any = np.float64) -> int:
        """The address of so many zeros, which take memory where they are written first."""
        self.arrays[name] = np.zeros(size, dtype)
        return int(self.arrays[name].ctypes.data)

    def _common(self) -> dict[str, Any]:
        """What all structures Contacts hold: pairs, their points and laws, and where these stand."""
        self._pairs()
        counts = [pair.count for pair in self.listed]
        on, place = self._points()
        m, points, d = len(on), len(self.contacts.pair), self.tables.dim
        return {
            "pairs": len(self.listed), "laws": len(self.contacts.pairs), "points": points, "pair": ctypes.addressof(self.pairs),
            "moving": int(any(pair.moving for pair in self.contacts.pairs)), "components": d if self.contacts.frictional else 1,
            "on": self._array("on", on, np.int32), "place": self._array("place", place),
            "of": self._array("of", np.repeat(np.arange(len(counts)), counts), np.int32),
            "own": self._zeros("own", points * (1 + 2 * d)), "python": self.function,
            "now": self._touch("now", m, d), "end": self._touch("end", m, d), "aside": self._touch("aside", m, d),
            "system": ctypes.addressof(self.tables.c), **self._surfaces(),
        }  # fmt: skip

    def _surfaces(self) -> dict[str, int]:
        """Of which points rows act on means: before an obstacle of one, between surfaces of those that their facets tell."""
        laws = len(self.contacts.pairs)
        surface, size = np.full((laws, 2), -1), ctypes.sizeof(MEANS)
        self._means = (MEANS * (2 * laws))()
        offset = self._zeros("offset", len(self.contacts.pair))
        self.meetings: list[FacingSurfaces] = []
        for k, pair in enumerate(self.listed[:laws]):
            mean, other = self._means[2 * k], self._means[2 * k + 1]
            if k not in self.facing:
                if pair.slave.surface is None:
                    continue
                surface[k, 0] = k
                mean.first = self._array(f"first {k}", np.arange(pair.count + 1), np.int32)
                mean.node = self._array(f"one {k}", np.arange(pair.count), np.int32)
                mean.weight = self._array(f"whole {k}", np.ones(pair.count))
                continue
            from .facets import FacingSurfaces

            for side, one in enumerate((mean, other)):
                one.first = self._zeros(f"first {side} {k}", pair.count + 1, np.int32)
            number = len(self.meetings)
            slave = laws + 2 * number
            surface[k] = slave, slave + 1
            self.meetings.append(FacingSurfaces(pair, number, (k, slave, slave + 1), self._array))

        self._met = (MET * len(self.meetings))(*(one.c for one in self.meetings))
        for meeting, c in zip(self.meetings, self._met, strict=True):
            meeting.c = c
            c.means = ctypes.addressof(self._means) + 2 * size * c.pair
            c.offset = offset + self.arrays["offset"].itemsize * self.pairs[c.pair].first
            self.pairs[c.pair].meeting = ctypes.addressof(c)
        return {
            "meetings": len(self.meetings), "meeting": ctypes.addressof(self._met), "means": ctypes.addressof(self._means),
            "surface": self._array("surface", surface, np.int32), "offset": offset,
        }  # fmt: skip

    def _touch(self, name: str, m: int, d: int) -> ctypes.Structure:
        """Room for where all points stand."""
        sizes = {"gap": m, "x": m * d, "normal": m * d, "relative": m * d}
        return Touch(**{k: self._array(f"{name} {k}", np.zeros(size)) for k, size in sizes.items()})

    def _points(self) -> tuple[np.ndarray, Array]:
        """Bodies that the candidates act on, (m, 2), -1 for none, and places of points in the axes of the first, (m, d)."""
        first, second, places = [], [], []
        for one, pair in zip(self.pairs, self.listed, strict=True):
            frames, points, other = pair.slave.frames, pair.slave.points, one.carrier
            if isinstance(pair, LimitPair):
                # stops act on the two bodies of their joint
                a, other = self.tables.body_of(self.tables.frame[[pair.relative.a[0], pair.relative.b[0]]])
                frames, points = np.full(pair.count, a), np.zeros((pair.count, self.tables.dim))
            elif pair.slave.surface is not None:
                frames, points = self._nodes(pair)

            first.append(frames)
            second.append(other)
            places.append(points)
        others = np.array(second)[np.repeat(np.arange(len(self.listed)), [pair.count for pair in self.listed])]
        return np.stack((np.concatenate(first), others), axis=1), np.concatenate(places)

    def _nodes(self, pair: Any) -> tuple[np.ndarray, Array]:
        """Bodies of the nodes of a pair on a surface, and their places in the axes of these."""
        trace = self.contacts.traces[pair.slave.trace]
        part: Any = self.tables.system.parts[trace.part]
        places = trace.X[pair.trace_nodes]
        return np.full(pair.count, part.frame), places if trace.moving else places - part.origin

    def _moved(self, one: Any, pair: Any) -> None:
        """What moves the nodes of a surface in their body: modes, or coordinates of their own."""
        trace: Any = self.contacts.traces[pair.slave.trace]
        nodes, d = pair.trace_nodes, self.tables.dim
        one.extent = trace.size
        if isinstance(trace, FieldTrace):
            first = self.tables.system.slices[0][trace.part].start
            one.node = self._array(f"nodes {one.first}", first + d * trace.own[nodes], np.int32)
        else:
            one.modes = self._array(f"modes {one.first}", trace.modes.reshape(trace.n, d, -1)[nodes])

    def _pairs(self) -> None:
        """The pairs' structures."""
        first = 0
        kind = structure("Pair", self.tables.dim)
        made = []

        for pair in self.listed:
            one = kind(first=first, count=pair.count, radius=pair.slave.radius, carrier=-1)
            one.asked[:] = [np.nan] * len(one.asked)
            if isinstance(pair, SurfacePoints):
                one.shape = SURFACE
            else:
                self._meeting(one, pair)
            if pair.slave.surface is not None:
                self._moved(one, pair)
            first += pair.count
            made.append(one)

        self.pairs = (kind * len(made))(*made)

    def _meeting(self, one: Any, pair: Any) -> None:
        """What points meet, and by which laws."""
        one.moving, one.thickness = int(pair.moving), pair.thickness
        one.friction, one.restitution = pair.friction, pair.restitution
        if isinstance(pair, LimitPair):
            self._stop(one, pair)
        elif pair.searches:
            part: Any = self.tables.system.parts[self.contacts.traces[pair.master.trace].part]
            one.shape, one.carrier = MEETING, part.frame
        else:
            self._obstacle(one, pair)

    def _obstacle(self, one: Any, pair: ObstaclePair) -> None:
        """Shape and carrier of an obstacle."""
        found = shape_data(pair.shape, self.tables.dim)
        one.shape, one.data[: len(found[1])] = found
        if not pair.moving and 0 <= pair.carrier.frame < self.system.n_frames:
            one.carrier = pair.carrier.frame
        elif not pair.moving:
            one.pose[:] = list(pair.carrier.offset)

    def _stop(self, one: Any, pair: LimitPair) -> None:
        """The coordinate of stops, and where they are."""
        marker = int(pair.relative.b[0])
        tables = self.tables
        one.shape = LIMIT

        # the coordinate; moments of angles push no point
        one.batch = tables.coordinate(self.stops.index(pair))
        one.pushes = int(not pair.relative.angular)
        one.lever = pair.lever(self.system)

        # the point on b
        on_surface = marker in tables.surfaces
        one.marked = int(tables.frame[marker])
        one.mark[:] = [0.0] * tables.dim if on_surface else list(self.system.markers.position[marker])

        # its stops
        one.bound[: pair.count] = list(pair.bounds)
        one.side[: pair.count] = list(pair.signs)

    def answer(self, what: int, number: int, t: float) -> int:
        """0, or 1 where Python raised: the step is then made in NumPy, which says why."""
        try:
            self._answer(what, number, t)
        except Exception:
            return 1
        return 0

    def _answer(self, what: int, number: int, t: float) -> None:
        """The pose of an obstacle, distances to a shape of the user's own, or which facets may see each other."""
        if what == FACETS:
            k = 2 * self._met[number].pair
            self.meetings[number].list_facets(self.arrays, (self._means[k], self._means[k + 1]))
        elif what == POSE_OF:
            self.pairs[number].pose[:] = list(self.listed[number].carrier.motion(t))
        else:
            self._distances(number)

    def _distances(self, number: int) -> None:
        """Signed distances and gradients of a pair's points by its own shape."""
        m, d = self.c.points, self.tables.dim
        places, distances, gradients = np.split(self.arrays["own"], [m * d, m * (d + 1)])
        mine = slice(self.pairs[number].first, self.pairs[number].first + self.pairs[number].count)

        shape = self.listed[number].shape
        distances[mine], gradients.reshape(m, d)[mine] = shape.evaluate(places.reshape(m, d)[mine].copy())
