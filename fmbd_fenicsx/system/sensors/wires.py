"""Sensors of wires: heights at a place, forces of the droppers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import array, instance, whole
from ...errors import require
from ...mechanics.catenary.wires import Wires
from ...rotations import Array
from ..evaluation import Evaluation
from ..layout import State
from .sensor import BodySensor, Sensor


@dataclass(frozen=True, eq=False)
class WireHeight(BodySensor):
    """See :func:`wire_height`."""

    wire: int = 0
    x: tuple[float, ...] = ()

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Displacements of the wire, m."""
        known = ev.system.cache
        k, part = ev.system.part(self.body.name)
        key = f"wire height {id(self)}"
        if key not in known:
            import scipy.sparse as sp

            known[key] = sp.vstack([part.field.row(self.wire, x) for x in self.x]).tocsr()
        return np.asarray(known[key] @ ev.system.local_q(state.q, k))


@dataclass(frozen=True, eq=False)
class DropperForces(BodySensor):
    """See :func:`dropper_forces`."""

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Tensions, N."""
        k, part = ev.system.part(self.body.name)
        return np.asarray(part.field.tension(ev.system.local_q(state.q, k))[0])


def wire_height(wires: Any, wire: int, x: Any) -> Sensor:
    """Displacement (m) of a wire at one or several places x (m), (n,)."""
    instance("wire_height: wires", wires, Wires)
    places = np.atleast_1d(array("wire_height: x", x))
    require(
        whole("wire_height: wire", wire) < len(wires.wires),
        f"wire_height: wire {wire} is none of the {len(wires.wires)} wires.",
    )
    return WireHeight(None, "m", None, wires, wire, tuple(float(xi) for xi in places.ravel()))


def dropper_forces(wires: Any) -> Sensor:
    """Tensions (N) of all droppers, 0 for slack ones."""
    instance("dropper_forces: wires", wires, Wires)
    return DropperForces(None, "N", None, wires)
