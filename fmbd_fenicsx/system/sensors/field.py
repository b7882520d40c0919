"""Sensors of elastic fields: the largest value of a quantity given in UFL, such as a stress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import require
from ...mechanics.bodies.bodies import AbsoluteBody, FloatingBody
from ...mechanics.reduction.craig_bampton import ReducedBody
from ...rotations import Array
from ..compiled.recording import Look, Recorded
from ..evaluation import Evaluation
from ..layout import Layout, State
from .sensor import BodySensor, Sensor


@dataclass(frozen=True, eq=False)
class Largest(BodySensor):
    """See :func:`largest`."""

    quantity: Callable[[Any], Any] = None  # type: ignore[assignment]
    degree: int = 2

    def read(self, ev: Evaluation, state: State, marker: int) -> Array:
        """The largest value over the body, (1,); collective."""
        return self._told(ev.system, state.q[None])[0]

    def looks_at(self, system: Layout, marker: int) -> Look:
        """The states."""
        return Look(states=True)

    def series(self, seen: Recorded, marker: int) -> Array:
        """The largest value in all records, (k, 1)."""
        return self._told(*seen.motion[:2])

    def _told(self, system: Layout, q: Array) -> Array:
        """The largest value over the body in states q (k, n_q): (k, 1); collective."""
        key = f"largest {id(self)}"
        if key not in system.cache:
            system.cache[key] = self._prepare(system)
        k, u, expression, cells, basis = system.cache[key]
        mesh = u.function_space.mesh

        found = np.full((len(q), 1), -np.inf)
        for i in range(len(q)):
            local = system.local_q(q[i], k)
            nodal = local if basis is None else basis @ local
            u.x.array[: len(nodal)] = nodal
            u.x.scatter_forward()
            if len(cells):
                found[i] = expression.eval(mesh, cells).max()
        return np.asarray(np.max(mesh.comm.allgather(found), axis=0))

    def _prepare(self, system: Layout) -> tuple[Any, ...]:
        import basix
        from dolfinx import fem

        k, part = system.part(self.body.name)
        modes = part.body.reduction if isinstance(self.body, ReducedBody) else None
        space = part.field.space if modes is None else modes.space
        u = fem.Function(space)
        points, _ = basix.make_quadrature(space.mesh.basix_cell(), self.degree)
        expression = fem.Expression(self.quantity(u), points)
        cells = np.arange(space.mesh.topology.index_map(space.mesh.topology.dim).size_local, dtype=np.int32)
        return k, u, expression, cells, None if modes is None else modes.phi


def largest(body: Any, quantity: Callable[[Any], Any], *, unit: str = "Pa", degree: int = 2) -> Sensor:
    """Largest value over an elastic body of a scalar quantity(u) in UFL, u the displacement in the body's axes.

    Taken at the points of a quadrature rule of the given degree in each cell. Say the Mises stress:
    ``scene.sensor("stress", fmbd.largest(rod, lambda u: sqrt(...)))``. Collective, each time it is read.
    """
    require(
        isinstance(body, FloatingBody | AbsoluteBody | ReducedBody),
        f"largest(...) reads an elastic body on a mesh, found {body!r}.",
    )
    return Largest(None, unit, None, body, quantity, degree)
