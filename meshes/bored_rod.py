"""A connecting rod along x with a bore near each rounded end: surfaces "bore a", "bore b", "side" (the straight edges), "end".

2D: a sheet; 3D: the same with a thickness, and the surface "face" (front and back). ``first`` is the centre of bore a, ``length``
the distance of the bores' centres; the rounded ends have the radius height / 2, the bores height / 4.
"""

from typing import Any


def build(
    gmsh: Any,
    dim: int = 2,
    first: tuple[float, float] = (0.15, 0.0),
    length: float = 0.3,
    height: float = 0.008,
    thickness: float = 0.008,
    h: float = 0.004,
) -> None:
    """Model of the rod with cells of size h (m), 12 height / h of them around a bore; all lengths in m."""
    gmsh.model.add("connecting rod")
    occ, (x, y), r = gmsh.model.occ, first, 0.5 * height
    bar = occ.addRectangle(x, y - r, 0.0, length, height)
    eyes = [(2, occ.addDisk(x + s, y, 0.0, r, r)) for s in (0.0, length)]
    bores = [(2, occ.addDisk(x + s, y, 0.0, 0.5 * r, 0.5 * r)) for s in (0.0, length)]
    sheet, _ = occ.fuse([(2, bar)], eyes)
    solid, _ = occ.cut(sheet, bores)
    occ.healShapes()
    occ.synchronize()
    if dim == 3:
        occ.extrude(solid, 0.0, 0.0, thickness)
        occ.translate(occ.getEntities(3), 0.0, 0.0, -0.5 * thickness)
        occ.synchronize()
    gmsh.model.addPhysicalGroup(dim, [tag for _, tag in occ.getEntities(dim)], name="rod")
    named: dict[str, list[int]] = {}
    for _, tag in occ.getEntities(dim - 1):
        named.setdefault(_name(occ, dim, tag, (x, y, length, r)), []).append(tag)
    for name, tags in named.items():
        gmsh.model.addPhysicalGroup(dim - 1, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", max(round(12 * height / h), 8))
    gmsh.model.mesh.generate(dim)


def _name(occ: Any, dim: int, tag: int, size: tuple[float, float, float, float]) -> str:
    """Name of a boundary piece from its box."""
    x, y, length, r = size
    box = occ.getBoundingBox(dim - 1, tag)
    low, high = box[:3], box[3:]
    if dim == 3 and high[2] - low[2] < 1e-3 * r:
        return "face"
    if high[1] - low[1] < 1e-3 * r:
        return "side"
    for name, center in (("bore a", x), ("bore b", x + length)):
        if max(center - low[0], high[0] - center, y - low[1], high[1] - y) < 0.6 * r:
            return name
    return "end"
