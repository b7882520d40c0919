"""Sensors of elastic bodies at material points: motion, displacement, strain, any UFL quantity of the displacement.

With the body's frame (r, R), its angular velocity w in body axes and P = X - r_0 + u at the point,

    x = r + R P,    x' = r' + R (w x P + u'),    x'' = r'' + R (w' x P + w x (w x P) + 2 w x u' + u'')      (1)

Bodies in absolute coordinates have the frame of the ground. Full and reduced bodies are read alike: a reduced one keeps the
values of its modes at the nodes of the one cell that holds the point. The point is given where the mesh was placed, world axes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...checks import function, vector
from ...errors import InputError, require
from ...fem.material_points import MaterialPoint, check_point, material_point
from ...mechanics.bodies.bodies import AbsoluteBody, FloatingBody
from ...mechanics.reduction.craig_bampton import ReducedBody
from ...rotations import Array, matvec
from ..layout import Layout
from .sensor import BodySensor, OfStates, OfStrains, Sensor

PAIRS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}  # of symmetric tensors


@dataclass(frozen=True, eq=False)
class PointOfBody:
    """A material point found in the mesh of a part of a system.

    ``modes`` (k, d, m): values of a reduced body's modes at the cell's nodes, None for others. ``lever`` (d,): X - r_0, m.
    """

    number: int
    space: Any
    point: MaterialPoint
    modes: Array | None
    lever: Array

    def nodal(self, local: Array) -> Array:
        """Displacements (.., k, d) of the cell's nodes, or rates of them, from local coordinates (.., n); collective."""
        if self.modes is not None:
            return np.asarray((self.modes @ local[..., None, :, None])[..., 0])
        d = len(self.lever)
        count = self.space.dofmap.index_map.size_local

        return self.point.nodal(local[..., : count * d].reshape(*local.shape[:-1], count, d))

    def value(self, local: Array) -> Array:
        """Displacement (.., d) of the point, or its rate, likewise; collective."""
        return np.asarray(self.point.shape @ self.nodal(local))


def find(system: Layout, body: Any, X: Array) -> PointOfBody:
    """A point of a body in a system; collective."""
    number, part = system.part(body.name)
    reduced = isinstance(body, ReducedBody)
    space = part.body.reduction.space if reduced else part.field.space
    origin = part.constants.center if reduced else part.origin

    found = material_point(space, X)

    modes = None
    if reduced:
        # modes at the nodes of the point's cell: (nodes, components, modes)
        phi = part.body.reduction.phi
        d, m = len(X), phi.shape[1]
        modes = found.nodal(phi.reshape(len(phi) // d, d * m)).reshape(len(found.shape), d, m)
    return PointOfBody(number, space, found, modes, X - origin)


@dataclass(frozen=True, eq=False)
class PointSensor(OfStates, BodySensor):
    """A quantity at the material point ``at`` (d,) of a body, read from one state or from many at a time."""

    at: tuple[float, ...] = ()

    @property
    def labels(self) -> Sequence[str]:
        """Components of a vector."""
        return "xyz"

    def found(self, system: Layout) -> PointOfBody:
        """The point in the system, searched once; collective."""
        key = f"material point {id(self)}"
        if key not in system.cache:
            system.cache[key] = find(system, self.body, np.array(self.at))
        return system.cache[key]  # type: ignore[no-any-return]

    def displacements(self, s: Layout, q: Array) -> Array:
        """Displacements (.., k, d) of the nodes of the point's cell, body axes; collective."""
        p = self.found(s)
        return p.nodal(s.local_q(q, p.number))


@dataclass(frozen=True, eq=False)
class PointMotion(PointSensor):
    """Position (derivative 0), velocity (1) or acceleration (2) of the point by (1), world axes, (d,)."""

    derivative: int = 0

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """x, x' or x''."""
        p, s, m = self.found(system), system, system.motions
        k, d = s.parts[p.number].frame, len(self.at)
        pose, twist = s.pose_of(q, k), s.twist_of(v, k)
        R = m.matrix(pose)

        P = p.lever + p.value(s.local_q(q, p.number))
        if self.derivative == 0:
            return np.asarray(pose[..., :d] + matvec(R, P))

        w = twist[..., d:]
        rate = p.value(s.local_v(v, p.number))
        if self.derivative == 1:
            return np.asarray(twist[..., :d] + matvec(R, m.spin(w, P) + rate))

        accel = s.twist_of(a, k)
        second = p.value(s.local_v(a, p.number))
        turning = m.spin(accel[..., d:], P) + m.spin(w, m.spin(w, P)) + 2 * m.spin(w, rate)
        return np.asarray(accel[..., :d] + matvec(R, turning + second))


@dataclass(frozen=True, eq=False)
class PointDisplacement(PointSensor):
    """u of the point, axes of the body's frame, (d,)."""

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """u, m."""
        p = self.found(system)
        return p.value(system.local_q(q, p.number))


@dataclass(frozen=True, eq=False)
class PointStrain(OfStrains, PointSensor):
    """Strain at the point, body axes: xx, yy, xy in the plane, xx, yy, zz, yz, xz, xy in space; tensor components.

    Of bodies with a linear form sym(grad u), of those with an energy (grad u + grad u^T + grad u^T grad u) / 2.
    """

    @property
    def labels(self) -> Sequence[str]:
        """Components of the tensor."""
        return ["xyz"[i] + "xyz"[j] for i, j in PAIRS[len(self.at)]]

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """Components of the strain."""
        H = np.swapaxes(self.displacements(system, q), -1, -2) @ self.found(system).point.gradient
        Ht = np.swapaxes(H, -1, -2)
        strain = 0.5 * (H + Ht)
        if self.body.nonlinear:
            strain = strain + 0.5 * Ht @ H
        return np.stack([strain[..., i, j] for i, j in PAIRS[len(self.at)]], axis=-1)


@dataclass(frozen=True, eq=False)
class PointQuantity(OfStrains, PointSensor):
    """quantity(u) in UFL at the point; see :func:`point_value`."""

    quantity: Callable[[Any], Any] = None  # type: ignore[assignment]

    @property
    def labels(self) -> Sequence[str]:
        """None: a scalar, or numbered components row by row."""
        return ()

    def told(self, system: Layout, q: Array, v: Array, a: Array) -> Array:
        """The components, row by row; collective."""
        p = self.found(system)
        key = f"point value {id(self)}"
        if key not in system.cache:
            system.cache[key] = self._prepare(p)
        u, expression = system.cache[key]

        # one cell is evaluated, so the values of its nodes are enough
        d, nodal = len(self.at), self.displacements(system, q)
        values = None
        if p.point.cell >= 0:
            nodes, cell = p.space.dofmap.cell_dofs(p.point.cell), np.array([p.point.cell], np.int32)
            on_nodes = u.x.array.reshape(-1, d)
            found = []
            for one in nodal.reshape(-1, len(nodes), d):
                on_nodes[nodes] = one
                found.append(np.array(expression.eval(p.space.mesh, cell)).ravel())
            values = np.array(found).reshape(*q.shape[:-1], -1)
        return np.asarray(p.space.mesh.comm.bcast(values, root=p.point.owner))

    def _prepare(self, p: PointOfBody) -> tuple[Any, Any]:
        from dolfinx import fem

        u = fem.Function(p.space)
        return u, fem.Expression(of_displacement("point_value", self.quantity, u), p.point.reference)


def of_displacement(what: str, quantity: Callable[[Any], Any], u: Any) -> Any:
    """quantity(u) as a UFL expression.

    Raises:
        InputError: it fails, or gives none.
    """
    from ufl import as_ufl

    try:
        return as_ufl(quantity(u))
    except Exception as error:
        why = f"{type(error).__name__}: {str(error).rstrip('.')}"
        raise InputError(
            f"{what}: quantity(u) failed: {why}. It gives a UFL expression of the displacement u."
        ) from error


def is_elastic(body: Any) -> bool:
    """Whether a body has material points on a mesh."""
    return isinstance(body, FloatingBody | AbsoluteBody | ReducedBody)


def _point(what: str, body: Any, point: Any) -> tuple[Any, tuple[float, ...]]:
    require(is_elastic(body), f"{what} reads a material point of an elastic body on a mesh, found {body!r}.")
    x = vector(f"{what}: point", point, size=body.dim)
    check_point(body.solid.mesh, x, what)
    return body, tuple(float(c) for c in x)


def point_motion(what: str, body: Any, point: Any, level: int) -> Sensor:
    """Position, velocity or acceleration of a material point: what ``position(body, point=...)`` makes for elastic bodies."""
    unit = ("m", "m/s", "m/s^2")[level]

    return PointMotion(None, unit, None, *_point(what, body, point), level)


def elastic_displacement(body: Any, *, point: Sequence[float]) -> Sensor:
    """Displacement u (m) of a material point of an elastic body in the axes of the body's frame, (d,).

    ``point``: where it lies in the mesh as it was placed, world axes, m. Of absolute bodies the whole motion x - X.
    """
    return PointDisplacement(None, "m", None, *_point("elastic_displacement", body, point))


def strain(body: Any, *, point: Sequence[float]) -> Sensor:
    """Strain at a material point, body axes: xx, yy, xy in the plane; xx, yy, zz, yz, xz, xy in space (tensor components).

    Of bodies with ``elastic`` the linear strain, of those with ``energy`` that of Green and Lagrange. Within one cell, so it
    jumps where the point crosses to the next. ``point`` as in :func:`elastic_displacement`.
    """
    return PointStrain(None, "1", None, *_point("strain", body, point))


def point_value(body: Any, quantity: Callable[[Any], Any], *, point: Sequence[float], unit: str = "Pa") -> Sensor:
    """Value of quantity(u) in UFL at a material point, u the displacement in the body's axes; tensors row by row.

    Say a stress: ``point_value(rod, lambda u: 2 * mu * sym(grad(u)) + lam * div(u) * Identity(2), point=(0.5, 0.02))``.
    ``point`` as in :func:`elastic_displacement`. Collective, each time it is read.
    """
    body, at = _point("point_value", body, point)
    return PointQuantity(None, unit, None, body, at, function("point_value: quantity", quantity))
