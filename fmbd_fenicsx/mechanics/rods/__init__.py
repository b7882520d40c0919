"""Geometrically exact rods in space: reference curves, section laws, strains of the interpolation, elements, the body."""
