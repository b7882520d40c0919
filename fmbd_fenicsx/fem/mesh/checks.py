"""What a meshed gmsh model must be to become a body: named groups, one solid of sound cells, facets on its boundary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any, cast

import numpy as np

from ...errors import MeshError, near
from .facet_groups import Tag, separate

HIGHEST = 3  # order of cells that DOLFINx reads from gmsh
DEGENERATE = 1e-14  # of the largest Jacobian determinant
INVERTED = 1e-9  # of that of the cell: a corner may be flat, as behind a quarter point, and not turned inside out


@dataclass(frozen=True)
class Group:
    """A physical group of gmsh."""

    dim: int
    tag: int
    name: str


@dataclass(frozen=True)
class Checked:
    """What a model is after its checks: ``volumes``, ``surfaces`` name -> tag; ``others``: group that is no surface -> why."""

    dim: int
    volumes: dict[str, int]
    surfaces: dict[str, Tag]
    label: str
    others: dict[str, str]


def check_model(model: Any, label: str, volume: str | Sequence[str] | None) -> Checked:
    """Check physical groups and cells of a meshed gmsh model; drop the groups of other bodies. Rank 0 only."""
    groups = _named_groups(model, label)
    solids = _solids(model, groups, label, volume)
    dim, name = solids[0].dim, name_of_volumes(g.name for g in solids)
    for other in groups:
        if other.dim == dim and other not in solids:
            model.removePhysicalGroups([(other.dim, other.tag)])

    entities = _entities(model, solids, label)
    _check_cells(model, dim, entities, label, name)
    around = [g for g in groups if g.dim == dim - 1]
    surfaces = _surfaces(model, around, entities, label)
    _drop_others(model, dim, entities)
    others = {g.name: _why_none(g, dim, name) for g in groups if g.dim < dim and g.name not in surfaces}
    return Checked(dim, {g.name: g.tag for g in solids}, surfaces, label, others)


def name_of_volumes(names: Iterable[str]) -> str:
    """What messages call the volumes of one body."""
    return " + ".join(names)


def _entities(model: Any, solids: list[Group], label: str) -> list[int]:
    """The geometry in some groups, each part in one of them alone: a cell is of one material."""
    owner: dict[int, str] = {}
    for g in solids:
        for e in model.getEntitiesForPhysicalGroup(g.dim, g.tag):
            if int(e) in owner:
                raise MeshError(
                    f'{label}: volumes "{owner[int(e)]}" and "{g.name}" share a part of the geometry (entity {int(e)}). '
                    "Put each part into one of them."
                )
            owner[int(e)] = g.name
    return list(owner)


def _why_none(group: Group, dim: int, name: str) -> str:
    """Why a group is no surface of the solid of a dimension and name."""
    if group.dim == dim - 1:
        return f'The group of this name does not lie on the boundary of volume "{name}".'
    kinds = ("points", "curves")[group.dim], ("curves", "faces")[dim - 2]
    return f"The group of this name holds {kinds[0]}: surfaces hold {kinds[1]}, small ones where a point or an edge is meant."


# -- physical groups ------------------------------------------------------------------------------------------------
def _named_groups(model: Any, label: str) -> list[Group]:
    """All groups; those of the highest dimensions have names of their own."""
    groups = [Group(dim, tag, model.getPhysicalName(dim, tag)) for dim, tag in model.getPhysicalGroups()]
    if not groups:
        raise MeshError(
            f"{label}: no physical groups. Name the solid and its surfaces with addPhysicalGroup(..., name=...)."
        )

    dim = max(g.dim for g in groups)
    unnamed = [(g.dim, g.tag) for g in groups if not g.name and g.dim >= dim - 1]
    if unnamed:
        raise MeshError(
            f"{label}: physical groups {unnamed} (dim, tag) have no name; gmsh also drops a name that is given "
            f"twice. Groups: {_listing(groups)}."
        )

    names = [(g.dim, g.name) for g in groups]
    twice = sorted({name for dim, name in names if names.count((dim, name)) > 1})
    if twice:
        raise MeshError(f"{label}: several physical groups are called {twice}. Give each group its own name.")
    return groups


def _listing(groups: list[Group]) -> str:
    """Groups as a message shows them."""
    return ", ".join(f'"{g.name}" (dim {g.dim})' for g in groups)


def _solids(model: Any, groups: list[Group], label: str, volume: str | Sequence[str] | None) -> list[Group]:
    """The groups of the body: those that are asked for, or the only one of the highest dimension."""
    dim = max(g.dim for g in groups)
    geometry = max((k for k, _ in model.getEntities()), default=dim)
    if dim < 2 or dim < geometry:
        raise MeshError(
            f"{label}: the geometry has dimension {geometry} but the highest physical group has dimension {dim} "
            f"({_listing(groups)}). Put the solid into a physical group, else only its surface mesh arrives."
        )

    solids = [g for g in groups if g.dim == dim]
    names = [g.name for g in solids]
    if volume is None and len(solids) > 1:
        raise MeshError(
            f"{label} holds several volumes: {names}. Choose one with volume=..., or several as one body with volume=(..., ...)."
        )
    wanted = names if volume is None else [volume] if isinstance(volume, str) else list(volume)
    for name in wanted:
        if name not in names:
            raise MeshError(f'{label}: no volume "{name}". {near(name, names)}')
    return [g for g in solids if g.name in wanted]


def _surfaces(model: Any, groups: list[Group], entities: list[int], label: str) -> dict[str, Tag]:
    """Name -> tag of the groups on the boundary of the solid; those elsewhere are removed."""
    found: dict[str, int] = {}
    if not groups:
        return {}
    dim = groups[0].dim + 1
    edges = _corners(model, dim, entities, facets=True)
    own = {abs(int(t)) for e in entities for _, t in model.getBoundary([(dim, e)], oriented=False)}

    for g in groups:
        parts = [int(e) for e in model.getEntitiesForPhysicalGroup(g.dim, g.tag)]
        if own and not own.intersection(parts):
            model.removePhysicalGroups([(g.dim, g.tag)])
            continue
        if not any(len(x) for e in parts for x in model.mesh.getElements(g.dim, e)[1]):
            raise MeshError(f'{label}: surface "{g.name}" has no facets. Mesh it, or remove the group.')
        _check_facets(set(_corners(model, g.dim, parts)), edges, f'{label}: surface "{g.name}"')
        found[g.name] = g.tag
    inside = {facet for facet, cells in edges.items() if cells > 1}
    return separate(model, dim - 1, found, inside) if found else {}


def _drop_others(model: Any, dim: int, entities: list[int]) -> None:
    """Remove the mesh of everything that is no part of the solid: nodes without cells end DOLFINx's distribution."""
    own = np.unique(np.concatenate([nodes for one in entities for nodes in model.mesh.getElements(dim, one)[2]]))
    solid = {(dim, one) for one in entities}
    others = [entity for entity in model.getEntities() if entity not in solid]
    if len(own) == len(model.mesh.getNodes()[0]):
        others = []

    for entity in sorted(others, reverse=True):
        nodes = model.mesh.getElements(*entity)[2]
        if nodes and not np.isin(np.concatenate(nodes), own).all():
            model.mesh.clear([entity])
    model.mesh.renumberNodes()


# -- cells ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Cells:
    """Cells of one kind (gmsh's number of it) in one entity: numbers, nodes (n, k), determinants (n, p) at points (n, p, 3), and
    those at the nodes, (n, k).
    """

    kind: int
    numbers: np.ndarray
    nodes: np.ndarray
    det: np.ndarray
    points: np.ndarray
    at_nodes: np.ndarray


def _cells(model: Any, dim: int, entities: list[int]) -> Iterator[Cells]:
    """The cells of entities, kind by kind."""
    for entity in entities:
        types, tags, nodes = model.mesh.getElements(dim, entity)
        for kind, numbers, cell_nodes in zip(types, tags, nodes, strict=True):
            inside, _ = model.mesh.getIntegrationPoints(kind, "Gauss2")
            points = np.append(inside, _local_nodes(model, kind))

            J, det, x = model.mesh.getJacobians(kind, points, tag=entity)

            # gmsh gives the absolute value for cells of the plane, which hides those that are inverted
            if dim == 2:
                J = np.asarray(J).reshape(-1, 9)
                det = J[:, 0] * J[:, 4] - J[:, 1] * J[:, 3]

            per, within = len(points) // 3, len(inside) // 3
            det = np.asarray(det).reshape(-1, per)
            yield Cells(
                int(kind),
                numbers,
                np.asarray(cell_nodes, dtype=np.int64).reshape(len(numbers), -1),
                det[:, :within],
                np.asarray(x).reshape(-1, per, 3)[:, :within],
                det[:, within:],
            )


def _local_nodes(model: Any, kind: int) -> np.ndarray:
    """Places of the nodes in the reference cell, (3 k,): sides that are curved too far turn a cell inside out there first."""
    _, dim, _, count, local, _ = model.mesh.getElementProperties(kind)
    found = np.zeros((count, 3))
    found[:, :dim] = np.reshape(local, (count, dim))
    return found.ravel()


def _check_cells(model: Any, dim: int, entities: list[int], label: str, name: str) -> None:
    """One kind of cells and sign of the Jacobian determinant, no zero volumes, none twice, one connected part."""
    cells = list(_cells(model, dim, entities))
    if not sum(len(c.numbers) for c in cells):
        raise MeshError(f'{label}: volume "{name}" has no cells. Call gmsh.model.mesh.generate({dim}).')
    sides = _sides(model, cells, label, name)
    if dim == 2:
        _check_plane(cells, label, name)
    _check_signs(cells, label, name)
    for c in cells:
        twice = len(c.nodes) - len(np.unique(np.sort(c.nodes, axis=1), axis=0))
        if twice:
            raise MeshError(
                f'{label}: {twice} cells of volume "{name}" are there twice. Remove the duplicates, or mesh anew.'
            )
    _check_connected(model, np.concatenate([c.nodes for c in cells]), sides, f'{label}: volume "{name}"')


def _sides(model: Any, cells: list[Cells], label: str, name: str) -> np.ndarray:
    """Corners of the facets of a cell, (facets, corners): cells of a body are of one kind."""
    counts: dict[int, int] = {}
    for c in cells:
        counts[c.kind] = counts.get(c.kind, 0) + len(c.numbers)
    kinds = {kind: model.mesh.getElementProperties(kind) for kind in counts}
    listing = " and ".join(f"{count} of kind {kinds[kind][0]}" for kind, count in counts.items())
    if len(counts) > 1:
        raise MeshError(
            f'{label}: volume "{name}" has cells of several kinds: {listing}. A body has one kind: '
            "let gmsh recombine all of its surfaces or none, or give each kind its own volume and tie the bodies."
        )

    _, dim, order, nodes, _, corners = kinds[cells[0].kind]
    if (dim, corners) not in FACETS:
        raise MeshError(
            f'{label}: volume "{name}" has cells that a body cannot have: {listing}. Take triangles or quadrilaterals, '
            "in space tetrahedra or hexahedra."
        )
    if nodes != (comb(order + dim, dim) if corners == dim + 1 else (order + 1) ** dim) or order > HIGHEST:
        raise MeshError(
            f'{label}: volume "{name}" has {listing}, cells of order {order} with {nodes} nodes. Cells have all nodes of their '
            f'order, at most {HIGHEST}: mesh with gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 0), or take order 1.'
        )
    return np.array(FACETS[dim, corners])


FLAT = 1e-9  # of the size of a plane body: how far its points may leave their plane


def _check_plane(cells: list[Cells], label: str, name: str) -> None:
    """Cells of a plane body lie in one plane z = const: gmsh's z is dropped, so others would be shortened."""
    x = np.concatenate([c.points.reshape(-1, 3) for c in cells])
    low, high = x.min(axis=0), x.max(axis=0)
    if high[2] - low[2] > FLAT * (high - low)[:2].max():
        raise MeshError(
            f'{label}: volume "{name}" has plane cells and is not flat: z reaches from {low[2]:g} to {high[2]:g}. '
            "A body in the plane lies in x and y; a shell in space has to be meshed as a solid."
        )


def _check_signs(cells: list[Cells], label: str, name: str) -> None:
    """All cells have the orientation that most have, and a volume."""
    bad, first, orientation = 0, "", 0.0
    for c in cells:
        if not np.isfinite(c.det).all():
            raise MeshError(f'{label}: volume "{name}" has cells with coordinates that are not finite.')

        # a volume may be meshed inside out as a whole: what most cells have counts as right
        orientation = orientation or float(np.sign(np.median(c.det)))

        # a cell is as bad as its worst quadrature point
        smallest = (c.det * orientation).min(axis=1)
        at_worst = (c.at_nodes * orientation).min(axis=1)
        turned = at_worst < -INVERTED * np.abs(c.at_nodes).max(axis=1)
        wrong = np.flatnonzero(turned | (smallest <= DEGENERATE * np.abs(c.det).max()))
        if wrong.size and not first:
            at = c.points[wrong[0]].mean(0).round(6).tolist()
            first = f"cell {int(c.numbers[wrong[0]])} at {at}"
        bad += wrong.size

    if bad:
        number = sum(len(c.numbers) for c in cells)
        raise MeshError(
            f'{label}: {bad} of {number} cells of volume "{name}" are inverted or degenerate (first: {first}). '
            "Remesh, or check the orientation of the geometry."
        )


FACETS = {  # corners of the facets of a cell, by dimension and number of corners, in gmsh's order
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    (3, 8): ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}


def _corners(model: Any, dim: int, entities: list[int], facets: bool = False) -> Counter[tuple[int, ...]]:
    """Corner nodes, sorted, of all elements of entities, or of their facets, with how often each is there; none of shapes
    that are not known here.
    """
    out: Counter[tuple[int, ...]] = Counter()
    for entity in entities:
        types, _, nodes = model.mesh.getElements(dim, entity)
        for kind, numbers in zip(types, nodes, strict=True):
            _, _, _, count, _, corners = model.mesh.getElementProperties(kind)
            cells = np.asarray(numbers, dtype=np.int64).reshape(-1, count)[:, :corners]
            parts = FACETS.get((dim, corners), ()) if facets else (tuple(range(corners)),)
            for part in parts:
                found = cast("list[list[int]]", np.sort(cells[:, list(part)], axis=1).tolist())
                out.update(tuple(nodes) for nodes in found)
    return out


def _check_facets(facets: set[tuple[int, ...]], edges: Counter[tuple[int, ...]], what: str) -> None:
    """The facets of a surface are facets of the solid's cells: others carry no field."""
    lost = facets - edges.keys() if edges else set()
    if lost:
        raise MeshError(
            f"{what}: {len(lost)} of {len(facets)} facets belong to no cell of the solid (first: nodes {list(min(lost))}). "
            "Make the surface of the solid's own boundary, and mesh both together."
        )


def _check_connected(model: Any, cells: np.ndarray, sides: np.ndarray, what: str) -> None:
    """A body is one piece: cells joined through facets. Parts that meet in a node, or in an edge in space, are hinged there."""
    import scipy.sparse as sp
    from scipy.sparse.csgraph import connected_components

    facets = np.sort(cells[:, sides].reshape(-1, sides.shape[1]), axis=1)
    _, facet = np.unique(facets, axis=0, return_inverse=True)
    cell = np.repeat(np.arange(len(cells)), len(sides))
    links = sp.csr_matrix((np.ones(len(cell)), (cell, facet.ravel())))
    count, part = connected_components(links @ links.T, directed=False)
    if count == 1:
        return

    tags, x, _ = model.mesh.getNodes()
    place = np.zeros((int(tags.max()) + 1, 3))
    place[tags] = np.asarray(x).reshape(-1, 3)
    found = [np.unique(cells[part == p]) for p in range(count)]
    listing = ", ".join(f"{len(n)} nodes about {place[n].mean(0).round(4).tolist()}" for n in found[:8])
    # nodes that several parts have
    hinged = sum(map(len, found)) > len(np.unique(cells))
    meet = ", hinged on each other at single nodes or edges" if hinged else ""
    raise MeshError(
        f"{what} consists of {count} separate parts{meet} ({listing}). "
        "Fuse them in gmsh, or give each its own physical group and body."
    )
