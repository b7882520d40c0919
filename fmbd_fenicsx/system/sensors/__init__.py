"""Sensors: what is read from a state."""
