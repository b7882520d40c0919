"""A flat circular ring of triangles with surfaces "inner" and "outer"; its centre is the origin."""

from typing import Any


def build(gmsh: Any, radius: float = 1.0, width: float = 0.2, h: float = 0.1) -> None:
    """Model of a ring with the given mean radius and width (m), cells of size h (m)."""
    gmsh.model.add("ring")
    occ = gmsh.model.occ
    outer = occ.addDisk(0.0, 0.0, 0.0, radius + width / 2, radius + width / 2)
    inner = occ.addDisk(0.0, 0.0, 0.0, radius - width / 2, radius - width / 2)
    ring, _ = occ.cut([(2, outer)], [(2, inner)])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [tag for _, tag in ring], name="ring")
    for _, tag in gmsh.model.getEntities(1):
        low = gmsh.model.getBoundingBox(1, tag)[0]
        gmsh.model.addPhysicalGroup(1, [tag], name="outer" if low < -radius else "inner")
    gmsh.option.setNumber("Mesh.MeshSizeMin", h)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.generate(2)
