"""Computational flexible multibody dynamics on FEniCSx, by the differential-algebraic approach."""

from . import errors, materials
from .energies import MixedEnergy, ViscousForm
from .fem.loads import Load, body_force, pressure, thermal_stress, traction
from .log import say
from .mechanics.bodies.beams import Beam, Section
from .mechanics.bodies.bodies import (
    AbsoluteBody,
    Attached,
    Chord,
    CoordinateBody,
    FloatingBody,
    MeanAxis,
    RigidBody,
    Surface,
)
from .mechanics.bodies.line_body import LineBody
from .mechanics.forces.forces import Spring, Tyre, effort, force, joint_spring, own_force, torque
from .mechanics.joints.drives import angle, displacement, drive, gear, own_joint, screw
from .mechanics.joints.joints import (
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
from .mechanics.reduction.craig_bampton import CraigBampton
from .mechanics.reduction.recovery import displacement as displacement_field
from .mechanics.reduction.recovery import stress
from .run.output import Output
from .run.solve import Run, solve
from .schemes.dae import GGL, Baumgarte, Index1, Index2, Index3, Overdetermined, Projected, StateSpace
from .schemes.multistep.bdf import BDF
from .schemes.newton import ExactTangent, Newton
from .schemes.onestep.energy_momentum import EnergyMomentum
from .schemes.onestep.generalized_alpha import GeneralizedAlpha
from .schemes.onestep.half_explicit import HalfExplicit
from .schemes.onestep.radau import Radau
from .schemes.onestep.rattle import Rattle
from .system.scene.scene import Scene
from .system.sensors.sensors import (
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

__version__ = "0.1.0"


_LATER = {
    "system.sensors.field": ("largest",),
    "system.sensors.wires": ("wire_height", "dropper_forces"),
    "mechanics.catenary.wires": ("Dropper", "PointSupport", "Wire", "Wires"),
    "mechanics.catenary.sliding": ("SlidingContact",),
    "schemes.impacts.unilateral": ("Unilateral",),
    "mechanics.joints.surface_ties": ("tie_surface", "SurfaceTie", "finer_first"),
    "fem.traces.multipliers": ("Aggregated", "Continuous", "Discontinuous", "Dual", "Ends", "Linear"),
    "fem.traces.stability": ("infsup",),
    "linear.saddle.presets": ("Bddc", "Cholesky", "Direct", "FieldSplit", "Multigrid", "Schur"),
    "mechanics.contact.contact": ("contact", "ball", "corners", "cylinder_end"),
    "mechanics.contact.shapes": ("Box", "Cylinder", "HalfSpace", "Obstacle", "SignedDistance", "Sphere"),
    "system.sensors.contact": ("contact_force", "contact_gap", "contact_impulse", "contact_pressure", "contact_work"),
    "schemes.impacts.contact_midpoint": ("ContactMidpoint",),
    "schemes.impacts.contact_alpha": ("ContactAlpha",),
    "schemes.impacts.moreau": ("Moreau",),
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
        return import_module(f".post.{name}", __name__)
    raise AttributeError(f"module 'fmbd_fenicsx' has no attribute {name!r}")
