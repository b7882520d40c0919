"""Checked reading of gmsh meshes: named volumes and surfaces, one clear error on all ranks when something is wrong.

A mesh script is a Python file with a function ``build(gmsh, **parameters)`` that makes a model with named physical groups;
a ``.msh`` file (format 2 or 4) works as well. Everything is checked on rank 0 and the outcome is sent to all ranks before
the mesh is distributed.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from ... import dolfinx_compat as compat
from ...checks import instance, number, vector, word, words
from ...errors import InputError, MeshError, near
from ...ranks import together
from ...rotations import motions
from ...scripts import module_of
from .checks import Checked, check_model, name_of_volumes
from .facet_groups import Tag

Loader = Callable[[Any, int], Checked]  # fills a gmsh session with a mesh whose edges are halved so many times
SIZES = ("h", "counts", "cells")  # parameters of scripts by which cells become smaller
SMALLEST = 1e-12  # area of a surface over extent^(d - 1)


@dataclass(frozen=True)
class Recipe:
    """How a mesh was made by a script with the size of its cells, or their numbers, and where it was placed."""

    source: Path
    volume: str | Sequence[str] | None
    comm: Any
    parameters: dict[str, Any]
    scale: float = 1.0
    placed: tuple[tuple[Any, Any], ...] = ()

    def halved(self, label: str) -> Mesh:
        """The mesh of half the cell size; collective."""
        p = dict(self.parameters)
        if "h" in p:
            p["h"] = 0.5 * p["h"]
        elif p.get("counts") is not None:
            p["counts"] = tuple(2 * n for n in p["counts"])
        else:
            p["cells"] = 2 * p["cells"]
        mesh = read_gmsh(self.source, volume=self.volume, comm=self.comm, scale=self.scale, **p)
        return _placed(mesh, self.placed)


@dataclass(frozen=True)
class FinishedMesh:
    """How a mesh is loaded into gmsh, how often its edges were halved since, and where it was placed."""

    load: Loader
    comm: Any
    halvings: int = 0
    placed: tuple[tuple[Any, Any], ...] = ()

    def halved(self, label: str) -> Mesh:
        """The mesh with every edge halved; collective."""
        return _placed(distributed(self.load, label, self.comm, self.halvings + 1), self.placed)


def _placed(mesh: Mesh, places: tuple[tuple[Any, Any], ...]) -> Mesh:
    """A mesh put in places one after the other."""
    for position, rotation in places:
        mesh = mesh.placed(position, rotation)
    return mesh


@dataclass(frozen=True, eq=False)
class Mesh:
    """A distributed mesh of one body with named surfaces.

    Attributes: ``dolfinx`` the mesh, ``facet_tags`` its MeshTags, ``surfaces`` name -> tag or tags, ``volume`` name of the
    solid group or groups, ``label`` what messages call it, ``recipe`` how it was made, where that is known, ``others`` name of a
    group that is no surface -> why; ``volumes`` name -> tag of the solid groups, ``cell_tags`` their MeshTags; ``spaces`` that
    copies have in common, see :meth:`space`.
    """

    dolfinx: Any
    facet_tags: Any
    surfaces: dict[str, Tag]
    volume: str
    label: str
    recipe: Recipe | FinishedMesh | None = None
    others: dict[str, str] = field(default_factory=dict)
    volumes: dict[str, int] = field(default_factory=dict)
    cell_tags: Any = None
    spaces: dict[tuple[Any, ...], Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        cells = self.dolfinx.topology.index_map(self.dim).size_global
        names = ", ".join(f'"{name}"' for name in self.surface_names)
        return (
            f'<Mesh of {self.label}: {cells} cells in {self.dim}D, volume "{self.volume}", surfaces {names or "none"}>'
        )

    def refined(self) -> Mesh:
        """The mesh of half the cell size, at the same place; collective.

        By its script where that was given the cell size ``h``, or the numbers of ``cells`` or ``counts``; else every edge is
        halved. Either way curved sides are met better where gmsh knows the shape; sides of a finished mesh stay as they are.

        Raises:
            MeshError: nobody knows where the mesh is from, or its cells are curved and it was finished elsewhere.
        """
        if self.recipe is None:
            raise MeshError(f"{self.label} cannot be refined: it was not read by read_gmsh or read_mesh.")
        return self.recipe.halved(self.label)

    @property
    def dim(self) -> int:
        """Space dimension, equal to the cells' dimension."""
        return int(self.dolfinx.geometry.dim)

    @property
    def surface_names(self) -> list[str]:
        """Names of the surfaces, sorted."""
        return sorted(self.surfaces)

    def surface_tag(self, name: str) -> Tag:
        """Tag of a named surface, or those of its parts where it shares facets with others: what UFL's measures take."""
        if name not in self.surfaces:
            raise MeshError(f"No{self.missing(name)[2:]}")
        return self.surfaces[name]

    def facets(self, name: str) -> Any:
        """Facets of a named surface that this rank knows, ascending."""
        return self.facet_tags.indices[np.isin(self.facet_tags.values, self.surface_tag(name))]

    def volume_tag(self, name: str) -> int:
        """Tag of a named volume: ``dx(mesh.volume_tag("core"))`` is the measure of it in an elastic form of the body."""
        if name not in self.volumes:
            raise MeshError(f'No volume "{name}" in {self.label}. {near(name, sorted(self.volumes))}')
        return self.volumes[name]

    @cached_property
    def dx(self) -> Any:
        """UFL's measure of the body, which knows its volumes."""
        import ufl

        return ufl.Measure("dx", domain=self.dolfinx, subdomain_data=self.cell_tags)

    def space(self, degree: int, shape: tuple[int, ...] = ()) -> Any:
        """The Lagrange space of a degree; its nodes are numbered once for all copies by :meth:`placed`. Collective."""
        from dolfinx import fem

        element = ("Lagrange", degree, shape) if shape else ("Lagrange", degree)
        if element not in self.spaces:
            self.spaces[element] = fem.functionspace(self.dolfinx, element)
        known = self.spaces[element]
        return known if known.mesh is self.dolfinx else compat.space_like(known, self.dolfinx)

    def missing(self, name: str) -> str:
        """That there is no such surface, why, and which there are."""
        why = f" {self.others[name]}" if name in self.others else ""
        return f'no surface "{name}" in {self.label}.{why} {near(name, self.surface_names)}'

    @cached_property
    def extent(self) -> float:
        """Longest edge of the box around the mesh, m; collective."""
        x = self.dolfinx.geometry.x
        # a rank may hold no nodes
        inf = np.full(3, np.inf)
        boxes = self.dolfinx.comm.allgather((x.min(0), x.max(0)) if len(x) else (inf, -inf))
        return float((np.max([b[1] for b in boxes], axis=0) - np.min([b[0] for b in boxes], axis=0)).max())

    def placed(self, position: Any = None, rotation: Any = None) -> Mesh:
        """A copy whose point x lies at ``position`` + R x: one mesh for several equal bodies.

        Args:
            position: of the mesh's origin, m, (d,); None: where it is.
            rotation: an angle (rad) in the plane; in space a matrix (3, 3), quaternion (scalar last) or SciPy's Rotation;
                None: unturned.
        """
        from dolfinx.mesh import meshtags

        motion, d = motions(self.dim), self.dim
        try:
            start = np.zeros(d) if position is None else vector(f"{self.label}: position", position, size=d)
        except InputError as error:
            raise MeshError(str(error)) from None
        pose = motion.pose(start, rotation)

        x = pose[:d] + self.dolfinx.geometry.x[:, :d] @ motion.matrix(pose).T
        mesh = compat.moved(self.dolfinx, x)
        # tags belong to a topology: those of the copy
        facets, cells = (
            None if tags is None else meshtags(mesh, tags.dim, tags.indices, tags.values)
            for tags in (self.facet_tags, self.cell_tags)
        )
        # a finer mesh of it is put in the same place
        recipe = self.recipe
        if recipe is not None:
            recipe = replace(recipe, placed=(*recipe.placed, (position, rotation)))
        return replace(self, dolfinx=mesh, facet_tags=facets, cell_tags=cells, recipe=recipe)

    def check_area(self, name: str, area: float) -> None:
        """Refuse a surface without area, or with so little that a joint on it cannot carry a finite force; collective."""
        least = SMALLEST * self.extent ** (self.dim - 1)
        if not area > least:
            raise MeshError(
                f'Surface "{name}" of {self.label} has area {area:.3g} m^{self.dim - 1}, not more than {least:.3g}: '
                + ("it has no facets on the boundary." if area == 0 else "too small to carry a joint, a tie or a load.")
            )


def read_gmsh(
    source: str | Path,
    *,
    volume: str | Sequence[str] | None = None,
    scale: float = 1.0,
    comm: Any = None,
    **parameters: Any,
) -> Mesh:
    """Read one body from a mesh script (``.py``), a ``.geo`` or a ``.msh`` file; collective over ``comm`` (default COMM_WORLD).

    Args:
        source: path of the script or file.
        volume: name of the solid's physical group; needed when the file holds several. Several names: one body of several
            materials, whose volumes share the nodes between them.
        scale: m for a unit of the script or file: 1e-3 for mm.
        parameters: passed to the script's ``build`` (say ``h=0.05``, ``dim=2``).

    Raises:
        MeshError: file missing, no or duplicated or unnamed groups, only surfaces meshed, cells inverted or degenerate.
    """
    compat.check_versions()
    instance("read_gmsh: source", source, (str, Path))
    names = () if volume is None else (volume,) if isinstance(volume, str) else words("read_gmsh: volume", volume)
    for name in names:
        word("read_gmsh: volume", name)
    number("read_gmsh: scale", scale, above=0.0)
    path = Path(source)
    made = distributed(lambda gmsh, n: _load(gmsh, path, parameters, (volume, scale, n)), str(path), comm)
    sized = any(parameters.get(name) is not None for name in SIZES)
    if path.suffix != ".py" or not sized:
        return made
    return replace(made, recipe=Recipe(path, volume, made.dolfinx.comm, parameters, scale))


def distributed(load: Loader, label: str, comm: Any = None, halvings: int = 0) -> Mesh:
    """The mesh that ``load``(gmsh, halvings) makes on rank 0 in an open gmsh session, checked there; collective over ``comm``.

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
            found = load(gmsh, halvings)
        except Exception as exc:  # sent to all ranks
            told = f"{label}: {type(exc).__name__}: {exc}"
            if "OpenCASCADE" in told:
                told += ". Its shapes have no edges below 1e-7: draw smaller ones in larger units, and read them with scale="
            error = exc if isinstance(exc, InputError) else MeshError(told)
    try:
        # gmsh gives its model to the ranks; the others need a session for that
        together(comm, error)
        checked: Checked = comm.bcast(found)
        if not gmsh.isInitialized():
            gmsh.initialize(interruptible=False)
        msh, cells, facets = compat.model_to_mesh(gmsh.model, comm, checked.dim)
    finally:
        if gmsh.isInitialized():
            gmsh.finalize()

    msh.topology.create_connectivity(checked.dim - 1, checked.dim)
    made_by = FinishedMesh(load, comm, halvings)
    name = name_of_volumes(checked.volumes)
    return Mesh(msh, facets, checked.surfaces, name, checked.label, made_by, checked.others, checked.volumes, cells)


def cells_of(topology: Any, facets: Any) -> tuple[np.ndarray, np.ndarray]:
    """A cell of each of some facets of this rank, and the number that the facet has in it, (n,) each; collective."""
    d = topology.dim
    topology.create_connectivity(d - 1, d)
    topology.create_connectivity(d, d - 1)
    to_cell, to_facet = topology.connectivity(d - 1, d), topology.connectivity(d, d - 1)
    cells = np.array([to_cell.links(f)[0] for f in facets], dtype=np.int32)
    numbers = [np.flatnonzero(to_facet.links(c) == f)[0] for c, f in zip(cells, facets, strict=True)]
    return cells, np.array(numbers, dtype=int)


def require_file(path: Path) -> None:
    """Refuse a path at which no file is."""
    if not path.is_file():
        raise MeshError(f"Mesh file {path} does not exist (looked in {Path.cwd()}).")


def halve_edges(gmsh: Any, times: int) -> None:
    """Halve every edge of a model's mesh so many times; new nodes lie on its shape, in whose units the mesh has to be.

    Raises:
        MeshError: curved cells without a shape. gmsh would make them straight, and the body another one.
    """
    if not times:
        return
    order = max(gmsh.model.mesh.getElementProperties(kind)[2] for kind in gmsh.model.mesh.getElementTypes())
    shapes = [gmsh.model.getType(*entity) for entity in gmsh.model.getEntities(gmsh.model.getDimension())]
    if order > 1 and any(shape.startswith("Discrete") for shape in shapes):
        raise MeshError(
            f"its cells of order {order} cannot be halved, as a finished mesh has no shape for their new sides. Take a script "
            "with the size of its cells h, a .geo file or a CAD part."
        )
    for _ in range(times):
        gmsh.model.mesh.refine()
    gmsh.model.mesh.setOrder(order)


def _load(
    gmsh: Any, path: Path, parameters: dict[str, Any], wanted: tuple[str | Sequence[str] | None, float, int]
) -> Checked:
    """Rank 0: build or open the model, check it, keep one body; ``wanted``: its volume, scale and halvings."""
    volume, scale, halvings = wanted
    require_file(path)

    if path.suffix == ".py":
        module = module_of("Mesh script", path)
        if not hasattr(module, "build"):
            raise MeshError(f"Mesh script {path} has no function build(gmsh, **parameters).")
        _check_parameters(str(path), module.build, parameters)
        module.build(gmsh, **parameters)
    else:
        if parameters:
            raise MeshError(f"{path} is a finished mesh: parameters {sorted(parameters)} have no meaning for it.")
        gmsh.open(str(path))
        # a .geo file may leave it to gmsh's command line
        if not len(gmsh.model.mesh.getNodes()[0]):
            gmsh.model.mesh.generate(gmsh.model.getDimension())

    halve_edges(gmsh, halvings)
    if scale != 1.0:
        gmsh.model.mesh.affineTransform([scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0])
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
