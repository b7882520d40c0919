"""The whole scene for ParaView: ``scene.pvd`` lists the files of the elastic bodies and those of all else that is drawn.

What has no mesh (rigid bodies, joints, springs, obstacles) is written as triangles and lines where it was at the first
snapshot, with its displacement since, so that one "Warp by Vector" shows everything where it is.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...rotations import Array
from ..drawing.scene_graph import Drawing, Piece

TRIANGLE, LINE = 5, 3  # VTK's numbers of cells


def body_files(folder: Path, bodies: Sequence[str]) -> dict[str, Path]:
    """A file for each body, of its name, where that is no folder, no other body's file, and not that of the scene."""
    files: dict[str, Path] = {}
    taken = {"scene"}
    for body in bodies:
        stem = body.replace("/", "_")
        while stem in taken:
            stem += "_"
        taken.add(stem)
        files[body] = folder / f"{stem}.pvd"
    return files


def save_scene(drawing: Drawing, folder: Path, meshed: Mapping[str, Path]) -> Path:
    """Write what is not in the files of the ``meshed`` bodies, and ``scene.pvd`` that lists them all; rank 0."""
    others = [p for p in drawing.pieces if p.name not in meshed and len(p.triangles) + len(p.edges)]
    collection = ET.Element("Collection")
    for part, (body, file) in enumerate(meshed.items()):
        for entry in ET.parse(file).getroot().iter("DataSet"):
            entry.set("part", str(part))
            entry.set("name", body)
            collection.append(entry)

    first = len(meshed)
    pieces_folder = folder / "pieces"
    pieces_folder.mkdir(parents=True, exist_ok=True)
    for part, piece in enumerate(others):
        for k, t in enumerate(drawing.times):
            file = pieces_folder / f"{part:03d}_{k:05d}.vtu"
            _write_piece(file, piece, k)
            where = {
                "timestep": f"{t:.17g}",
                "part": str(first + part),
                "name": piece.name,
                "file": f"pieces/{file.name}",
            }
            ET.SubElement(collection, "DataSet", where)

    root = ET.Element("VTKFile", {"type": "Collection", "version": "0.1"})
    root.append(collection)
    scene = folder / "scene.pvd"
    ET.ElementTree(root).write(scene, xml_declaration=True, encoding="utf-8")
    return scene


def _write_piece(file: Path, piece: Piece, k: int) -> None:
    """One piece at one instant as an unstructured grid, in ASCII."""
    start = piece.at(0)
    now = piece.at(k)
    cells = [*piece.triangles, *piece.edges]
    kinds = [TRIANGLE] * len(piece.triangles) + [LINE] * len(piece.edges)

    root = ET.Element("VTKFile", {"type": "UnstructuredGrid", "version": "0.1", "byte_order": "LittleEndian"})
    size = {"NumberOfPoints": str(len(start)), "NumberOfCells": str(len(cells))}
    grid = ET.SubElement(ET.SubElement(root, "UnstructuredGrid"), "Piece", size)
    _array(ET.SubElement(grid, "PointData", {"Vectors": "displacement"}), "displacement", now - start)
    _array(ET.SubElement(grid, "Points"), "points", start)

    topology = ET.SubElement(grid, "Cells")
    _numbers(topology, "connectivity", np.concatenate(cells) if cells else np.zeros(0, dtype=int))
    _numbers(topology, "offsets", np.cumsum([len(c) for c in cells]))
    _numbers(topology, "types", np.array(kinds))
    ET.ElementTree(root).write(file, xml_declaration=True, encoding="utf-8")


def _array(parent: ET.Element, name: str, values: Array) -> None:
    """A field of three components."""
    about = {"type": "Float64", "Name": name, "NumberOfComponents": "3", "format": "ascii"}
    ET.SubElement(parent, "DataArray", about).text = "\n".join(f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in values)


def _numbers(parent: ET.Element, name: str, values: np.ndarray) -> None:
    about = {"type": "Int64", "Name": name, "format": "ascii"}
    ET.SubElement(parent, "DataArray", about).text = " ".join(str(int(v)) for v in values)
