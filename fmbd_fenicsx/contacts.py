"""Contact: shapes of obstacles, points and surfaces of rigid bodies that touch, unilateral ties."""

from .mechanics.contact.contact import along, ball, corners, cylinder_end
from .mechanics.contact.obstacles import Obstacle
from .mechanics.shapes import Box, Cylinder, HalfSpace, SignedDistance, Sphere
from .schemes.impacts.unilateral import Unilateral

__all__ = [
    "Box",
    "Cylinder",
    "HalfSpace",
    "Obstacle",
    "SignedDistance",
    "Sphere",
    "Unilateral",
    "along",
    "ball",
    "corners",
    "cylinder_end",
]
