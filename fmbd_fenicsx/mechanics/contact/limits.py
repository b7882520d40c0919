"""Stops of joint coordinates as unilateral rows beside those of contact.

    g = l (s - lower) >= 0   or   g = l (upper - s) >= 0,     g' = +-l (row_a . twist_a + row_b . twist_b)                   (1)

with s the joint coordinate and l = 1 for a displacement, the model's length for an angle: all gaps are lengths and all rows'
forces are newtons. The effort on the coordinate is l times the force, upwards at the lower stop and downwards at the upper one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ..joints.relative import RelativeCoordinates, Separation
from .contact_set import ContactSet, Here
from .nodal_rows import NodalRows
from .obstacles import Way
from .pair import Pair
from .rows import LinearRows, Rows, Touch
from .trace import FieldTrace


@dataclass(frozen=True)
class LimitPair(Pair):
    """The stops of one joint coordinate, ready to evaluate; the first candidate is the lower stop where there is one.

    ``bounds`` (m,): where the stops are, rad or m; ``signs`` (m,): +1 below, -1 above.
    """

    relative: RelativeCoordinates
    bounds: Array
    signs: Array

    thickness = np.inf  # a stop cannot be passed through: the coordinate is counted

    @property
    def count(self) -> int:
        """Stops."""
        return len(self.bounds)

    @property
    def trace_nodes(self) -> None:
        """Stops have no nodes."""
        return None

    def overlap(self, system: Any, depth: float, x: Array, normal: Array) -> str:
        """The sentence that refuses a start beyond a stop."""
        unit = "rad" if self.relative.angular else "m"
        return (
            f'Joint limit "{self.name}": the joint begins {depth / self.lever(system):.3g} {unit} beyond its stop. Its '
            "coordinate counts from the start of the run: take lower or upper from there, or turn the bodies."
        )

    def lever(self, system: Any) -> float:
        """l of (1)."""
        return float(system.length) if self.relative.angular else 1.0

    def _gaps(self, system: Any, kin: Any) -> Array:
        s = self.relative.values(kin)[0]
        return self.lever(system) * self.signs * (s - self.bounds)

    def _place(self, here: Here) -> Touch:
        """Gaps, the joint's point on b, and the directions along which the forces act: none for moments."""
        system, kin = here.system, here.evaluation.kin
        a = int(self.relative.a[0])
        b = int(self.relative.b[0])
        along = np.zeros(system.motions.dim)
        if isinstance(self.relative, Separation):
            along = (kin.x[b] - kin.x[a]) / np.linalg.norm(kin.x[b] - kin.x[a])
        elif not self.relative.angular:
            along = kin.R[a] @ self.relative.e[0]

        x = np.tile(kin.x[b], (self.count, 1))
        return Touch(self._gaps(system, kin), x, self.signs[:, None] * along, np.zeros_like(x))

    def touch(self, here: Here) -> Touch:
        """Gaps of the stops; collective."""
        return self._place(here)

    def rows(self, here: Here, way: Way | None) -> Rows:
        """The rows (1) of all stops; collective."""
        contacts, system = here.contacts, here.system
        touch = self._place(here)
        one = np.ones(self.count)
        core, fields = self._row(contacts, here.evaluation)
        # without friction any rows serve as tangents: their forces are zero
        across = system.motions.dim - 1 if contacts.frictional else 0
        factor = (self.lever(system) * self.signs).repeat(1 + across)
        return Rows(
            gap=touch.gap,
            L=LinearRows(factor[:, None] * core, tuple(_alike(factor, f) for f in fields)),
            friction=0.0 * one,
            restitution=self.restitution * one,
            normal=touch.normal,
            drift=np.zeros((self.count, across)),
            trace=np.full(self.count, -1),
        )

    def _row(self, contacts: ContactSet, ev: Any) -> tuple[Array, list[Array]]:
        """s' as rows on the velocities of the core, (n_core,), and of the contact nodes of each trace, (n, d)."""
        s = ev.system
        n = s.motions.n_twist
        core, port = np.zeros(contacts.n_core), np.zeros(s.n_port)
        for marker, side in zip((self.relative.a[0], self.relative.b[0]), self.relative.rows(ev.kin), strict=True):
            # by the marker's frame, and by the ports of the surface that it may sit on
            frame = int(s.markers.frame[marker])
            if frame < s.n_frames:
                core[frame * n : (frame + 1) * n] += side[0] @ ev.kin.jac_frame[marker]
            for k in np.flatnonzero(s.markers.surface == marker):
                port[s.markers.port[k]] += side[0] @ ev.kin.jac_port[k]

        # of the motion of surfaces: amplitudes in the core, nodes of fields
        for k, part in s.core_parts:
            if part.n_port:
                matrix = part.port_matrix + ev.bent[k].matrix if k in ev.bent else part.port_matrix
                core[s.slices[1][k]] += port[s.port_slice(k)] @ matrix
        fields = [np.zeros((tr.n, s.motions.dim)) for tr in contacts.traces]
        for i, tr in enumerate(contacts.traces):
            if isinstance(tr, FieldTrace):
                fields[i] = tr.gather(s.parts[tr.part].port_force(port[s.port_slice(tr.part)], ev.t))
        return core, fields


def _alike(factor: Array, row: Array) -> NodalRows:
    """Multiples of one row (n, d) on the nodes of a trace."""
    nodes = np.flatnonzero(row.any(axis=1))
    count = len(factor)
    value = (factor[:, None, None] * row[nodes]).reshape(-1, row.shape[1])
    return NodalRows(count, np.repeat(np.arange(count), len(nodes)), np.tile(nodes, count), value)
