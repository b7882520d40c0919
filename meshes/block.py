"""A rectangle or box with its faces as surfaces, cut into a regular grid of simplices (or of quadrilaterals).

Surfaces "left", "right" (x), "bottom", "top" (y), and in space "back", "front" (z). ``cells`` is the number of cells
along x; the others follow from the lengths unless ``counts`` gives them all.
"""

from typing import Any

NAMES = ("left", "right", "bottom", "top", "back", "front")


def build(
    gmsh: Any,
    size: tuple[float, ...] = (1.0, 1.0),
    cells: int = 4,
    counts: tuple[int, ...] | None = None,
    origin: tuple[float, ...] = (0.0, 0.0, 0.0),
    quads: bool = False,
) -> None:
    """Model of a block with edges ``size`` (m) from ``origin`` (m); ``quads``: quadrilaterals or
    hexahedra.
    """
    gmsh.model.add("block")
    occ, dim = gmsh.model.occ, len(size)
    o = (*origin, 0.0, 0.0)[:3]
    body = occ.addRectangle(*o, *size) if dim == 2 else occ.addBox(*o, *size)
    occ.synchronize()
    n = counts or tuple(max(1, round(cells * s / size[0])) for s in size)
    for _, line in gmsh.model.getEntities(1):
        low, high = gmsh.model.getBoundingBox(1, line)[:3], gmsh.model.getBoundingBox(1, line)[3:]
        axis = max(range(3), key=lambda k: high[k] - low[k])
        gmsh.model.mesh.setTransfiniteCurve(line, n[axis] + 1)
    for _, face in gmsh.model.getEntities(2):
        gmsh.model.mesh.setTransfiniteSurface(face)
        if quads:
            gmsh.model.mesh.setRecombine(2, face)
    if dim == 3:
        gmsh.model.mesh.setTransfiniteVolume(body)
    gmsh.model.addPhysicalGroup(dim, [body], name="block")
    for _, tag in gmsh.model.getEntities(dim - 1):
        low, high = gmsh.model.getBoundingBox(dim - 1, tag)[:3], gmsh.model.getBoundingBox(dim - 1, tag)[3:]
        axis = min(range(dim), key=lambda k: high[k] - low[k])
        far = 0.5 * (low[axis] + high[axis]) > o[axis] + 0.5 * size[axis]
        gmsh.model.addPhysicalGroup(dim - 1, [tag], name=NAMES[2 * axis + far])
    gmsh.model.mesh.generate(dim)
