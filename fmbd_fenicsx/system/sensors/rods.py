"""Sensors of rods: forces, moments and strains of a section, in its own axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import require
from ...mechanics.bodies.bodies import Surface
from ...mechanics.rods.elements import RodElements
from ...mechanics.rods.rods import Rod
from ...mechanics.rods.strains import values_at
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State
from .sensor import Sensor


@dataclass(frozen=True, eq=False)
class SectionSensor(Sensor):
    """Six numbers of the section at the arc length ``s`` (m) of a rod with elements of a ``degree``: forces and moments, or with
    ``strain`` its strains.
    """

    rod: str = ""
    s: float = 0.0
    strain: bool = False
    degree: int = 3

    @property
    def strain_degree(self) -> int:
        """Forces follow from strains."""
        return self.degree

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """Values at the Gauss points, continued to s; at a node between two elements the mean of both sides."""
        rod = self._rod(ev.system)
        if self.strain:
            return self._at(rod, rod.strains(ev.pose))
        return self._at(rod, rod.section_forces(ev.t, ev.pose, None if ev.v is None else ev.twist))

    def looks_at(self, system: Layout, marker: int) -> Look | None:
        """The states, where forces are functions of strains."""
        return Look(states=True) if self.strain or self._rod(system).elastic else None

    def series(self, seen: Recorded, marker: int) -> Array:
        """The values in all records, (k, 6)."""
        s, q, _, _ = seen.motion
        rod = self._rod(s)
        found = rod.strains(s.frame_poses(q))
        return self._at(rod, found if self.strain else np.array([rod.law.stress(e) for e in found]))

    def _rod(self, system: Layout) -> RodElements:
        return next(e for e in system.elements if isinstance(e, RodElements) and e.name == self.rod)

    def _at(self, rod: RodElements, found: Array) -> Array:
        """Values (.., 6) at the place from those at the Gauss points, (.., m, q, 6)."""
        edge = 1e-9 * rod.breaks[-1]
        inside = (rod.breaks[:-1] <= self.s + edge) & (self.s - edge <= rod.breaks[1:])
        values = []
        for k in np.flatnonzero(inside):
            start, end = rod.breaks[k : k + 2]
            values.append(values_at(rod.shape, (2 * self.s - start - end) / (end - start)) @ found[..., k, :, :])
        mean: Array = np.mean(values, axis=0)
        return mean

    def unit_of(self, component: int) -> str:
        """Of the three forces and three moments, or of stretch and shears, twist and bendings."""
        return self.unit.split(", ")[component // 3]

    @property
    def labels(self) -> Sequence[str]:
        """Stretch, shears, twist, bendings, or the forces and moments that belong to them."""
        if self.strain:
            return ("gamma 1", "gamma 2", "gamma 3", "kappa 1", "kappa 2", "kappa 3")
        return ("N", "Q2", "Q3", "T", "M2", "M3")


def section_forces(on: Surface) -> Sensor:
    """Forces N, Q2, Q3 (N) and moments T, M2, M3 (N m) of a rod's section in its axes, (6,); of what lies beyond on it."""
    return _section(on, False, "N, N m")


def section_strains(on: Surface) -> Sensor:
    """Stretch, two shears, twist and two bendings (1, 1/m) of a rod's section against the rod without stress, (6,)."""
    return _section(on, True, "1, 1/m")


def _section(on: Any, strain: bool, unit: str) -> Sensor:
    require(
        isinstance(on, Surface) and isinstance(on.body, Rod),
        f'A section belongs to a rod: rod.surface("end") or one of its stations; found {on!r}.',
    )
    node = on.body.node_of(on.name)
    return SectionSensor(None, unit, None, on.body.name, float(on.body.nodes[node]), strain, on.body.degree)
