"""Mesh scripts with one fault each, and what the error must say. ``build(gmsh, fault=...)`` makes one of
them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

FAULTS = {
    "none": r"no physical groups",
    "unnamed": r"\(2, 1\).*no name",
    "unnamed surface": r"\(1, \d\).*no name",
    "twice": r"no name; gmsh also drops a name that is given twice",
    "no cells": r'volume "plate".*no cells',
    "inverted": r'2 of \d+ cells of volume "plate" are inverted',
    "curved too far": r'1 of \d+ cells of volume "plate" are inverted',
    "not finite": r'volume "plate".*not finite',
    "solid forgotten": r"dimension 3 but the highest physical group has dimension 2",
    "two parts": r'volume "plate" consists of 2 separate parts .\d+ nodes about \[0.5\d*, 0.\d+, 0.0\], \d+ nodes about \[2.\d+',
    "hinged": r'volume "plate" consists of 2 separate parts, hinged on each other',
    "two kinds": r'volume "plate" has cells of several kinds: \d+ of kind \w+ \w+ and \d+ of kind',
    "few nodes": r'volume "plate" has \d+ of kind Quadrilateral 8, cells of order 2 with 8 nodes.*SecondOrderIncomplete',
    "not flat": r'volume "plate".*is not flat: z reaches from 0.00\d+ to 0.47',
    "two volumes": r"several volumes.*Choose one",
    "empty surface": r'surface "end" has no facets',
    "raises": r"ValueError: wrong radius",
}


def build(gmsh: Any, fault: str) -> None:
    """A square plate with surface "end", or a cube, with the fault."""
    model, occ = gmsh.model, gmsh.model.occ
    model.add("faulty")
    if fault == "raises":
        raise ValueError("wrong radius")
    if fault == "solid forgotten":
        occ.addBox(0, 0, 0, 1, 1, 1)
        occ.synchronize()
        faces = [t for _, t in model.getEntities(2)]
        model.addPhysicalGroup(2, faces, name="skin")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        model.mesh.generate(3)
        return
    plates = [occ.addRectangle(0, 0, 0, 1, 1)]
    if fault in ("two parts", "two volumes"):
        plates.append(occ.addRectangle(2, 0, 0, 1, 1))
    if fault in ("hinged", "two kinds"):
        more = occ.addRectangle(1, float(fault == "hinged"), 0, 1, 1)
        plates = [tag for _, tag in occ.fragment([(2, plates[0])], [(2, more)])[0]]
    if fault == "not flat":
        occ.rotate([(2, plates[0])], 0, 0, 0, 1, 0, 0, 0.5)
    if fault == "lone point":  # no fault: construction points belong to no cell
        occ.addPoint(5, 5, 0)
    occ.synchronize()
    edges = [t for _, t in model.getBoundary([(2, plates[0])], oriented=False)]
    if fault == "two volumes":
        for k, p in enumerate(plates):
            model.addPhysicalGroup(2, [p], name=f"plate {k}")
    elif fault != "none":
        model.addPhysicalGroup(2, plates, name="" if fault == "unnamed" else "plate")
    if fault != "none":
        model.addPhysicalGroup(1, edges[:1], name="end")
    if fault in ("twice", "unnamed surface"):
        model.addPhysicalGroup(1, edges[1:2], name="end" if fault == "twice" else "")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    if fault == "no cells":
        return
    if fault == "few nodes":
        model.mesh.setTransfiniteSurface(plates[0])
    if fault in ("two kinds", "few nodes"):
        model.mesh.setRecombine(2, plates[0])
    if fault == "lone point":
        model.addPhysicalGroup(0, [1], name="corner")
    model.mesh.generate(2)
    if fault == "few nodes":
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
        model.mesh.setOrder(2)
    if fault == "inverted":
        invert(model, plates[0])
    if fault == "curved too far":
        curve(model, edges[0])
    if fault == "not finite":
        tag = int(model.mesh.getElements(2, plates[0])[2][0][0])
        model.mesh.setNode(tag, [float("nan"), 0.0, 0.0], [])
    if fault == "empty surface":
        model.mesh.removeElements(1, edges[0])


def invert(model: Any, surface: int) -> None:
    """Turn two triangles over."""
    kinds, tags, nodes = model.mesh.getElements(2, surface)
    cells, corners = tags[0][:2], nodes[0].reshape(-1, 3)[:2]
    model.mesh.removeElements(2, surface, cells)
    for cell, (a, b, c) in zip(cells, corners, strict=True):
        model.mesh.addElementsByType(surface, kinds[0], [cell], [a, c, b])


def curve(model: Any, edge: int) -> None:
    """Triangles of second order, one with its middle node a fifth of a side from an end: where its side turns back."""
    model.mesh.setOrder(2)
    first, last, middle = model.mesh.getElements(1, edge)[2][0][:3]
    x, y = (np.array(model.mesh.getNode(int(tag))[0]) for tag in (first, last))
    model.mesh.setNode(int(middle), list(x + 0.2 * (y - x)), [])
