"""Checked reading of gmsh meshes: named volumes and surfaces, one clear error on all ranks when something is wrong.

A mesh script is a Python file with a function ``build(gmsh, **parameters)`` that makes a model with named physical groups;
a ``.msh`` file (format 2 or 4) works as well. Everything is checked on rank 0 and the outcome is sent to all ranks before
the mesh is distributed.
"""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from . import dolfinx_compat as compat
from .checks import instance, number, vector, word
from .errors import InputError, MeshError, near
from .log import install_hooks, together
from .rotations import motions

SMALLEST = 1e-12  # area of a surface over extent^(d - 1)


@dataclass(frozen=True)
class Recipe:
    """How a mesh was made by a script, and where it was placed."""

    source: Path
    volume: str | None
    comm: Any
    parameters: dict[str, Any]
    placed: tuple[tuple[Any, Any], ...] = ()

    def halved(self, label: str) -> Mesh:
        """The mesh of half the cell size; collective."""
        p = dict(self.parameters)
        if "h" in p:
            p["h"] = 0.5 * p["h"]
        elif p.get("counts") is not None:
            p["counts"] = tuple(2 * n for n in p["counts"])
        elif "cells" in p:
            p["cells"] = 2 * p["cells"]
        else:
            raise MeshError(f"{label} cannot be refined: give its script the cell size, read_gmsh(..., h=0.1).")
        mesh = read_gmsh(self.source, volume=self.volume, comm=self.comm, **p)
        for position, rotation in self.placed:
            mesh = mesh.placed(position, rotation)
        return mesh


@dataclass(frozen=True, eq=False)
class Mesh:
    """A distributed mesh of one body with named surfaces.

    Attributes: ``dolfinx`` the mesh, ``facet_tags`` its MeshTags, ``surfaces`` name -> tag, ``volume`` name of the solid group,
    ``label`` what messages call it, ``recipe`` how it was made, None for a finished mesh.
    """

    dolfinx: Any
    facet_tags: Any
    surfaces: dict[str, int]
    volume: str
    label: str
    recipe: Recipe | None = None

    def __repr__(self) -> str:
        cells = self.dolfinx.topology.index_map(self.dim).size_global
        names = ", ".join(f'"{name}"' for name in self.surface_names)
        return (
            f'<Mesh of {self.label}: {cells} cells in {self.dim}D, volume "{self.volume}", surfaces {names or "none"}>'
        )

    def refined(self) -> Mesh:
        """The mesh of half the cell size, by the same script at the same place; collective.

        The script must take the cell size ``h``, or the numbers of ``cells`` or ``counts``, and must have been given it.

        Raises:
            MeshError: the mesh comes from a file, or its script was given no cell size.
        """
        if self.recipe is None:
            raise MeshError(
                f"{self.label} cannot be refined: it is a finished mesh. Read it from a script with a cell size h."
            )
        return self.recipe.halved(self.label)

    @property
    def dim(self) -> int:
        """Space dimension, equal to the cells' dimension."""
        return int(self.dolfinx.geometry.dim)

    @property
    def surface_names(self) -> list[str]:
        """Names of the surfaces, sorted."""
        return sorted(self.surfaces)

    def surface_tag(self, name: str) -> int:
        """Tag of a named surface."""
        if name not in self.surfaces:
            raise MeshError(f'No surface "{name}" in {self.label}. {near(name, self.surfaces)}')
        return self.surfaces[name]

    @cached_property
    def extent(self) -> float:
        """Longest edge of the box around the mesh, m; collective."""
        x, inf = self.dolfinx.geometry.x, np.full(3, np.inf)
        boxes = self.dolfinx.comm.allgather((x.min(0), x.max(0)) if len(x) else (inf, -inf))
        return float((np.max([b[1] for b in boxes], axis=0) - np.min([b[0] for b in boxes], axis=0)).max())

    def placed(self, position: Any = None, rotation: Any = None) -> Mesh:
        """A copy whose point x lies at ``position`` + R x: one mesh for several equal bodies.

        Args:
            position: of the mesh's origin, m, (d,); None: where it is.
            rotation: an angle (rad) in the plane, a matrix (3, 3) or quaternion (scalar last) in space; None: unturned.
        """
        from dolfinx.mesh import meshtags

        motion, d = motions(self.dim), self.dim
        try:
            start = np.zeros(d) if position is None else vector(f"{self.label}: position", position, size=d)
        except InputError as error:
            raise MeshError(str(error)) from None
        pose = motion.pose(start, rotation)
        x = pose[:d] + self.dolfinx.geometry.x[:, :d] @ motion.matrix(pose).T
        mesh, tags = compat.moved(self.dolfinx, x), self.facet_tags
        if tags is not None:
            tags = meshtags(mesh, tags.dim, tags.indices, tags.values)
        recipe = self.recipe
        if recipe is not None:
            recipe = replace(recipe, placed=(*recipe.placed, (position, rotation)))
        return replace(self, dolfinx=mesh, facet_tags=tags, recipe=recipe)

    def check_area(self, name: str, area: float) -> None:
        """Refuse a surface without area, or with so little that a joint on it cannot carry a finite force; collective."""
        least = SMALLEST * self.extent ** (self.dim - 1)
        if not area > least:
            raise MeshError(
                f'Surface "{name}" of {self.label} has area {area:.3g} m^{self.dim - 1}, not more than {least:.3g}: '
                + ("it has no facets on the boundary." if area == 0 else "too small to carry a joint, a tie or a load.")
            )


def read_gmsh(source: str | Path, *, volume: str | None = None, comm: Any = None, **parameters: Any) -> Mesh:
    """Read one body from a mesh script (``.py``) or a ``.msh`` file; collective over ``comm`` (default COMM_WORLD).

    Args:
        source: path of the script or file.
        volume: name of the solid's physical group; needed when the file holds several.
        parameters: passed to the script's ``build`` (say ``h=0.05``, ``dim=2``).

    Raises:
        MeshError: file missing, no or duplicated or unnamed groups, only surfaces meshed, cells inverted or degenerate.
    """
    install_hooks()
    compat.check_versions()
    instance("read_gmsh: source", source, (str, Path))
    if volume is not None:
        word("read_gmsh: volume", volume)
    path = Path(source)
    made = distributed(lambda gmsh: _load(gmsh, path, parameters, volume), str(path), comm)
    if path.suffix != ".py":
        return made
    return replace(made, recipe=Recipe(path, volume, made.dolfinx.comm, parameters))


def distributed(load: Callable[[Any], tuple[int, str, dict[str, int], str]], label: str, comm: Any = None) -> Mesh:
    """The mesh that ``load``(gmsh) makes on rank 0 in an open gmsh session, checked there; collective over ``comm``.

    ``load`` returns what :func:`check_model` does. An error of rank 0 is raised on all ranks, under the ``label``.
    """
    import gmsh
    from mpi4py import MPI

    comm = MPI.COMM_WORLD if comm is None else instance("read_gmsh: comm", comm, MPI.Comm)
    error, found = None, None
    if comm.rank == 0:
        try:
            gmsh.initialize(interruptible=False)
            gmsh.option.setNumber("General.Terminal", 0)
            found = load(gmsh)
        except Exception as exc:  # sent to all ranks
            error = exc if isinstance(exc, InputError) else MeshError(f"{label}: {type(exc).__name__}: {exc}")
    try:
        together(comm, error)
        dim, name, groups, label = comm.bcast(found)
        if not gmsh.isInitialized():
            gmsh.initialize(interruptible=False)
        msh, _, facets = compat.model_to_mesh(gmsh.model, comm, dim)
    finally:
        if gmsh.isInitialized():
            gmsh.finalize()
    msh.topology.create_connectivity(dim - 1, dim)
    return Mesh(msh, facets, groups, name, label)


def require_file(path: Path) -> None:
    """Refuse a path at which no file is."""
    if not path.is_file():
        raise MeshError(f"Mesh file {path} does not exist (looked in {Path.cwd()}).")


def _load(
    gmsh: Any, path: Path, parameters: dict[str, Any], volume: str | None
) -> tuple[int, str, dict[str, int], str]:
    """Rank 0: build or open the model, check it, keep one body; returns dimension, volume name, surface tags, label."""
    require_file(path)

    if path.suffix == ".py":
        spec = importlib.util.spec_from_file_location(f"fmbd_mesh_{path.stem}", path)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        if not hasattr(module, "build"):
            raise MeshError(f"Mesh script {path} has no function build(gmsh, **parameters).")
        _check_parameters(str(path), module.build, parameters)
        module.build(gmsh, **parameters)
    else:
        if parameters:
            raise MeshError(f"{path} is a finished mesh: parameters {sorted(parameters)} have no meaning for it.")
        gmsh.open(str(path))

    return check_model(gmsh.model, str(path), volume)


def _check_parameters(label: str, build: Callable[..., Any], parameters: dict[str, Any]) -> None:
    """Refuse numbers of a mesh script that are not finite, and bools for its numbers: gmsh takes both, for a size of its own."""
    known = inspect.signature(build).parameters
    for name, value in parameters.items():
        wanted = known[name] if name in known else None
        of_number = wanted is not None and (
            type(wanted.default) in (int, float) or wanted.annotation in (int, float, "int", "float")
        )
        if of_number if isinstance(value, bool | np.bool_) else isinstance(value, Real):
            number(f"{label}: {name}", value)


def check_model(model: Any, label: str, volume: str | None) -> tuple[int, str, dict[str, int], str]:
    """Check physical groups and cells of a meshed gmsh model; drop the groups of other bodies. Rank 0 only."""
    groups = [(dim, tag, model.getPhysicalName(dim, tag)) for dim, tag in model.getPhysicalGroups()]
    if not groups:
        raise MeshError(
            f"{label}: no physical groups. Name the solid and its surfaces with addPhysicalGroup(..., name=...)."
        )

    # names of groups
    dim = max(g[0] for g in groups)
    listing = ", ".join(f'"{n}" (dim {k})' for k, _, n in groups)
    unnamed = [(k, t) for k, t, n in groups if not n and k >= dim - 1]
    if unnamed:
        raise MeshError(
            f"{label}: physical groups {unnamed} (dim, tag) have no name; gmsh also drops a name that is given "
            f"twice. Groups: {listing}."
        )
    names = [(k, n) for k, _, n in groups]
    twice = sorted({n for k, n in names if names.count((k, n)) > 1})
    if twice:
        raise MeshError(f"{label}: several physical groups are called {twice}. Give each group its own name.")

    # the solid
    geometry = max((k for k, _ in model.getEntities()), default=dim)
    if dim < 2 or dim < geometry:
        raise MeshError(
            f"{label}: the geometry has dimension {geometry} but the highest physical group has dimension {dim} ({listing}). "
            "Put the solid into a physical group, else only its surface mesh arrives."
        )
    solids = [(t, n) for k, t, n in groups if k == dim]
    if volume is not None and volume not in [n for _, n in solids]:
        raise MeshError(f'{label}: no volume "{volume}". {near(volume, [n for _, n in solids])}')
    if volume is None and len(solids) > 1:
        raise MeshError(f"{label} holds several volumes: {[n for _, n in solids]}. Choose one with volume=...")

    tag, name = next((t, n) for t, n in solids if volume in (None, n))
    for t, n in solids:
        if n != name:
            model.removePhysicalGroups([(dim, t)])

    # its cells and facets
    entities = [int(e) for e in model.getEntitiesForPhysicalGroup(dim, tag)]
    _check_cells(model, dim, entities, label, name)
    edges = _corners(model, dim, entities, facets=True)
    own = {abs(int(t)) for e in entities for _, t in model.getBoundary([(dim, e)], oriented=False)}

    # surfaces: groups of its own boundary that have facets
    surfaces = {}
    for k, t, n in groups:
        if k != dim - 1:
            continue
        parts = [int(e) for e in model.getEntitiesForPhysicalGroup(k, t)]
        if own and not own.intersection(parts):
            model.removePhysicalGroups([(k, t)])
            continue
        if not any(len(x) for e in parts for x in model.mesh.getElements(k, e)[1]):
            raise MeshError(f'{label}: surface "{n}" has no facets. Mesh it, or remove the group.')
        _check_facets(_corners(model, k, parts), edges, f'{label}: surface "{n}"')
        surfaces[n] = t

    _drop_others(model, dim, entities)
    return dim, name, surfaces, label


def _drop_others(model: Any, dim: int, entities: list[int]) -> None:
    """Remove the mesh of everything that is no part of the solid: nodes without cells end DOLFINx's distribution."""
    own = np.unique(np.concatenate([n for e in entities for n in model.mesh.getElements(dim, e)[2]]))
    for k, e in sorted(model.getEntities(), reverse=True):
        if k == dim and e in entities:
            continue
        nodes = model.mesh.getElements(k, e)[2]
        if nodes and not np.isin(np.concatenate(nodes), own).all():
            model.mesh.clear([(k, e)])
    model.mesh.renumberNodes()


def _check_cells(model: Any, dim: int, entities: list[int], label: str, name: str) -> None:
    """One sign of the Jacobian determinant in all cells, no zero volumes, one connected part."""
    number, signs, first, links = 0, set(), None, []
    bad = 0
    reference = 0.0
    for entity in entities:
        types, tags, nodes = model.mesh.getElements(dim, entity)
        for kind, cells, cell_nodes in zip(types, tags, nodes, strict=True):
            points, _ = model.mesh.getIntegrationPoints(kind, "Gauss2")
            J, det, x = model.mesh.getJacobians(kind, points, tag=entity)
            if dim == 2:  # gmsh gives the absolute value for cells of the plane
                J = np.asarray(J).reshape(-1, 9)
                det = J[:, 0] * J[:, 4] - J[:, 1] * J[:, 3]
            per = len(points) // 3
            det = np.asarray(det).reshape(-1, per)
            x = np.asarray(x).reshape(-1, per, 3)
            if not np.isfinite(det).all():
                raise MeshError(f'{label}: volume "{name}" has cells with coordinates that are not finite.')
            reference = reference or float(np.sign(np.median(det)))
            wrong = np.flatnonzero((det * reference).min(axis=1) <= 1e-14 * np.abs(det).max())
            if wrong.size and first is None:
                first = (int(cells[wrong[0]]), x[wrong[0]].mean(0).round(6).tolist())
            bad += wrong.size
            signs.update(np.sign(det).ravel())
            number += len(cells)
            links.append(np.asarray(cell_nodes, dtype=np.int64).reshape(len(cells), -1))

    if number == 0:
        raise MeshError(f'{label}: volume "{name}" has no cells. Call gmsh.model.mesh.generate({dim}).')
    if bad:
        raise MeshError(
            f'{label}: {bad} of {number} cells of volume "{name}" are inverted or degenerate (first: cell {first[0]} '  # type: ignore[index]
            f"at {first[1]}). Remesh, or check the orientation of the geometry."  # type: ignore[index]
        )

    for cells_ in links:
        twice = len(cells_) - len(np.unique(np.sort(cells_, axis=1), axis=0))
        if twice:
            raise MeshError(
                f'{label}: {twice} cells of volume "{name}" are there twice. Remove the duplicates, or mesh anew.'
            )
    _check_connected(model, links, label, name)


FACETS = {  # corners of the facets of a cell, by dimension and number of corners, in gmsh's order
    (2, 3): ((0, 1), (1, 2), (2, 0)),
    (2, 4): ((0, 1), (1, 2), (2, 3), (3, 0)),
    (3, 4): ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    (3, 8): ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}


def _corners(model: Any, dim: int, entities: list[int], facets: bool = False) -> set[tuple[int, ...]]:
    """Corner nodes, sorted, of all elements of entities, or of their facets; none of shapes that are not known here."""
    out: set[tuple[int, ...]] = set()
    for entity in entities:
        types, _, nodes = model.mesh.getElements(dim, entity)
        for kind, numbers in zip(types, nodes, strict=True):
            _, _, _, count, _, corners = model.mesh.getElementProperties(kind)
            cells = np.asarray(numbers, dtype=np.int64).reshape(-1, count)[:, :corners]
            parts = FACETS.get((dim, corners), ()) if facets else (tuple(range(corners)),)
            for part in parts:
                out.update(tuple(row) for row in np.sort(cells[:, list(part)], axis=1))
    return out


def _check_facets(facets: set[tuple[int, ...]], edges: set[tuple[int, ...]], what: str) -> None:
    """The facets of a surface are facets of the solid's cells: others carry no field."""
    lost = facets - edges if edges else set()
    if lost:
        raise MeshError(
            f"{what}: {len(lost)} of {len(facets)} facets belong to no cell of the solid (first: nodes {list(min(lost))}). "
            "Make the surface of the solid's own boundary, and mesh both together."
        )


def _check_connected(model: Any, links: list[np.ndarray], label: str, name: str) -> None:
    """A body is one piece: cells joined through nodes."""
    import scipy.sparse as sp
    from scipy.sparse.csgraph import connected_components

    top = max(int(c.max()) for c in links) + 1
    rows = np.concatenate([np.repeat(c[:, 0], c.shape[1] - 1) for c in links])
    cols = np.concatenate([c[:, 1:].ravel() for c in links])
    graph = sp.coo_matrix((np.ones(len(rows)), (rows, cols)), shape=(top, top))
    used = np.unique(np.concatenate([c.ravel() for c in links]))
    count, part = connected_components(graph, directed=False)
    parts = np.unique(part[used])
    if len(parts) > 1:
        nodes, x, _ = model.mesh.getNodes()
        place = np.zeros((top, 3))
        place[nodes[nodes < top]] = np.asarray(x).reshape(-1, 3)[nodes < top]
        found = [used[part[used] == p] for p in parts]
        listing = ", ".join(f"{len(n)} nodes about {place[n].mean(0).round(4).tolist()}" for n in found[:8])
        raise MeshError(
            f'{label}: volume "{name}" consists of {len(parts)} separate parts ({listing}). '
            "Fuse them in gmsh, or give each its own physical group and body."
        )
