"""Applied forces on the surfaces of elastic fields, as compliant rows beside the constraints of a step.

See :mod:`fmbd_fenicsx.system.tangents.force_tangent`: with y the scaled efforts of the elements, in their r modes,

    balance:  .. + L y,        rows:  R^T dq - y = 0                                                        (1)

The fields are eliminated from (1) with the factors and columns that they have anyway, so their matrices stay constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rotations import Array
from ..system.system import System
from ..system.tangents.force_tangent import ForceTangent
from ..system.tangents.foreshortened_ports import tangent_ports


@dataclass(frozen=True, eq=False)
class Border:
    """L and R of (1), (n_core + n_port, r) each, of one configuration at time ``t``."""

    system: System
    left: Array
    right: Array
    t: float

    @classmethod
    def of(cls, system: System, tangent: ForceTangent | None, t: float) -> Border:
        """The border of a tangent; without columns where no element touches a field."""
        if tangent is None:
            none = np.zeros((system.n_core + system.n_port, 0))
            return cls(system, none, none, t)
        return cls(system, tangent.left, tangent.right, t)

    @property
    def count(self) -> int:
        """Rows r."""
        return self.left.shape[1]

    def on_core(self) -> tuple[Array, Array]:
        """L (n_core, r) and R^T (r, n_core) on the core."""
        n = self.system.n_core
        return self.left[:n], self.right[:n].T

    def on_ports(self, k: int, used: np.ndarray) -> tuple[Array, Array]:
        """L and R of the ports ``used`` of part k, (used, r) each."""
        at = self.system.n_core + self.system.port_slice(k).start + used
        return self.left[at], self.right[at]

    def forces(self, j: int) -> Array:
        """Column j of L as forces like v."""
        s, n = self.system, self.system.n_core
        ports = self.left[n:, j]
        return np.concatenate((self.left[:n, j], *(p.port_force(ports[s.port_slice(k)], self.t) for k, p in s.fields)))

    def seen(self, v: Array) -> Array:
        """R^T v, (r,); collective."""
        s, n = self.system, self.system.n_core
        y: Array = self.right[:n].T @ v[:n]
        local = [s.local_v(v, k) for k, _ in s.fields]
        for (k, _), ports in zip(s.fields, tangent_ports(s, local, self.t), strict=True):
            y = y + self.right[n:][s.port_slice(k)].T @ ports
        return y


def loaded_ports(system: System) -> np.ndarray:
    """Which ports belong to surfaces of fields that carry a force element with a tangent, (n_port,) bool."""
    out = np.zeros(system.n_port, dtype=bool)
    if not system.fields:
        return out
    m = system.markers
    carrying = {int(i) for loads in system.forces if loads.stiff for m in loads.markers for i in m}
    for slot, marker in enumerate(m.surface):
        if int(marker) in carrying:
            out[m.port[slot]] = True
    return out
