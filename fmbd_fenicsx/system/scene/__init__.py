"""Scenes: what the user builds, and the system that is made of it."""
