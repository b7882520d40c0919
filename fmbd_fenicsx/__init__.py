"""Computational flexible multibody dynamics on FEniCSx, by the differential-algebraic approach."""

from . import errors, materials
from .energies import MixedEnergy, ViscousForm
from .log import say
from .mechanics.beams import Beam, Section
from .mechanics.bodies import (
    AbsoluteBody,
    Attached,
    Chord,
    CoordinateBody,
    FloatingBody,
    MeanAxis,
    RigidBody,
    Surface,
)
from .mechanics.drives import angle, displacement, drive, gear, own_joint, screw
from .mechanics.forces import Spring, Tyre, effort, force, joint_spring, own_force, torque
from .mechanics.joints import (
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
from .mechanics.line_body import LineBody
from .mechanics.recovery import displacement as displacement_field
from .mechanics.recovery import stress
from .mechanics.reduction import CraigBampton
from .run.output import Output
from .run.solve import Run, solve
from .schemes.bdf import BDF
from .schemes.dae import GGL, Baumgarte, Index1, Index2, Index3, Overdetermined, Projected, StateSpace
from .schemes.energy_momentum import EnergyMomentum
from .schemes.generalized_alpha import GeneralizedAlpha
from .schemes.half_explicit import HalfExplicit
from .schemes.newton import ExactTangent, Newton
from .schemes.radau import Radau
from .schemes.rattle import Rattle
from .system.scene import Scene
from .system.sensors import (
    acceleration,
    angular_velocity,
    coordinates,
    joint_rate,
    position,
    reaction,
    reaction_force,
    reaction_torque,
    rotation,
    velocity,
)
from .traces.loads import Load, body_force, pressure, thermal_stress, traction

__version__ = "0.1.0"


_LATER = {
    "system.sensors_field": ("largest",),
    "system.sensors_wires": ("wire_height", "dropper_forces"),
    "mechanics.wires": ("Dropper", "PointSupport", "Wire", "Wires"),
    "mechanics.sliding": ("SlidingContact",),
    "schemes.unilateral": ("Unilateral",),
    "mechanics.trace_ties": ("tie_surface", "SurfaceTie", "finer_first"),
    "traces.multipliers": ("Aggregated", "Continuous", "Discontinuous", "Dual", "Ends", "Linear"),
    "traces.stability": ("infsup",),
    "linear.presets": ("Bddc", "Cholesky", "Direct", "FieldSplit", "Multigrid", "Schur"),
    "mechanics.contact": ("contact", "ball", "corners", "cylinder_end"),
    "mechanics.contact_shapes": ("Box", "Cylinder", "HalfSpace", "Obstacle", "SignedDistance", "Sphere"),
    "system.sensors_contact": ("contact_force", "contact_gap", "contact_impulse", "contact_pressure", "contact_work"),
    "schemes.contact_midpoint": ("ContactMidpoint",),
    "schemes.contact_alpha": ("ContactAlpha",),
    "schemes.moreau": ("Moreau",),
    "run.checkpoint": ("Checkpoint",),
}


def __getattr__(name: str) -> object:
    """The mesh reader, contact and field multipliers are loaded at first use: other scenes do not need them."""
    from importlib import import_module

    for module, names in _LATER.items():
        if name in names:
            found = getattr(import_module(f".{module}", __name__), name)
            globals()[name] = found  # the module of the same name must not hide the function
            return found
    if name in ("read_gmsh", "Mesh"):
        from . import mesh

        return getattr(mesh, name)
    if name in ("demo", "plot", "study"):
        return import_module(f".faces.{name}", __name__)
    raise AttributeError(f"module 'fmbd_fenicsx' has no attribute {name!r}")
