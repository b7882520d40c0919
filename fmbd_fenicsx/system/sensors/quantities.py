"""Sensors of UFL quantities of the displacement over whole elastic bodies, their volumes and surfaces: largest, integral, mean.

Full and reduced bodies are read alike, in the axes of the body and over its undeformed shape.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import function
from ...errors import InputError, require
from ...fem.mesh.mesh import Mesh
from ...mechanics.reduction.craig_bampton import ReducedBody
from ...rotations import Array
from ..layout import Layout
from .points import is_elastic, of_displacement
from .sensor import BodySensor, OfStates, OfStrains, Sensor

Read = Callable[[], Array]


@dataclass(frozen=True, eq=False)
class WholeBody(OfStates, BodySensor):
    """What is read of ``quantity`` (u) in UFL, displacement by displacement."""

    quantity: Callable[[Any], Any] = None  # type: ignore[assignment]

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """The values, (.., size); collective."""
        key = f"quantity {id(self)}"
        if key not in system.cache:
            system.cache[key] = self._prepared(system)
        k, u, basis, read = system.cache[key]

        found = []
        for one in q.reshape(math.prod(q.shape[:-1]), q.shape[-1]):  # a rank may hold nothing of the body
            local = system.local_q(one, k)
            nodal = local if basis is None else basis @ local
            u.x.array[: len(nodal)] = nodal
            u.x.scatter_forward()
            found.append(read())
        of_ranks = u.function_space.mesh.comm.allgather(np.array(found))
        return self.of_all(np.array(of_ranks)).reshape(*q.shape[:-1], -1)

    def of_all(self, of_ranks: Array) -> Array:
        """The values (states, size) from those of the ranks, (ranks, states, size)."""
        raise NotImplementedError

    def reader(self, mesh: Mesh, u: Any) -> Read:
        """What reads this rank's values (size,) of the displacement u; collective."""
        raise NotImplementedError

    def _prepared(self, system: Layout) -> tuple[int, Any, Array | None, Read]:
        """Number of the part, its displacement, the basis of a reduced one, and what reads it."""
        from dolfinx import fem

        k, part = system.part(self.body.name)
        if isinstance(self.body, ReducedBody):
            mesh, modes = part.body.source.mesh, part.body.reduction
            u = fem.Function(modes.space)
            return k, u, modes.phi, self.reader(mesh, u)
        u = fem.Function(part.field.space)
        return k, u, None, self.reader(part.field.mesh, u)


@dataclass(frozen=True, eq=False)
class Largest(OfStrains, WholeBody):
    """See :func:`largest`."""

    degree: int = 2

    def of_all(self, of_ranks: Array) -> Array:
        """The largest of all ranks."""
        return np.asarray(np.max(of_ranks, axis=0))

    def reader(self, mesh: Mesh, u: Any) -> Read:
        """Its points in all cells."""
        import basix
        from dolfinx import fem

        quantity = of_displacement("largest", self.quantity, u)
        if quantity.ufl_shape:
            raise InputError(
                f"largest: quantity(u) has the shape {quantity.ufl_shape}, expected one number at each place."
            )
        points, _ = basix.make_quadrature(mesh.dolfinx.basix_cell(), self.degree)
        expression = fem.Expression(quantity, points, comm=mesh.dolfinx.comm)
        cells = np.arange(mesh.dolfinx.topology.index_map(mesh.dim).size_local, dtype=np.int32)
        if not len(cells):
            return lambda: np.array([-np.inf])
        return lambda: np.array([expression.eval(mesh.dolfinx, cells).max()])


@dataclass(frozen=True, eq=False)
class IntegralSensor(WholeBody):
    """See :func:`integral`; ``over``: name of a volume or a surface, None: the body; ``mean``: over the measure of that."""

    over: str | None = None
    mean: bool = False

    def of_all(self, of_ranks: Array) -> Array:
        """The sum over the ranks, the same bits on all of them."""
        *parts, size = np.moveaxis(of_ranks.sum(axis=0), -1, 0)
        return np.stack(parts, axis=-1) / (size[:, None] if self.mean else 1.0)

    def reader(self, mesh: Mesh, u: Any) -> Read:
        """Its components row by row, and the measure."""
        from dolfinx import fem

        from ... import dolfinx_compat as compat

        measure = measure_of(mesh, self.over)
        quantity = of_displacement("mean" if self.mean else "integral", self.quantity, u)
        places = itertools.product(*map(range, quantity.ufl_shape))
        parts = [quantity[place] if place else quantity for place in places]
        one = fem.Constant(mesh.dolfinx, 1.0)
        forms = [compat.form(part * measure) for part in (*parts, one)]
        return lambda: np.array([fem.assemble_scalar(form) for form in forms])


def measure_of(mesh: Mesh, name: str | None) -> Any:
    """UFL's measure of a named volume or surface of a mesh, of all of it without a name."""
    import ufl

    if name is None or name in mesh.volumes:
        return mesh.dx if name is None else mesh.dx(mesh.volume_tag(name))
    return ufl.Measure("ds", domain=mesh.dolfinx, subdomain_data=mesh.facet_tags)(mesh.surface_tag(name))


def largest(body: Any, quantity: Callable[[Any], Any], *, unit: str = "Pa", degree: int = 2) -> Sensor:
    """Largest value over an elastic body of a scalar quantity(u) in UFL, u the displacement in the body's axes.

    Taken at the points of a quadrature rule of the given degree in each cell. Say the Mises stress:
    ``scene.sensor("stress", fmbd.largest(rod, lambda u: sqrt(...)))``. Collective, each time it is read.
    """
    return Largest(None, unit, None, *_given("largest", body, quantity), degree)


def integral(body: Any, quantity: Callable[[Any], Any], *, over: str | None = None, unit: str) -> Sensor:
    """Integral of quantity(u) in UFL over an elastic body, or over its volume or surface of the name ``over``.

    u is the displacement in the body's axes; tensors row by row, over the undeformed shape (in the plane per metre of depth, or
    with the thickness that the quantity holds). ``unit``: that of the integral. Say the energy of a volume:
    ``integral(rod, lambda u: 0.5 * inner(sigma(u), sym(grad(u))), over="steel", unit="J")``. Collective, each time it is read.

    Raises:
        InputError: no elastic body, or neither volume nor surface of that name.
    """
    return IntegralSensor(None, unit, None, *_given("integral", body, quantity, over), over)


def mean(body: Any, quantity: Callable[[Any], Any], *, over: str | None = None, unit: str = "Pa") -> Sensor:
    """Mean of quantity(u) in UFL over an elastic body, or over its volume or surface ``over``; as :func:`integral`.

    Say the mean stress of a material: ``scene.sensor("steel", fmbd.sensors.mean(rod, sigma, over="steel"))``.
    """
    return IntegralSensor(None, unit, None, *_given("mean", body, quantity, over), over, True)


def _given(what: str, body: Any, quantity: Any, over: str | None = None) -> tuple[Any, Callable[[Any], Any]]:
    """The body and the quantity, checked."""
    require(is_elastic(body), f"{what}(...) reads an elastic body on a mesh, found {body!r}.")
    mesh = body.solid.mesh
    if over is not None and over not in mesh.volumes and over not in mesh.surface_names:
        raise InputError(f"{what}: {mesh.missing(over)} Volumes: {', '.join(sorted(mesh.volumes))}.")
    return body, function(f"{what}: quantity", quantity)
