"""Controllers with a continuous law in the driver's tables: C tells the joint coordinates that they read, Python the efforts.

The coordinates are items that are told at every evaluation, before the efforts on the coordinates that are acted on are asked
for; markers' motions are taken from the frames that C has placed. What efforts answer to beside
their own coordinates goes into the matrix of steps by rows (driver/forces/links.c). The memory is taken up by accepted steps.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.frames import Kinematics
from .....rotations import Array
from ....control.controllers import ControlLoads, Reading
from .items import LAW, READ, Items, of_source

if TYPE_CHECKING:
    from ..layout import TableLayout


class Listener:
    """One controller: ``items`` of what it reads, then of what it acts on; ``loads``: it, with the memory of steps in C."""

    def __init__(self, tables: TableLayout, loads: ControlLoads) -> None:
        self.tables, self.origin, self.loads = tables, loads, copy(loads)
        self.told: list[Items | None] = []  # of each reading; None of a marker's motion
        known: dict[Any, Items] = {}
        for reading in loads.readings:
            if reading.relative is None:
                self.told.append(None)
                continue
            if reading.coordinate not in known:
                known[reading.coordinate] = of_source(reading.relative, READ)
                known[reading.coordinate].told = True
            self.told.append(known[reading.coordinate])

        self.acting = [of_source(relative, LAW) for relative in loads.acts]
        crossed = any(r.coordinate != on for r in loads.readings for on in loads.controller.acts)
        for i, one in enumerate(self.acting):
            one.law = lambda s, rate, t, i=i: -self._effort(i, t)
            one.slopes = lambda s, rate, t, i=i: self.slopes(i, t)
            one.linked = crossed
        self.items = [*known.values(), *self.acting]
        self.markers = sorted({r.marker for r in loads.readings if r.relative is None})
        self.lever: dict[int, Array] = {}  # of markers, in world axes
        self._read_of: Any = None  # what C told when it was read last
        self._asked: tuple[Any, Array] | None = None
        self._known: tuple[Any, dict[str, Array], Array, dict[str, Array]] | None = None  # see _slopes
        self._places: dict[int, np.ndarray] = {}

    @property
    def remembers(self) -> int:
        """2 where there is a memory: Python takes up steps, formulas say 1; else 0."""
        return 2 if self.loads.controller.memory else 0

    def recall(self) -> None:
        """Take the memory of the controller."""
        self.loads.kept, self._asked, self._known = self.origin.kept, None, None

    def memory(self) -> Any:
        """What steps have made of it."""
        return self.loads.kept

    def remember(self, memory: Any) -> None:
        """Give it back after accepted steps."""
        self.origin.kept = memory

    def keep(self, t: float) -> None:
        """Take up an accepted step that ends at t, whose coordinates C has told."""
        self.loads.kept, self._asked, self._known = self.loads.after(t, self._read()), None, None

    def _efforts(self, t: float, y: dict[str, Array]) -> Array:
        """u, (acts,), at what C told last; the law is asked once for all that it acts on."""
        key = t, self._read_of
        if self._asked is None or self._asked[0] != key:
            self._asked = key, self.loads.with_memory(t, y)[0]
        return self._asked[1]

    def _effort(self, i: int, t: float) -> Array:
        """What coordinate i is acted on with, (1,); C is told what the newest slopes foretell."""
        y = self._read()
        u = self._efforts(t, y)
        if self.acting[i].linked:
            foretold = u[i]
            if self._known is not None:
                _, was, effort, slopes = self._known
                foretold = effort[i] + sum(float(slopes[name][i] @ (y[name] - was[name])) for name in y)
            self.acting[i].arrays["foretold"][0] = -foretold
        return u[i : i + 1]

    def _slopes(self, t: float) -> dict[str, Array]:
        """du/dy of each reading, (acts, size), found once for a state and kept with its readings and efforts."""
        y = self._read()
        key = t, self._read_of
        if self._known is None or self._known[0] != key:
            names = [name for name in y if self.links or self._own(name)]
            slopes = self.loads.slopes(t, y, names, quick=True)
            self._known = key, y, self._efforts(t, y), slopes
        return self._known[3]

    def _own(self, name: str) -> bool:
        """Whether a reading is of a coordinate that is acted on."""
        return any(r.name == name and r.coordinate in self.loads.controller.acts for r in self.loads.readings)

    def slopes(self, i: int, t: float) -> tuple[Array, Array]:
        """-du/ds and -du/ds' of what it acts on, as far as these are read themselves."""
        known, out = self._slopes(t), np.zeros((2, 1))
        on = self.loads.controller.acts[i]
        for reading in self.loads.readings:
            if reading.coordinate == on:
                out[reading.level] -= known[reading.name][i, 0]
        return out[0], out[1]

    @property
    def links(self) -> int:
        """Efforts that answer to more than their own coordinate."""
        return sum(one.linked for one in self.acting)

    def unlink(self) -> None:
        """Leave out what efforts answer to beside their own coordinates."""
        for one in self.acting:
            one.linked = False

    def link(self, t: float, first: int) -> int:
        """Tell C the rows that efforts push on and those of all else that they answer to, from number ``first`` on.

        Returns the next free number: efforts that answer to nothing else have no rows.
        """
        arrays, c = self.tables.arrays, self.tables.c
        if not self.links:
            return first

        slopes, acts = self._slopes(t), self.loads.controller.acts
        answers = [(r, self._answers(r, told)) for r, told in zip(self.loads.readings, self.told, strict=True)]
        for i, one in enumerate(self.acting):
            push, pull = arrays["push"][first], arrays["pull"][first]
            pull[:] = 0.0
            for reading, rows in answers:
                for places, row, fast in () if reading.coordinate == acts[i] else rows:
                    np.add.at(pull, places, -(c.cd if fast else c.ck) * (slopes[reading.name][i] @ row))
            if not pull[:-1].any():
                continue
            push[:] = 0.0
            np.add.at(push, self._places_of(one), one.arrays["out"][0, 1:])
            first += 1
        return first

    def _answers(self, reading: Reading, told: Items | None) -> list[tuple[np.ndarray, Array, bool]]:
        """Places among velocities, rows (size, places) on these by which a reading changes, and whether it is a rate."""
        if told is not None:
            return [(self._places_of(told), told.arrays["out"][:, 1:], bool(reading.level))]
        size, d = reading.at(self._seen).size, self.tables.dim
        out = []
        for marker, row, fast in reading.rows(self._seen, size):
            # at the place of the frame that carries the marker
            at_frame = row.copy()
            at_frame[:, d:] += self.loads.motions.moment(np.broadcast_to(self.lever[marker], (size, d)), row[:, :d])
            out.append((self.tables.twist_places(self.tables.frame[[marker]])[0], at_frame, fast))
        return out

    def _places_of(self, items: Items) -> np.ndarray:
        """Places among velocities of the entries of a coordinate's row."""
        if id(items) not in self._places:
            places = self.tables.twist_places(items.frames).reshape(-1)
            self._places[id(items)] = places[list(items.kind.entries)]
        return self._places[id(items)]

    def _read(self) -> dict[str, Array]:
        """What the law reads, by name: found once for what C has told."""
        frames = self.tables.arrays["frames"][self._frames]
        told = frames.tobytes(), *(x.tobytes() for x in self._coordinates)
        if told != self._read_of:
            if self.markers:
                self._place(frames)
            numbers = iter(self._coordinates)
            self._readings = {
                reading.name: reading.at(self._seen) if items is None else next(numbers).copy()
                for reading, items in zip(self.loads.readings, self.told, strict=True)
            }
            self._read_of = told
        return self._readings

    @cached_property
    def _coordinates(self) -> list[Array]:
        """Where C tells the joint coordinates and rates that are read, in the order of these readings, (1,) each."""
        both = zip(self.loads.readings, self.told, strict=True)
        return [items.arrays["rate" if reading.level else "s"] for reading, items in both if items is not None]

    @cached_property
    def _frames(self) -> np.ndarray:
        """Of the markers that are read, the rows of the frames that carry them."""
        return self.tables.frame[self.markers]

    @cached_property
    def _arms(self) -> Array:
        """From these frames to the markers, in axes of the frames, (markers, d); a surface is a frame of its own."""
        on_surface = self._frames > self.tables.nb
        return np.where(on_surface[:, None], 0.0, self.tables.system.markers.position[self.markers])

    @cached_property
    def _seen(self) -> Kinematics:
        """The markers that are read, placed on their frames; all others are zero."""
        d, count = self.tables.dim, len(self.tables.system.markers.frame)
        n = self.tables.system.motions.n_twist
        none = np.zeros((count, n, 0))
        kin = Kinematics(np.zeros((count, d)), np.zeros((count, d, d)), none, none)
        kin.twist = np.zeros((count, n))
        return kin

    def _place(self, frames: Array) -> None:
        """Place the markers that are read by their frames: x, R, v, w of each, row by row."""
        which, d, motions = self.markers, self.tables.dim, self.tables.system.motions
        twists = d + d * d
        x, R = frames[:, :d], frames[:, d:twists].reshape(-1, d, d)
        twist = frames[:, twists : twists + motions.n_twist]
        lever = (R @ self._arms[:, :, None])[:, :, 0]
        self.lever = dict(zip(which, lever, strict=True))

        kin = self._seen
        assert kin.twist is not None
        kin.x[which], kin.R[which] = x + lever, R @ self.tables.system.markers.rotation[which]
        twist[:, :d] += motions.spin(twist[:, d:], lever)
        kin.twist[which] = twist


def listeners(tables: TableLayout) -> list[Listener]:
    """Those of all controllers whose law is called at every evaluation."""
    return [Listener(tables, f) for f in tables.system.forces if isinstance(f, ControlLoads) and f.called]
