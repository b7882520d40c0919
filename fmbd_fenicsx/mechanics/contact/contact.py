"""Contact as a user describes it: which surface may touch which obstacle or surface, and by which law.

    gap g >= 0,   force Lambda >= 0,   Lambda g = 0                         (Signorini)                     (1)
    |tau| <= mu Lambda,   tau = -mu Lambda s / |s| where it slips           (Coulomb)                       (2)

Both are unilateral rows of the same saddle point as the joints. On elastic surfaces the multiplier is a field on the
trace with the dual (biorthogonal) basis psi_i of the Lagrange basis phi_i, so that the row of a node couples to this
node only:

    int psi_i phi_j = delta_ij D_i,   D_i = int phi_i,   force on node i: Lambda_i = p_i D_i with the
    pressure p_i.    (3)

Source: Wohlmuth, "Variationally consistent discretization schemes and numerical algorithms for contact
problems", doi:10.1017/S0962492911000079.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import array, number, typed, vector, whole
from ...errors import InputError, require
from ...rotations import Array, tangents_of
from ..bodies.bodies import RigidBody, Surface
from ..parts import ScenePart
from ..rods.rods import Rod, node_name
from ..shapes import Shape
from .obstacles import Obstacle


@dataclass(frozen=True, eq=False)
class RigidPoints:
    """Points of a rigid body that may touch, each the centre of a ball of ``radius`` m (0: a corner).

    ``points`` (n, d) in body axes from the centre of mass; see :func:`ball`, :func:`corners`,
    :func:`cylinder_end`.
    """

    body: RigidBody
    points: Array
    radius: float = 0.0

    @property
    def dim(self) -> int:
        """Space dimension of the body."""
        return self.body.dim

    def at(self, frame_of: Mapping[str, int]) -> tuple[np.ndarray, Array]:
        """Frames (n,) of the points and their places (n, d) there; ``frame_of``: body -> frame."""
        return np.full(len(self.points), frame_of[self.body.name]), self.points

    def __post_init__(self) -> None:
        require(
            self.body.turns or not self.points.any(),
            f'Body "{self.body.name}" is a point mass: it touches at its place, as ball(body, radius). '
            "Take a RigidBody with its inertia for points elsewhere.",
        )

    def __repr__(self) -> str:
        return f'points of "{self.body.name}"'


@dataclass(frozen=True, eq=False)
class RodPoints:
    """The nodes of a rod, each the centre of a ball of ``radius`` m; see :func:`along`."""

    body: Rod
    radius: float
    dim = 3

    def at(self, frame_of: Mapping[str, int]) -> tuple[np.ndarray, Array]:
        """Frames (n,) of the nodes and places (n, 3) there: their origins."""
        nodes = len(self.body.nodes)
        return frame_of[node_name(self.body.name, 0)] + np.arange(nodes), np.zeros((nodes, 3))

    def __repr__(self) -> str:
        return f'nodes of "{self.body.name}"'


@typed
def along(rod: Rod, radius: float) -> RodPoints:
    """The surface of a rod, round with ``radius`` m about its curve: a ball at each node.

    Between two nodes at the distance l, a rod around an obstacle of radius R comes closer by l^2 / (8 R) at most: take elements
    enough. Forces are those of the nodes (N); over the length that belongs to a node, ``rod.lengths``, they are N/m.
    """
    number(f'along("{rod.name}"): radius', radius, above=0.0, unit="m")
    return RodPoints(rod, float(radius))


@typed
def ball(body: RigidBody, radius: float, *, center: Sequence[float] | None = None) -> RigidPoints:
    """The surface of a ball (plane: a disk) of ``radius`` m about ``center`` in body axes (the centre of
    mass by default).
    """
    radius = number(f'ball("{body.name}"): radius', radius, above=0.0, unit="m")
    c = np.zeros(body.dim) if center is None else vector(f'ball("{body.name}"): center', center, size=body.dim)
    return RigidPoints(body, c[None], radius)


@typed
def corners(body: RigidBody, points: Sequence[Sequence[float]] | Array) -> RigidPoints:
    """Corners of a rigid body, (n, d) m, in body axes from its centre of mass as its ``shape`` is: (w/2, -h/2), ... of a
    ``Box((w, h))``. (Points of joints, forces and sensors are places in the world instead.)
    """
    found = array(f'corners("{body.name}"): points', points, shape=f"(n, {body.dim}) finite numbers")
    require(
        found.ndim == 2 and found.shape[1] == body.dim and len(found) > 0,
        f'corners("{body.name}"): points must be (n, {body.dim}) finite numbers, found shape {found.shape}.',
    )
    return RigidPoints(body, found)


@typed
def cylinder_end(
    body: RigidBody, radius: float, *, center: Sequence[float], axis: Sequence[float], points: int = 12
) -> RigidPoints:
    """The rim of a cylinder's end in body axes, as a ring of points (3D)."""
    what = f'cylinder_end("{body.name}")'
    require(body.dim == 3, f"{what} is for bodies of space; in the plane use corners.")
    number(f"{what}: radius", radius, above=0.0, unit="m")
    whole(f"{what}: points", points, least=3)
    place = vector(f"{what}: center", center, size=3)
    e = vector(f"{what}: axis", axis, size=3, zero=False)
    e = e / np.linalg.norm(e)
    a, b = tangents_of(e[None])
    angle = 2 * np.pi * np.arange(points)[:, None] / points
    ring = np.cos(angle) * a + np.sin(angle) * b
    return RigidPoints(body, place + radius * ring)


@dataclass(frozen=True, eq=False)
class Contact(ScenePart):
    """A pair that may touch; made by :func:`contact`, which documents the fields."""

    what = "contact"

    name: str
    slave: Any
    master: Any
    friction: float = 0.0
    restitution: float = 0.0
    search: float | None = None
    redistribute_mass: bool = True
    exchanged: bool = False  # whether the slave is the master that was given

    @cached_property
    def bounces(self) -> bool:
        """Whether its points carry inertia that cannot be taken off: those of rigid bodies, of rods, and of modes."""
        touching = [self.slave, *([self.master] if isinstance(self.master, Surface) else [])]
        return not all(isinstance(side, Surface) and side.body.nodal for side in touching)

    @property
    def massless(self) -> bool:
        """Whether the inertia of its nodes goes to their neighbours."""
        return self.redistribute_mass and not self.bounces


@typed
def contact(
    name: str,
    slave: Surface | RigidPoints | RodPoints,
    master: Obstacle | Shape | Surface | RodPoints,
    *,
    friction: float = 0.0,
    restitution: float = 0.0,
    search: float | None = None,
    redistribute_mass: bool = True,
) -> Contact:
    """Unilateral contact (1) of a surface with an obstacle or another surface, with Coulomb friction (2).

    Args:
        name: what messages, sensors and the plan call the pair.
        slave: a surface of an elastic body, points of a rigid one, or a rod (:func:`along`).
        master: an obstacle, a shape at rest in world axes, or a surface of another elastic body; candidates are nodes of the
            surface with the smaller facets, whichever is given first.
        friction: Coulomb's coefficient mu; 0 carries no friction rows.
        restitution: ratio e of normal velocities after and before an impact; read by the Moreau scheme only.
        search: distance (m) up to which points are candidates; by default chosen from the speed and the size.
        redistribute_mass: no inertia on the contact nodes, total mass, centre and inertia kept; see
        ``docs/contact.md``.

    Raises:
        InputError: slave and master are the same surface, a body without a mesh, or values out of range.
    """
    what = f'Contact "{name}"'
    number(f"{what}: friction", friction, least=0.0)
    require(0 <= restitution <= 1, f"{what}: restitution {restitution} must lie in [0, 1].")
    if search is not None:
        number(f"{what}: search", search, above=0.0, unit="m")

    # each side by itself
    for side in (slave, master):
        if isinstance(side, Surface) and not side.body.meshed:
            raise InputError(
                f'{what}: body "{side.body.name}" has no mesh whose surface could touch. Contact takes surfaces of FloatingBody, '
                "AbsoluteBody and their reduced bodies, points of a RigidBody (fmbd.contacts.corners, ball, cylinder_end), and "
                "rods (fmbd.contacts.along)."
            )

    if isinstance(master, RodPoints):
        raise InputError(
            f'{what}: rod "{master.body.name}" cannot be the master: contact between rods is not offered. Rods touch obstacles, '
            "on the ground or on a rigid body. Give a stiff one of the two as a RigidBody with an Obstacle such as a Cylinder."
        )
    if isinstance(slave, RigidPoints):
        require(not slave.body.locked, f'{what}: the slave body "{slave.body.name}" is locked; it cannot move.')
    if isinstance(master, Shape):
        master = Obstacle(name, master)

    # and both together
    if isinstance(master, Obstacle):
        master.shape.check(what, slave.dim)
        require(
            master.on is not slave.body,
            f'{what}: its slave and the obstacle "{master.name}" are both of body "{slave.body.name}". '
            "Give an obstacle on another body, or at rest.",
        )

    if isinstance(master, Surface):
        if isinstance(slave, RigidPoints | RodPoints):
            raise InputError(
                f'Contact "{name}": give the elastic surface as slave, and an Obstacle on a rigid body as master.'
            )
        if slave.body is master.body and slave.name == master.name:
            raise InputError(
                f'Contact "{name}": slave and master are the same facets, {slave!r}. Name two different surfaces.'
            )
        if slave.body is master.body:
            raise InputError(f'Contact "{name}": contact of "{slave.body.name}" with itself is not offered.')

    return Contact(name, slave, master, float(friction), float(restitution), search, redistribute_mass)
