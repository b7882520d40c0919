"""Meshes from gmsh, CAD and files, with their named regions."""
