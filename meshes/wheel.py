"""A disk with a round hub hole: surfaces "hub" and "tread" (an arc of the rim that may touch the ground), refined along it.

The tread runs from angle ``start`` to ``end`` (rad, from the x axis); cells of size ``h`` within ``depth`` of it, growing to
``coarse``.
"""

import math
from typing import Any


def build(
    gmsh: Any,
    radius: float = 1.0,
    hub: float = 0.3,
    start: float = -1.8,
    end: float = -1.2,
    h: float = 0.01,
    depth: float = 0.1,
    coarse: float = 0.15,
) -> None:
    """Model of the disk about the origin, lengths in m."""
    gmsh.model.add("wheel")
    occ = gmsh.model.occ
    full = 2 * math.pi
    tread = occ.addCircle(0.0, 0.0, 0.0, radius, angle1=start, angle2=end)
    rest = occ.addCircle(0.0, 0.0, 0.0, radius, angle1=end, angle2=start + full)
    hole = occ.addCircle(0.0, 0.0, 0.0, hub)
    occ.fragment([(1, tread)], [(1, rest)])
    rim = occ.addCurveLoop([tag for _, tag in occ.getEntities(1) if tag != hole])
    wheel = occ.addPlaneSurface([rim, occ.addCurveLoop([hole])])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [wheel], name="wheel")
    groups: dict[str, list[int]] = {"hub": [], "tread": []}
    for _, tag in gmsh.model.getEntities(1):
        low, high = gmsh.model.getParametrizationBounds(1, tag)
        x, y, _ = gmsh.model.getValue(1, tag, [0.5 * (low[0] + high[0])])
        if math.hypot(x, y) < 0.5 * (hub + radius):
            groups["hub"].append(tag)
        elif (math.atan2(y, x) - start) % full < end - start:
            groups["tread"].append(tag)
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(1, tags, name=name)
    field = gmsh.model.mesh.field
    field.add("Distance", 1)
    field.setNumbers(1, "CurvesList", groups["tread"])
    field.setNumber(1, "Sampling", 1000)
    field.add("MathEval", 2)
    field.setString(2, "F", f"{h} + {(coarse - h) / (radius - depth)}*(F1 - {depth} + Fabs(F1 - {depth}))/2")
    field.setAsBackgroundMesh(2)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{option}", 0)
    gmsh.model.mesh.generate(2)
