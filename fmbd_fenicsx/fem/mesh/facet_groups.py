"""Surfaces as tags of facets. A facet of gmsh may be in several groups, one of DOLFINx has one tag: groups that share facets
are cut into parts that share none, and a surface is one part or several.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...rotations import Array

Tag = int | tuple[int, ...]  # of a surface: what UFL's measures take


def separate(model: Any, dim: int, groups: dict[str, int], inside: set[tuple[int, ...]]) -> dict[str, Tag]:
    """Name -> tag of the surfaces that groups (name -> tag) of facets of a dimension make; rank 0 only.

    Facets ``inside`` the body, by their sorted corners, belong to no surface; groups of nothing else are left out.
    """
    rows = [_facets(model, dim, tag) for tag in groups.values()]
    corners, nodes = (np.concatenate(x) for x in zip(*rows, strict=True))
    owner = np.repeat(np.arange(len(rows)), [len(c) for c, _ in rows])

    facets, first, number = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    member = np.zeros((len(facets), len(rows)), dtype=bool)
    member[number.ravel(), owner] = True
    member[[tuple(f) in inside for f in facets.tolist()]] = False
    once = len(facets) == len(corners)
    if once and (member.sum(axis=1) == 1).all():
        return dict(groups)

    # cut: facets that are in the same groups are one part
    entities = {int(e) for tag in groups.values() for e in model.getEntitiesForPhysicalGroup(dim, tag)}
    kind = next(int(k) for e in entities for k in model.mesh.getElementTypes(dim, e))
    model.removePhysicalGroups([(dim, tag) for tag in groups.values()])
    for e in entities:
        model.mesh.removeElements(dim, e)
    patterns, part = np.unique(member, axis=0, return_inverse=True)
    tags: list[list[int]] = [[] for _ in rows]

    for k, pattern in enumerate(patterns):
        if pattern.any():
            entity = model.addDiscreteEntity(dim)
            model.mesh.addElementsByType(entity, kind, [], nodes[first[part.ravel() == k]].ravel())
            tag = model.addPhysicalGroup(dim, [entity])
            for group in np.flatnonzero(pattern):
                tags[group].append(int(tag))
    return {name: t[0] if len(t) == 1 else tuple(t) for name, t in zip(groups, tags, strict=True) if t}


def _facets(model: Any, dim: int, tag: int) -> tuple[Array, Array]:
    """Sorted corners (n, corners) and all nodes (n, k) of the facets of a group."""
    found = []
    for entity in model.getEntitiesForPhysicalGroup(dim, tag):
        types, _, nodes = model.mesh.getElements(dim, entity)
        for kind, numbers in zip(types, nodes, strict=True):
            _, _, _, count, _, corners = model.mesh.getElementProperties(kind)
            found.append((np.asarray(numbers).reshape(-1, count), corners))
    every = np.concatenate([x for x, _ in found])
    return np.sort(every[:, : found[0][1]], axis=1), every
