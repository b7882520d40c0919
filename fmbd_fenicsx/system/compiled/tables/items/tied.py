"""Ties of surfaces by field multipliers as items of kinds, see :mod:`~.....mechanics.joints.trace_rows`.

What a tie sees of a side by one function of its multipliers, y = m r + R (s + p), is a point of the side's frame for the driver
(a Surface of the sort INTEGRAL in ``driver/tables.h``), on rigid bodies one without ports; that of the ground, s, is a constant
of the items. Rows are those of points: y_b - y_a along the axes of space, of a sliding tie along a normal that is fixed in b.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.bodies.port_constraint import PortConstraint
from .....mechanics.bodies.port_kind import formulas_of, points_of, port_kind
from .....mechanics.catenary.sliding import HeadSide, WireSide
from .....mechanics.frames import Markers
from .....mechanics.joints.constraints import standstill
from .....mechanics.joints.trace_rows import TiedSide, TraceRows
from .....mechanics.kinds.derivation import Kind, kinds
from .....mechanics.kinds.python_kinds import Answers
from .....rotations import Array
from ..resting import RestingField
from .items import ROW, Items

if TYPE_CHECKING:
    from ....system import System

MOST = 200  # rows of ties: of more NumPy's dense matrices are found as fast


@dataclass(frozen=True)
class SeenByTie:
    """What a function of a tie sees of a body: its measure m and s (d,) of equation (2) of the ties."""

    measure: float
    reference: Array


class TiedPoints:
    """The ties of a system where all parts have frames (:mod:`..resting`), and constraints of own equations: the ``system`` with
    their points as markers behind the others, what each of these ``sees`` by its number, and the ``items``.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        self.sees: dict[int, SeenByTie] = {}
        self._frames: list[int] = []
        self._ports: list[np.ndarray] = []

        self.items = [self._rows(tie, np.arange(rows.start, rows.stop)) for tie, rows in system.traces]
        for law, rows in system.port_constraints:
            if isinstance(law, PortConstraint):
                self.items += self._own_rows(law, np.arange(rows.start, rows.stop))

        heads = {rows.start: law for law, rows in system.port_constraints if isinstance(law, HeadSide)}
        wires = [(law, rows) for law, rows in system.port_constraints if isinstance(law, WireSide)]
        self.items += [
            self._sliding_row(law, heads[rows.start], np.arange(rows.start, rows.stop)) for law, rows in wires
        ]
        if self.items:
            self.system = replace(system, markers=self._with_points(system.markers))

    def _rows(self, tie: TraceRows, rows: np.ndarray) -> Items:
        """The rows of a tie."""
        n, d = tie.data.shape
        (first, left_out), (second, there) = (self._side(side) for side in tie.sides)
        pair, shift = np.stack((first, second), axis=1), there - left_out
        constants: dict[str, Array]

        if tie.normal is None:
            kind, pair = kinds(d)["tied"], np.repeat(pair, d, axis=0)
            constants = {"e": np.tile(np.eye(d), (n, 1)), "shift": shift.ravel()}
        else:
            kind, constants = kinds(d)["tied_along"], {"e": np.tile(tie.normal, (n, 1)), "shift": shift @ tie.normal}
        made = Items(kind, ROW, pair, constants, rows)
        made.factor = np.ones(len(rows))
        return made

    def _side(self, side: TiedSide) -> tuple[np.ndarray, Array]:
        """Markers of the functions of one side, (n,), and what these leave out of y, (n, d)."""
        n, d = side.s.shape
        first = len(self.system.markers.frame) + len(self._frames)
        if side.frame == self.system.n_frames:  # the ground
            self._frames.append(side.frame)
            return np.full(n, first), side.s

        ports = np.full((n, d), -1)
        if side.part is not None:
            start = self.system.port_slice(side.part).start + side.ports.start
            ports = start + np.arange(n * d).reshape(n, d)

        self._frames += [side.frame] * n
        self._ports += list(ports)
        self.sees |= {first + j: SeenByTie(float(side.m[j]), side.s[j]) for j in range(n)}
        return first + np.arange(n), np.zeros((n, d))

    def _sliding_row(self, wire: Any, head: Any, rows: np.ndarray) -> Items:
        """The row of a contact that slides along a wire: between a point of the wire, (w, w), and one of the head, (y, y)."""
        ports = [(head.part, head.number)] + [(wire.part, wire.first)] * wire.status.closed
        points = [self._point(part, np.full(2, mine)) for part, mine in ports]
        if not wire.status.closed:
            points.append(len(self.system.markers.frame) + len(self._frames))
            self._frames.append(self.system.n_frames)  # the ground
        constants: dict[str, Array] = {"e": np.array([[1.0, 0.0]]), "shift": np.zeros(1)}
        made = Items(kinds(2)["tied"], ROW, np.array([points[::-1]]), constants, rows)
        made.factor = np.ones(1)
        return made

    def _point(self, part: int, ports: np.ndarray) -> int:
        """A point whose place are some ports (d,) of a part."""
        number = len(self.system.markers.frame) + len(self._frames)
        self._frames.append(self.system.parts[part].frame)
        self._ports.append(self.system.port_slice(part).start + ports)
        self.sees[number] = SeenByTie(1.0, np.zeros(len(ports)))
        return number

    def _own_rows(self, law: PortConstraint, rows: np.ndarray) -> list[Items]:
        """The rows of a constraint on coordinates of one's own, which are those of points of the part."""
        d, part = self.system.motions.dim, self.system.parts[law.part]
        count = points_of(part.n, d)
        points = len(self.system.markers.frame) + len(self._frames) + np.arange(count)
        # the last point may have fewer coordinates than a place: others are not looked at
        ports = np.minimum(np.arange(count * d), part.n - 1).reshape(count, d)
        self._frames += [part.frame] * count
        self._ports += list(self.system.port_slice(law.part).start + ports)
        self.sees |= {int(i): SeenByTie(1.0, np.zeros(d)) for i in points}

        terms = formulas_of(law, np.asarray(part.body.start, dtype=float), d)
        if not terms:
            numbers: dict[str, Array] = {"component": np.arange(len(rows), dtype=float)}
            asked = port_kind(law, part.n, d)
            return [_rows_of_points(asked, asked.function, np.tile(points, (len(rows), 1)), numbers, rows)]

        # rows of one formula are items of one kind
        alike: dict[Kind, list[int]] = {}
        for i, (term, _) in enumerate(terms):
            alike.setdefault(term.kind, []).append(i)
        made = []
        for kind, which in alike.items():
            of_items = {
                name: np.array([terms[i][0].constants[name] for i in which]) for name in terms[which[0]][0].constants
            }
            between = points[np.array([terms[i][1] for i in which])]
            made.append(_rows_of_points(kind, Answers(), between, of_items, rows[which]))
        return made

    def _with_points(self, markers: Markers) -> Markers:
        """The markers of the system, and the points."""
        count, d = len(self._frames), markers.motions.dim
        # a point has fewer ports than a surface: its last one stands for those that it lacks
        ports = np.pad(np.array(self._ports), ((0, 0), (0, markers.n_port - d)), mode="edge")
        section = markers.section
        return replace(
            markers,
            frame=np.append(markers.frame, self._frames),
            position=np.concatenate((markers.position, np.zeros((count, d)))),
            rotation=np.concatenate((markers.rotation, np.broadcast_to(np.eye(d), (count, d, d)))),
            surface=np.append(markers.surface, sorted(self.sees)).astype(int),
            port=np.concatenate((markers.port.reshape(-1, markers.n_port), ports)).astype(int),
            section=None if section is None else np.append(section, np.zeros(len(ports), dtype=bool)),
        )


def _rows_of_points(
    kind: Kind, answers: Answers, points: np.ndarray, constants: dict[str, Array], rows: np.ndarray
) -> Items:
    """Rows of a kind, each between some points (n, ..), of which those with the time in them follow the clock."""
    made = Items(kind, ROW, points, constants, rows)
    made.factor, made.drive = np.ones(len(rows)), [answers.clock] * len(rows) if kind.driven else []
    return made


def motions_of_ties(system: System) -> list[tuple[np.ndarray, list[Any], Array]]:
    """Rows of ties with imposed data, the motion of all of them, and by what it counts in each."""
    found: list[tuple[np.ndarray, list[Callable[[float], Any]], Array]] = []
    for tie, rows in system.traces:
        if tie.motion is not standstill:
            data = tie.data.ravel() if tie.normal is None else tie.data @ tie.normal
            found.append((np.arange(rows.start, rows.stop), [tie.motion], -data))
    return found


def covers_ties(system: System) -> bool:
    """Whether all ties of a system are items: those of moderate size whose imposed data does not meet a normal that turns."""
    few = sum(rows.stop - rows.start for _, rows in system.traces) <= MOST
    turning = (tie.normal is not None and tie.data.any() and _turns(system, tie.sides[1]) for tie, _ in system.traces)
    return few and not any(turning)


def _turns(system: System, side: TiedSide) -> bool:
    """Whether the frame of a side may turn: not the ground, nor one at rest."""
    part = None if side.part is None else system.parts[side.part]
    return side.frame < system.n_frames and not isinstance(part, RestingField)
