"""A rectangular sheet whose lower edge rests on two pads: surfaces "rear", "front" (pads), "floor" (upper edge), "side" (the
rest).

``pads`` are (from, to) along x on the lower edge; all lengths in m, world coordinates.
"""

from typing import Any


def build(
    gmsh: Any,
    low: tuple[float, float] = (0.0, 0.0),
    size: tuple[float, float] = (5.67, 1.5),
    pads: tuple[tuple[float, float], tuple[float, float]] = ((0.8, 1.6), (5.0, 5.5)),
    h: float = 0.3,
) -> None:
    """Model of the sheet with cells of size h (m)."""
    gmsh.model.add("loading area")
    geo, (x0, y0), (a, b) = gmsh.model.geo, low, size
    corners = [(x0, y0), *((x, y0) for pad in pads for x in pad), (x0 + a, y0), (x0 + a, y0 + b), (x0, y0 + b)]
    points = [geo.addPoint(x, y, 0.0) for x, y in corners]
    lines = [geo.addLine(p, q) for p, q in zip(points, points[1:] + points[:1], strict=True)]
    sheet = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.synchronize()
    gmsh.model.addPhysicalGroup(2, [sheet], name="sheet")
    gmsh.model.addPhysicalGroup(1, [lines[1]], name="rear")
    gmsh.model.addPhysicalGroup(1, [lines[3]], name="front")
    gmsh.model.addPhysicalGroup(1, [lines[6]], name="floor")
    gmsh.model.addPhysicalGroup(1, [lines[0], lines[2], lines[4], lines[5], lines[7]], name="side")
    gmsh.option.setNumber("Mesh.MeshSizeMin", h)
    gmsh.option.setNumber("Mesh.MeshSizeMax", h)
    gmsh.model.mesh.generate(2)
