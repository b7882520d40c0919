"""A round disc with its edge as the surface "rim", cut into triangles of size ``h``; lengths in m."""

from typing import Any


def build(gmsh: Any, radius: float = 1.0, h: float = 0.1) -> None:
    """Model of the disc about the origin."""
    gmsh.model.add("disc")
    disc = gmsh.model.occ.addDisk(0.0, 0.0, 0.0, radius, radius)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [disc], name="disc")
    gmsh.model.addPhysicalGroup(1, [tag for _, tag in gmsh.model.getEntities(1)], name="rim")

    for option in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(option, h)
    gmsh.model.mesh.generate(2)
