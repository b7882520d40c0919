"""Meshes from other programs: CAD parts (STEP, IGES, BREP) meshed by gmsh, and finished meshes of any format that meshio reads.

Rank 0 reads, builds a gmsh model with named groups and checks it as :func:`fmbd_fenicsx.read_gmsh` does; then the mesh is
distributed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...checks import instance, number
from ...errors import InputError, MeshError, near
from ...rotations import Array
from .checks import check_model
from .mesh import Mesh, distributed, halve_edges, require_file

Where = Callable[[Array], Any]
"""Which points belong to a surface: x (3, n) in m -> n truth values."""

CELLS = {"triangle": 2, "triangle6": 2, "tetra": 3, "tetra10": 3, "quad": 2, "hexahedron": 3}
CORNERS = {"triangle": 3, "triangle6": 3, "tetra": 4, "tetra10": 4, "quad": 4, "hexahedron": 8, "line": 2, "line3": 2}
GMSH_KIND = {(1, 2): 1, (2, 3): 2, (2, 4): 3, (3, 4): 4, (3, 8): 5}  # by dimension and corners
SIDES = {3: ((0, 1), (1, 2), (2, 0)), 4: ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))}


def read_cad(
    source: str | Path,
    *,
    h: float,
    surfaces: Mapping[str, Where | Sequence[float]],
    scale: float = 1.0,
    volume: str = "part",
    comm: Any = None,
) -> Mesh:
    """Mesh a part of a CAD file (.step, .stp, .iges, .brep) with tetrahedra and name its surfaces; collective.

        arm = fmbd.read_cad("arm.step", h=0.01, scale=1e-3, surfaces={"bore": (0, 0, 0.02), "end": lambda x: x[0] > 0.399})

    Args:
        source: path of the file.
        h: largest cell size, m.
        surfaces: name -> a point (m) on or next to a face (within h), which takes that face; or a function of points x (3, n)
            that is true on all of the wanted faces.
        scale: m for a unit of the file: 1e-3 for mm. (gmsh converts STEP files that state their unit to mm.)
        volume: what messages call the part.

    Raises:
        MeshError: no file, no solid or several, a surface that no face belongs to; it lists the faces.
    """
    path = Path(instance("read_cad: source", source, (str, Path)))
    number("read_cad: h", h, above=0.0, unit="m")
    number("read_cad: scale", scale, above=0.0)

    def load(gmsh: Any, halvings: int) -> Any:
        require_file(path)
        gmsh.option.setNumber("Geometry.OCCScaling", scale)
        try:
            gmsh.model.occ.importShapes(str(path))
        except Exception as error:
            raise MeshError(f"{path} is no CAD file that gmsh reads: {error}") from None
        gmsh.model.occ.synchronize()

        solids = gmsh.model.getEntities(3)
        if len(solids) != 1:
            raise MeshError(f"{path} holds {len(solids)} solids; a body is one. Fuse them, or export the part alone.")

        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        gmsh.model.mesh.generate(3)
        halve_edges(gmsh, halvings)
        gmsh.model.addPhysicalGroup(3, [solids[0][1]], name=volume)
        for name, where in surfaces.items():
            gmsh.model.addPhysicalGroup(2, _faces(gmsh.model, name, where, (path, h)), name=name)
        return check_model(gmsh.model, str(path), volume)

    return distributed(load, str(path), comm)


def _faces(model: Any, name: str, where: Any, part: tuple[Path, float]) -> list[int]:
    """Faces of a CAD part, its file and cell size, that a point or a function takes."""
    path, h = part
    off = ""
    faces = [tag for _, tag in model.getEntities(2)]
    middles = {tag: model.occ.getCenterOfMass(2, tag) for tag in faces}
    # a function takes faces whose nodes it all takes, a point the nearest one
    if callable(where):
        nodes = {tag: np.asarray(model.mesh.getNodes(2, tag, True)[1]).reshape(-1, 3).T for tag in faces}
        found = [tag for tag, x in nodes.items() if np.all(where(x))]
    else:
        point = np.asarray(where, dtype=float)
        away = [_distance(point, _triangles(model, tag)) for tag in faces]
        nearest = float(np.min(away))
        found = [faces[int(np.argmin(away))]] if nearest <= h else []
        off = "" if found else f": its point {tuple(map(float, point))} is {nearest:.4g} m from the nearest one"

    if not found:
        size = float(np.abs(list(middles.values())).max()) or 1.0
        shown = [np.where(np.abs(c) < 1e-9 * size, 0.0, c) for c in list(middles.values())[:12]]

        known = "; ".join(f"about ({x:.4g}, {y:.4g}, {z:.4g})" for x, y, z in shown)
        raise MeshError(f'{path}: no face belongs to surface "{name}"{off}. It has {len(faces)} faces, in m: {known}.')
    return found


def _triangles(model: Any, face: int) -> np.ndarray:
    """Corners of the triangles of a face, (n, 3, 3): gmsh's own closest point is that of the whole plane or cylinder."""
    numbers, places, _ = model.mesh.getNodes(2, face, True)
    row = {int(tag): k for k, tag in enumerate(numbers)}
    corners = [row[int(tag)] for tag in model.mesh.getElementsByType(2, face)[1]]

    return np.asarray(np.asarray(places).reshape(-1, 3)[corners].reshape(-1, 3, 3))


def _distance(point: np.ndarray, triangles: np.ndarray) -> float:
    """Distance (m) from a point to the nearest of some triangles."""
    a = triangles[:, 0]
    e = triangles[:, 1] - triangles[:, 0]
    f = triangles[:, 2] - triangles[:, 0]

    # where the foot of the perpendicular lies inside
    ee, ef, ff = ((x * y).sum(1) for x, y in ((e, e), (e, f), (f, f)))
    pe = ((point - a) * e).sum(1)
    pf = ((point - a) * f).sum(1)
    area = ee * ff - ef * ef
    s = (ff * pe - ef * pf) / area
    t = (ee * pf - ef * pe) / area
    inside = (s >= 0) & (t >= 0) & (s + t <= 1)
    feet = (a + s[:, None] * e + t[:, None] * f)[inside]

    # else the nearest point of a side
    starts = triangles.reshape(-1, 3)
    sides = np.roll(triangles, -1, axis=1).reshape(-1, 3) - starts
    share = np.clip(((point - starts) * sides).sum(1) / (sides * sides).sum(1), 0.0, 1.0)
    feet = np.concatenate((feet, starts + share[:, None] * sides))
    return float(np.linalg.norm(feet - point, axis=1).min())


def read_mesh(
    source: str | Path,
    *,
    surfaces: Mapping[str, Where] | None = None,
    volume: str | None = None,
    scale: float = 1.0,
    comm: Any = None,
) -> Mesh:
    """Read one body from a finished mesh in a format that meshio knows: .inp (Abaqus), .bdf (Nastran), .med, .vtu; collective.

    Named sets of nodes, facets or cells become surfaces and volumes by their own names (Nastran properties are called
    "property 3"). A set of nodes is a surface where it holds all nodes of boundary facets. Cells of second order keep their
    corners.

    Args:
        source: path of the file.
        surfaces: more surfaces: name -> function of points x (3, n), in m, true at all corners of the facets that are wanted.
        volume: set of cells that is the body; None: all cells.
        scale: m for a unit of the file: 1e-3 for mm.

    Raises:
        InputError: no meshio.
        MeshError: no file, no cells, no named surfaces (lists what there is), or a mesh that is refused by its cells.
    """
    path = Path(instance("read_mesh: source", source, (str, Path)))
    number("read_mesh: scale", scale, above=0.0)

    def load(gmsh: Any, halvings: int) -> Any:
        require_file(path)
        found = _read(path)
        points, dim, cells = _body(path, found, volume, scale)
        facets = _boundary(cells)
        named = _named(found, points, facets, dict(surfaces or {}))
        if not named:
            raise MeshError(
                f"{path}: no named set makes a surface. There is: {_content(found)}. Name one by surfaces={{...}}."
            )
        _model(gmsh, (points, dim, cells), named, volume or "body")
        halve_edges(gmsh, halvings)
        return check_model(gmsh.model, str(path), volume or "body")

    return distributed(load, str(path), comm)


def _read(path: Path) -> Any:
    try:
        import meshio
    except ImportError as error:
        raise InputError("read_mesh needs meshio: ./with-dolfinx pip install meshio.") from error
    try:
        return meshio.read(path)
    except (Exception, SystemExit) as error:  # meshio ends the program where it knows no format
        raise MeshError(f"{path} cannot be read by meshio: {error}") from None


def _sets(found: Any) -> dict[str, dict[int, np.ndarray]]:
    """Named sets of cells: name -> block -> numbers within the block; properties of Nastran by their numbers."""
    out: dict[str, dict[int, np.ndarray]] = {}
    for name, blocks in found.cell_sets.items():
        out[name] = {k: np.asarray(b, dtype=int) for k, b in enumerate(blocks) if b is not None and len(b)}
    # Nastran's cells know the number of their property
    for k, refs in enumerate(found.cell_data.get("nastran:ref", [])):
        for ref in np.unique(refs):
            out.setdefault(f"property {ref}", {})[k] = np.flatnonzero(np.asarray(refs) == ref)
    return out


def _content(found: Any) -> str:
    """What a mesh file holds, in words."""
    cells = [f"{len(block.data)} cells of kind {block.type}" for block in found.cells]
    sets = [f'"{name}" ({sum(len(x) for x in blocks.values())} cells)' for name, blocks in _sets(found).items()]
    nodes = [f'"{name}" ({len(x)} nodes)' for name, x in found.point_sets.items()]

    return ", ".join(cells) + "; named sets: " + (", ".join(sets + nodes) or "none")


def _body(path: Path, found: Any, volume: str | None, scale: float) -> tuple[Array, int, np.ndarray]:
    """Points (n, 3) in m, dimension, and the corners of the body's cells."""
    solid = [k for k, block in enumerate(found.cells) if block.type in CELLS]
    if not solid:
        raise MeshError(f"{path}: no triangles or tetrahedra. There is: {_content(found)}.")

    dim = max(CELLS[found.cells[k].type] for k in solid)
    chosen: dict[int, Any] = {k: slice(None) for k in solid if CELLS[found.cells[k].type] == dim}

    if volume is not None:
        sets = _sets(found)
        if volume not in sets:
            raise MeshError(f'{path}: no set of cells "{volume}". {near(volume, sets)}')
        chosen = {k: sets[volume][k] for k in chosen if k in sets[volume]}

    kinds = {CORNERS[found.cells[k].type] for k in chosen}
    if kinds not in ({3}, {4}) or (dim == 2 and kinds != {3}):
        raise MeshError(f"{path}: the body must be of triangles or tetrahedra alone. There is: {_content(found)}.")
    count = kinds.pop()
    # corners come first, nodes inside edges after them
    cells = np.concatenate([np.asarray(found.cells[k].data)[rows, :count] for k, rows in chosen.items()])
    points = np.zeros((len(found.points), 3))
    points[:, : found.points.shape[1]] = scale * np.asarray(found.points, dtype=float)
    return points, dim, cells


def _boundary(cells: np.ndarray) -> np.ndarray:
    """Facets that belong to one cell, by sorted corners."""
    sides = np.sort(np.concatenate([cells[:, list(side)] for side in SIDES[cells.shape[1]]]), axis=1)
    unique, count = np.unique(sides, axis=0, return_counts=True)

    return np.asarray(unique[count == 1])


def _named(found: Any, points: Array, facets: np.ndarray, more: Mapping[str, Where]) -> dict[str, np.ndarray]:
    """Surfaces: name -> their facets, of sets of nodes, of sets of facets, and of functions; those without facets left out."""
    count = facets.shape[1]

    surfaces = {}
    for name, nodes in found.point_sets.items():
        surfaces[name] = facets[np.isin(facets, nodes).all(axis=1)]

    # sets of cells: only those of facets count, as corners without the nodes inside edges
    for name, blocks in _sets(found).items():
        rows = [
            np.asarray(found.cells[k].data)[numbers, :count]
            for k, numbers in blocks.items()
            if CORNERS.get(found.cells[k].type) == count and CELLS.get(found.cells[k].type, 1) == count - 1
        ]
        if rows:
            wanted = {tuple(row) for row in np.sort(np.concatenate(rows), axis=1)}
            surfaces[name] = facets[[tuple(row) in wanted for row in facets]]

    for name, where in more.items():
        inside = np.asarray(where(points.T), dtype=bool)
        surfaces[name] = facets[inside[facets].all(axis=1)]
        if not len(surfaces[name]):
            raise MeshError(f'Surface "{name}": its function is true at no facet of the boundary.')

    return {name: rows for name, rows in surfaces.items() if len(rows)}


def _model(gmsh: Any, body: tuple[Array, int, np.ndarray], named: Mapping[str, np.ndarray], volume: str) -> None:
    """A gmsh model of discrete entities with named groups."""
    # gmsh counts from one
    points, dim, cells = body
    used = np.unique(cells)
    gmsh.model.add("mesh")
    gmsh.model.addDiscreteEntity(dim, 1)
    gmsh.model.mesh.addNodes(dim, 1, used + 1, points[used].ravel())
    gmsh.model.mesh.addElementsByType(1, GMSH_KIND[dim, cells.shape[1]], [], (_turned(points, cells) + 1).ravel())
    gmsh.model.addPhysicalGroup(dim, [1], name=volume)

    for k, (name, facets) in enumerate(named.items()):
        gmsh.model.addDiscreteEntity(dim - 1, k + 1)
        gmsh.model.mesh.addElementsByType(k + 1, GMSH_KIND[dim - 1, dim], [], (facets + 1).ravel())
        gmsh.model.addPhysicalGroup(dim - 1, [k + 1], name=name)


def _turned(points: Array, cells: np.ndarray) -> np.ndarray:
    """Cells all of one orientation, as programs differ in it."""
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    volume = np.linalg.det(edges) if cells.shape[1] == 4 else np.cross(edges[:, 0], edges[:, 1])[:, 2]
    out = cells.copy()
    out[volume < 0, :2] = out[volume < 0, 1::-1]

    return out
