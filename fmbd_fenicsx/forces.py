"""Forces between bodies: springs, dampers, motors, tyres, forces and moments of the user's own."""

from .mechanics.forces.bushing import bushing
from .mechanics.forces.expressed import force_element
from .mechanics.forces.forces import Spring, Tyre, effort, force, joint_spring, own_force, torque
from .mechanics.forces.joint_elements import dry_friction, elastic_stop, joint_friction, motor
from .mechanics.joints.limits import joint_limit
from .system.control.controllers import controller, pid

__all__ = [
    "Spring",
    "Tyre",
    "bushing",
    "controller",
    "dry_friction",
    "effort",
    "elastic_stop",
    "force",
    "force_element",
    "joint_friction",
    "joint_limit",
    "joint_spring",
    "motor",
    "own_force",
    "pid",
    "torque",
]
