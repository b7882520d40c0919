"""Controllers with a continuous law in the driver's tables: C tells what they read, Python the efforts of all in one call.

The coordinates that are read are items that are told at every evaluation, before the efforts are asked for; markers' motions are
taken from the frames that C has placed. Slopes of efforts go into the matrix of a step, or into the differences of an implicit
one, see ``driver/forces/control.c``. The memory is taken up by accepted steps.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.joints.sums import Coordinate
from .....rotations import Array
from ....control.controllers import ControlLoads
from ....control.memory_points import PointRule, StepError
from ....control.readings import Reading
from ....sensors.sensors import AngularVelocity, Position, Velocity
from ...declarations import enumeration
from ..structures import array_of, structure
from .items import LAW, READ, Items, of_source

if TYPE_CHECKING:
    from ..layout import TableLayout

COORDINATE, ITS_RATE, PLACE_OF, VELOCITY_OF, ANGULAR, TURNED_BY = enumeration("COORDINATE").values()
MOST_STAGES = enumeration("MOST_STAGES")["MOST_STAGES"]
OTHERS, OWN_PLACE, OWN_RATE = enumeration("OTHERS").values()


class Listener:
    """One controller: its ``law`` with the memory of steps in C, its parts of the arrays y and u, and slopes du/dy."""

    def __init__(self, loads: ControlLoads) -> None:
        self.loads, self.law = loads, copy(loads.law)
        acts = loads.controller.acts
        # efforts that answer to more than their own coordinate
        self.crossed = any(r.coordinate != on for r in loads.readings for on in acts)
        self.y: Array = np.zeros(loads.size)
        self.u: Array = np.zeros(len(acts))
        self.slopes: Array = np.zeros((len(acts), loads.size))

    @property
    def remembers(self) -> int:
        """2 where there is a memory: Python takes up steps, formulas say 1; else 0."""
        return 2 if self.loads.controller.memory else 0

    def recall(self) -> None:
        """Take the memory of the controller."""
        self.law.kept = self.loads.kept

    def memory(self) -> Any:
        """What steps have made of it."""
        return self.law.kept

    def remember(self, memory: Any) -> None:
        """Give it back after accepted steps."""
        self.loads.kept = memory


class Listening:
    """All controllers whose law is called at every evaluation: ``items`` of what they read, then of what they act on."""

    def __init__(self, tables: TableLayout) -> None:
        self.tables = tables
        self.listeners = [Listener(f) for f in tables.system.forces if isinstance(f, ControlLoads) and f.called]
        self.readings = [r for one in self.listeners for r in one.loads.readings]
        self._told: dict[Coordinate, Items] = {}
        for reading in self.readings:
            if reading.coordinate is not None and reading.coordinate not in self._told:
                assert reading.relative is not None
                told = self._told[reading.coordinate] = of_source(reading.relative, READ)
                told.told = True

        self._acting = [[of_source(on, LAW) for on in one.loads.acts] for one in self.listeners]
        for one, acting in zip(self.listeners, self._acting, strict=True):
            for i, items in enumerate(acting):
                items.linked, items.slot = one.crossed, tables.looks.slots_of(one.loads, i)
        self.items = list(self._told.values()) + [items for acting in self._acting for items in acting]
        self.markers = np.array(sorted({r.marker for r in self.readings if r.relative is None}), dtype=int)

    @property
    def _remembering(self) -> list[Listener]:
        """Those with a memory."""
        return [one for one in self.listeners if one.remembers]

    @property
    def links(self) -> int:
        """Efforts that answer to more than their own coordinate."""
        return sum([items.linked for items in self.items])

    def unlink(self) -> None:
        """Leave out of a step's matrix what efforts answer to beside their own coordinates."""
        for items in self.items:
            items.linked = False

    @property
    def pairs(self) -> set[tuple[int, int]]:
        """Bodies whose forces answer to the motion of others: (body that is acted on, body that is read)."""
        body_of, frame = self.tables.body_of, self.tables.frame
        found = set()
        for one, acting in zip(self.listeners, self._acting, strict=True):
            frames = [
                self._told[r.coordinate].frames if r.coordinate else frame[[r.marker]] for r in one.loads.readings
            ]
            read = {int(b) for f in frames for b in body_of(f).ravel()}
            acted = {int(b) for items in acting for b in body_of(items.frames).ravel()}
            found |= {(a, b) for a in acted for b in read if a != b and min(a, b) >= 0}
        return found

    def structure(self) -> int | None:
        """The address of the structure Controllers, whose efforts the batches on them are told of; None without controllers."""
        if not self.listeners:
            return None
        store, tables = self.tables.store, self.tables
        count, acts = sum(r.size for r in self.readings), sum(len(one.u) for one in self.listeners)
        made = store.zeros({"y": count, "known_y": count, "u": acts, "known_u": acts})
        y, u = made["y"][0], made["u"][0]
        number = first = 0

        for one, acting in zip(self.listeners, self._acting, strict=True):
            n, own = len(one.y), one.loads.owned
            one.y, one.u = y[first : first + n], u[number : number + len(one.u)]
            one.slopes, slopes_at = store.array(one.slopes)
            for k, items in enumerate(acting):
                kinds = np.where(own[k], OWN_PLACE + one.loads.levels, OTHERS)
                act = structure("Act", tables.dim)(
                    number=number, first=first, count=n, own=store.integers(kinds), slopes=slopes_at + 8 * n * k
                )
                items.batch.act = store.structure(act)
                number += 1
            first += n

        readings = []
        for reading in self.readings:
            readings.append(self._reading(reading))
            readings[-1].first, readings[-1].count = sum(r.count for r in readings[:-1]), reading.size
        array = array_of(structure("Reading", tables.dim), max(len(readings), 1))(*readings)
        addresses = {name: address for name, (_, address) in made.items()}
        addresses["ahead"] = -1 if self._remembering else self._asked_ahead(count, acts)
        return store.structure(
            structure("Controllers", tables.dim)(readings=len(readings), reading=store.structure(array), **addresses)
        )

    def _asked_ahead(self, sees: int, answers: int) -> int:
        """Room for readings and efforts at points of a step, at the first batch that is acted on; its number."""
        batch = self._acting[0][0].batch
        batch.sees, batch.answers = sees, answers
        self._ahead, batch.ahead = self.tables.store.array(np.zeros((MOST_STAGES, 1 + sees + answers)))
        return int(batch.number)

    def remembered(self, *, integrals: bool) -> int | None:
        """The address of the structure Remembered; None where no memory is found at points. ``integrals``: of PID controllers."""
        store, asked = self.tables.store, sum(r.size for r in self.readings) if self._remembering else 0
        if not (integrals or self._remembering):
            return None
        self._y, y = store.array(np.zeros((MOST_STAGES, asked)))
        self._points = structure("Remembered", self.tables.dim)(integrals=integrals, asked=asked, y=y)
        return store.structure(self._points)

    def _reading(self, reading: Reading) -> Any:
        """The structure of what is read."""
        tables, made = self.tables, structure("Reading", self.tables.dim)()
        if reading.coordinate is not None:
            made.what = ITS_RATE if reading.level else COORDINATE
            made.batch = self._told[reading.coordinate].batch.number
            return made
        known = {Position: PLACE_OF, Velocity: VELOCITY_OF, AngularVelocity: ANGULAR}
        made.what = next((what for kind, what in known.items() if isinstance(reading.sensor, kind)), TURNED_BY)
        made.frame, markers = int(tables.frame[reading.marker]), tables.system.markers
        if made.frame <= tables.nb:  # a marker on a surface lies where the surface is
            made.arm[:] = markers.position[reading.marker].tolist()
        made.turn[:] = markers.rotation[reading.marker].ravel().tolist()
        return made

    def share(self, others: Listening) -> None:
        """Others' controllers, of the same system, have the memory of these from here on."""
        for one, other in zip(self.listeners, others.listeners, strict=True):
            other.law = one.law

    # -- what C asks for ----------------------------------------------------------------------------------------------------
    def efforts(self, t: float) -> None:
        """u of all controllers at what C has read."""
        for one in self.listeners:
            one.u[:] = one.law.with_memory(t, one.y)[0]

    def efforts_ahead(self, count: int) -> None:
        """The same at so many points of a step, where C has read."""
        for point in self._ahead[:count]:
            t, at, to = float(point[0]), 1, len(point) - sum([len(one.u) for one in self.listeners])
            for one in self.listeners:
                end, last = at + len(one.y), to + len(one.u)
                point[to:last] = one.law.with_memory(t, point[at:end])[0]
                at, to = end, last

    def slopes(self, t: float) -> None:
        """du/dy of all controllers there."""
        for one in self.listeners:
            one.slopes[:] = one.law.slopes(t, one.y, one.loads.spans, quick=True)

    def collocate(self) -> None:
        """Find memories at the points of a step, where C has read."""
        c, first = self._points, 0
        k, ends = c.points, c.ends
        rule = PointRule(
            np.array(c.t[:k]), np.array(c.couple[: k * k]).reshape(k, k), np.array(c.past[: k * ends]).reshape(k, ends),
            np.array(c.end[:ends]),
        )  # fmt: skip
        for one in self.listeners:
            count = len(one.y)
            if one.remembers:
                one.law.collocate(rule, self._y[:k, first : first + count], one.loads.places)
            first += count

    def lead(self) -> None:
        """By how much memories answer to rates where a tangent is taken."""
        for one in self._remembering:
            one.law.points.lead = self._points.lead

    def tell_error(self) -> None:
        """The largest error of a memory in the step whose points were found last, over the tolerance."""
        c = self._points
        k, ends = c.points, c.ends
        points, behind, times = (np.array(x) for x in (c.of_points[:k], c.of_ends[:ends], c.end[:ends]))
        of = StepError(points, behind, times, c.of_rate, c.frequency, c.rtol, c.atol)
        errors = [one.law.points.error(one.law.kept, of) for one in self._remembering]
        c.error = np.maximum.reduce(errors, initial=0.0)  # no number where one is none

    def tell_trapezoid_error(self, t: float) -> None:
        """That of memories that went to t by the trapezoidal rule, where C has read."""
        c = self._points
        errors = [one.law.trapezoid_error(t, one.y, one.loads.places, c.rtol, c.atol) for one in self._remembering]
        c.error = np.maximum.reduce(errors, initial=0.0)

    def keep(self, t: float) -> None:
        """Take up an accepted step that ends at t."""
        for one in self.listeners:
            one.law.keep(t, one.y)
