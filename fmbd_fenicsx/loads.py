"""Loads on elastic bodies: tractions, pressures, body forces, thermal stress."""

from .fem.loads import Load, body_force, pressure, thermal_stress, traction

__all__ = ["Load", "body_force", "pressure", "thermal_stress", "traction"]
