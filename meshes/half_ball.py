"""The lower half of a disk (2D) or ball (3D) that touches the origin: surfaces "contact" (round) and "top" (flat),
refined at the origin.

Sizes grow from ``h`` within ``near`` of the origin to ``coarse`` far away. ``mirrored``: the upper half of a ball below.
"""

from typing import Any


def build(
    gmsh: Any,
    dim: int = 2,
    radius: float = 1.0,
    h: float = 0.01,
    near: float = 0.1,
    coarse: float = 0.15,
    mirrored: bool = False,
) -> None:
    """Model of the half with its centre at height ``radius`` (m), or -``radius``."""
    gmsh.model.add("half ball")
    occ = gmsh.model.occ
    if dim == 2:
        ball = occ.addDisk(0.0, radius, 0.0, radius, radius)
        box = occ.addRectangle(-2 * radius, radius, 0.0, 4 * radius, 2 * radius)
        origin = occ.addPoint(0.0, 0.0, 0.0)
    else:
        ball = occ.addSphere(0.0, 0.0, radius, radius)
        box = occ.addBox(-2 * radius, -2 * radius, radius, 4 * radius, 4 * radius, 2 * radius)
        origin = occ.addPoint(0.0, 0.0, 0.0)
    occ.cut([(dim, ball)], [(dim, box)])
    occ.fragment([(dim, ball)], [(0, origin)])
    if mirrored:
        occ.mirror(occ.getEntities(dim) + occ.getEntities(0), *((0, 1, 0) if dim == 2 else (0, 0, 1)), 0)
    occ.synchronize()
    (_, body), *_ = gmsh.model.getEntities(dim)
    gmsh.model.addPhysicalGroup(dim, [body], name="half ball")
    groups: dict[str, list[int]] = {"contact": [], "top": []}
    for _, tag in gmsh.model.getEntities(dim - 1):
        height = abs(occ.getCenterOfMass(dim - 1, tag)[dim - 1])
        groups["top" if height > radius * (1 - 1e-6) else "contact"].append(tag)
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(dim - 1, tags, name=name)
    field = gmsh.model.mesh.field
    length = f"Sqrt(x*x+y*y+{'z*z' if dim == 3 else '0'})"
    grow = (coarse - h) / (radius - near)
    field.add("MathEval", 1)
    field.setString(1, "F", f"{h} + {grow}*({length} - {near} + Fabs({length} - {near}))/2")
    field.setAsBackgroundMesh(1)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.generate(dim)
