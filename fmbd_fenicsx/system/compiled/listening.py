"""Controllers with a continuous law in the driver's tables: C tells the joint coordinates that they read, Python the efforts.

The coordinates are items that are told at every evaluation, before the efforts on the coordinates that are acted on are asked
for; markers' motions are taken from the frames that C has placed. The memory is taken up by accepted steps, as C makes them.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.frames import Kinematics
from ...rotations import Array
from ..controllers import ControlLoads
from .items import LAW, READ, Items, of_source

if TYPE_CHECKING:
    from .tables import Tables


class Listener:
    """One controller: ``items`` of what it reads, then of what it acts on; ``loads``: it, with the memory of steps in C."""

    def __init__(self, tables: Tables, loads: ControlLoads) -> None:
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

        acting = [of_source(relative, LAW) for relative in loads.acts]
        for i, one in enumerate(acting):
            one.law = lambda s, rate, t, i=i: -self.efforts(t)[i : i + 1]
            one.slopes = lambda s, rate, t, i=i: self.slopes(i, t)
        self.items = [*known.values(), *acting]
        self.markers = sorted({r.marker for r in loads.readings if r.relative is None})
        self._asked: tuple[Any, Array] | None = None

    @property
    def remembers(self) -> int:
        """2 where there is a memory: Python takes up steps, formulas say 1; else 0."""
        return 2 if self.loads.controller.memory else 0

    def recall(self) -> None:
        """Take the memory of the controller."""
        self.loads.kept, self._asked = self.origin.kept, None

    def remember(self) -> None:
        """Give it back after accepted steps."""
        self.origin.kept = self.loads.kept

    def keep(self, t: float) -> None:
        """Take up an accepted step that ends at t, whose coordinates C has told."""
        self.loads.kept, self._asked = self.loads.after(t, self._read()), None

    def efforts(self, t: float) -> Array:
        """u, (acts,), at what C told last; the law is asked once for all that it acts on."""
        y = self._read()
        key = t, *(x.tobytes() for x in y.values())
        if self._asked is None or self._asked[0] != key:
            self._asked = key, self.loads.with_memory(t, y)[0]
        return self._asked[1]

    def slopes(self, i: int, t: float) -> tuple[Array, Array]:
        """-du/ds and -du/ds' of what it acts on, as far as these are read themselves."""
        y, out = self._read(), np.zeros((2, 1))
        on = self.loads.controller.acts[i]
        for reading in self.loads.readings:
            if reading.coordinate == on:
                out[reading.level] -= self.loads.slopes(t, y, reading.name)[i, 0]
        return out[0], out[1]

    def _read(self) -> dict[str, Array]:
        """What the law reads, by name."""
        kin = self._kinematics() if self.markers else None
        y: dict[str, Array] = {}
        for reading, items in zip(self.loads.readings, self.told, strict=True):
            if items is None:
                assert kin is not None
                y[reading.name] = reading.at(kin)
            else:
                y[reading.name] = items.arrays["rate" if reading.level else "s"].copy()
        return y

    def _kinematics(self) -> Kinematics:
        """The markers that are read, placed on their frames; all others are zero."""
        tables, mk, which = self.tables, self.tables.system.markers, self.markers
        d, count = tables.dim, len(mk.frame)
        frames = tables.arrays["frames"][tables.frame[which]]
        x, turn, v, w, _ = np.split(frames, np.cumsum([d, d * d, d, 2 * d - 3]), axis=1)
        R = turn.reshape(-1, d, d)
        on_surface = tables.frame[which] > tables.nb
        lever = np.einsum("kij,kj->ki", R, np.where(on_surface[:, None], 0.0, mk.position[which]))

        none = np.zeros((count, 0, 0))
        kin = Kinematics(np.zeros((count, d)), np.zeros((count, d, d)), none, none)
        twist = np.zeros((count, d + w.shape[1]))
        swing = np.cross(w, lever) if d == 3 else w * np.stack((-lever[:, 1], lever[:, 0]), axis=1)
        kin.x[which], kin.R[which] = x + lever, R @ mk.rotation[which]
        twist[which] = np.concatenate((v + swing, w), axis=1)
        kin.twist = twist
        return kin


def listeners(tables: Tables) -> list[Listener]:
    """Those of all controllers whose law is called at every evaluation."""
    return [Listener(tables, f) for f in tables.system.forces if isinstance(f, ControlLoads) and f.called]
