"""A bar 1 m x 0.05 m x 0.05 m along x on a regular grid of tetrahedra, surfaces "pin" (x = 0) and "tip" (x = 1).

With quadratic displacements ``along`` x ``across`` x ``across`` boxes have 3 (2 along + 1) (2 across + 1)^2 unknowns.
"""

from typing import Any


def build(gmsh: Any, along: int = 20, across: int = 2) -> None:
    """Model of the bar with so many boxes of cells along and across it."""
    gmsh.model.add("bar")
    body = gmsh.model.occ.addBox(0.0, -0.025, -0.025, 1.0, 0.05, 0.05)
    gmsh.model.occ.synchronize()
    for _, curve in gmsh.model.getEntities(1):
        low, high = gmsh.model.getBoundingBox(1, curve)[:3], gmsh.model.getBoundingBox(1, curve)[3:]
        gmsh.model.mesh.setTransfiniteCurve(curve, (along if high[0] - low[0] > 0.5 else across) + 1)
    for _, surface in gmsh.model.getEntities(2):
        gmsh.model.mesh.setTransfiniteSurface(surface)
    gmsh.model.mesh.setTransfiniteVolume(body)
    gmsh.model.addPhysicalGroup(3, [body], name="bar")
    for name, x in (("pin", 0.0), ("tip", 1.0)):
        at = [t for _, t in gmsh.model.getEntities(2) if abs(gmsh.model.occ.getCenterOfMass(2, t)[0] - x) < 1e-9]
        gmsh.model.addPhysicalGroup(2, at, name=name)
    gmsh.model.mesh.generate(3)
