"""Forces between bodies: springs, dampers, motors, tyres, forces and moments of the user's own."""

from .mechanics.forces.forces import Spring, Tyre, effort, force, joint_spring, own_force, torque

__all__ = ["Spring", "Tyre", "effort", "force", "joint_spring", "own_force", "torque"]
