"""A straight rod along x with surfaces "pin" (x = 0), "tip" (x = length) and "side".

2D: a rectangle of triangles; 3D: a box of tetrahedra. The axis is y = 0 (and z = 0).
"""

from typing import Any


def build(gmsh: Any, dim: int = 2, length: float = 1.0, height: float = 0.1, h: float = 0.05) -> None:
    """Model of a rod of the given length and height (m) with cells of size h (m)."""
    gmsh.model.add("rod")
    occ = gmsh.model.occ
    if dim == 2:
        body = occ.addRectangle(0.0, -height / 2, 0.0, length, height)
    else:
        body = occ.addBox(0.0, -height / 2, -height / 2, length, height, height)
    occ.synchronize()
    gmsh.model.addPhysicalGroup(dim, [body], name="rod")
    ends: dict[str, list[int]] = {"pin": [], "tip": [], "side": []}
    for _, tag in gmsh.model.getEntities(dim - 1):
        x = gmsh.model.occ.getCenterOfMass(dim - 1, tag)[0]
        name = "pin" if x < 1e-9 * length else "tip" if x > length * (1 - 1e-9) else "side"
        ends[name].append(tag)
    for name, tags in ends.items():
        gmsh.model.addPhysicalGroup(dim - 1, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMin", h)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.generate(dim)
