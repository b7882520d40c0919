"""Computational flexible multibody dynamics on FEniCSx, by the differential-algebraic approach."""

from . import errors, materials
from .bodies import Attached, CoordinateBody, FloatingBody, MeanAxis, RigidBody, Surface
from .forces import Spring, force, torque
from .joints import (
    cylindrical,
    distance,
    drive_rotation,
    drive_translation,
    fixed,
    ground,
    planar,
    point_on_line,
    prismatic,
    revolute,
    spherical,
    universal,
)
from .log import say
from .newton import Newton
from .output import Output
from .scene import Scene
from .schemes.generalized_alpha import GeneralizedAlpha
from .sensors import coordinates, position, reaction, rotation, velocity
from .solve import Run, solve

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """The mesh reader is loaded at first use: rigid scenes need no mesh library."""
    if name in ("read_gmsh", "Mesh"):
        from . import mesh

        return getattr(mesh, name)
    raise AttributeError(f"module 'fmbd_fenicsx' has no attribute {name!r}")
