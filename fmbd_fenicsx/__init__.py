"""Computational flexible multibody dynamics on FEniCSx, by the differential-algebraic approach."""

from . import errors, materials
from .bodies import AbsoluteBody, Attached, CoordinateBody, FloatingBody, MeanAxis, RigidBody, Surface
from .drives import angle, displacement, drive, gear, own_joint, screw
from .forces import Spring, Tyre, effort, force, joint_spring, own_force, torque
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
from .sensors import (
    coordinates,
    joint_rate,
    position,
    reaction,
    reaction_force,
    reaction_torque,
    rotation,
    velocity,
)
from .solve import Run, solve

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """The mesh reader is loaded at first use: rigid scenes need no mesh library."""
    if name in ("read_gmsh", "Mesh"):
        from . import mesh

        return getattr(mesh, name)
    raise AttributeError(f"module 'fmbd_fenicsx' has no attribute {name!r}")
