"""A strip along x of layers one above the other, each a volume of its own: one body of several materials.

Volumes have the names of ``layers``, from below, surfaces are "left", "right" (x), "bottom", "top" (y).
"""

from typing import Any


def build(gmsh: Any, layers: dict[str, float], length: float = 1.0, width: float = 0.0, h: float = 0.05) -> None:
    """Model of layers with thicknesses (m) by name, in the plane or of a ``width`` (m), with cells of size h (m)."""
    gmsh.model.add("layers")
    occ, dim = gmsh.model.occ, 3 if width else 2
    parts, y = [], 0.0
    for thickness in layers.values():
        box = occ.addBox(0, y, 0, length, thickness, width) if width else occ.addRectangle(0, y, 0, length, thickness)
        parts.append((dim, box))
        y += thickness
    occ.fragment(parts, [])
    occ.synchronize()
    for (_, part), name in zip(parts, layers, strict=True):
        gmsh.model.addPhysicalGroup(dim, [part], name=name)

    ends: dict[str, list[int]] = {"left": [], "right": [], "bottom": [], "top": []}
    for _, side in gmsh.model.getEntities(dim - 1):
        place = occ.getCenterOfMass(dim - 1, side)
        for axis, size, names in ((0, length, ("left", "right")), (1, y, ("bottom", "top"))):
            for name, end in zip(names, (0.0, size), strict=True):
                if abs(place[axis] - end) < 1e-9 * size:
                    ends[name].append(side)
    for name, sides in ends.items():
        gmsh.model.addPhysicalGroup(dim - 1, sides, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMin", h)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.generate(dim)
