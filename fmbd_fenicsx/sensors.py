"""Sensors: what a run records."""

from .mechanics.joints.drives import angle, displacement
from .system.sensors.contact import (
    contact_force,
    contact_gap,
    contact_impulse,
    contact_pressure,
    contact_work,
    limit_effort,
)
from .system.sensors.elements import element_effort, element_force, element_power, element_torque, elongation, tension
from .system.sensors.points import elastic_displacement, point_value, strain
from .system.sensors.quantities import integral, largest, mean
from .system.sensors.rods import section_forces, section_strains
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
from .system.sensors.wires import dropper_forces, wire_height

__all__ = [
    "acceleration",
    "angle",
    "angular_velocity",
    "contact_force",
    "contact_gap",
    "contact_impulse",
    "contact_pressure",
    "contact_work",
    "coordinates",
    "displacement",
    "dropper_forces",
    "elastic_displacement",
    "element_effort",
    "element_force",
    "element_power",
    "element_torque",
    "elongation",
    "integral",
    "joint_rate",
    "largest",
    "limit_effort",
    "mean",
    "point_value",
    "position",
    "reaction",
    "reaction_force",
    "reaction_torque",
    "rotation",
    "section_forces",
    "section_strains",
    "strain",
    "tension",
    "velocity",
    "wire_height",
]
