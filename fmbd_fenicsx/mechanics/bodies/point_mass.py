"""A point mass: a body that moves and has no attitude."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

from ...checks import array, number
from ...errors import InputError
from ...rotations import Vector
from .bodies import RigidBody


@dataclass(frozen=True, eq=False)
class PointMass(RigidBody):
    """A mass at a point, without inertia about it: m r'' = forces; it does not turn.

    A mass on a string, a lump of a cable, a node of a chain. It takes part like any rigid body; what takes hold of it does so at
    its place: distances, pins and balls, lines and planes of other bodies, springs, forces, contact as a ball or a corner. What
    would turn it is refused. As a ball with friction it slides and does not roll.

    Args:
        name: what messages and sensors call it.
        mass: kg, positive.
        position: at the start, world axes, m: two numbers in the plane, three in space.
        velocity: at the start, m/s, (d,).
        locked, shape: as of :class:`~fmbd_fenicsx.RigidBody`.

    Its attitude is held by rows of its own, one in the plane and three in space, against which nothing acts.
    """

    turns: ClassVar[bool] = False

    inertia: Any = field(init=False, default=None, repr=False)
    position: Vector = field()
    rotation: Any = field(init=False, default=None, repr=False)
    angular_velocity: Any = field(init=False, default=None, repr=False)

    def __post_init__(self) -> None:
        what = f'Body "{self.name}"'
        dim = array(f"{what}: position", self.position).size
        if dim not in (2, 3):
            raise InputError(f"{what}: position {self.position} must have two numbers in the plane, three in space.")
        # the mass at a radius of gyration of 1 m: any would do, as nothing turns it
        mass = number(f"{what}: mass", self.mass, above=0.0, unit="kg")
        object.__setattr__(self, "inertia", mass if dim == 2 else (mass,) * 3)
        super().__post_init__()
