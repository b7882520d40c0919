"""Constraints, joint coordinates and force elements, each defined once by one expression of two frames."""
