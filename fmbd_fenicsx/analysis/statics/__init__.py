"""Equilibria: at rest, in steady rotation, with contact, along paths of loads."""
