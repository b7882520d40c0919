"""Lines of gmsh as curves of rods: their points in order, and the named points on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...checks import instance, word
from ...errors import MeshError, near
from ...rotations import Array
from .mesh import require_file


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a mesh. ``points`` (n, 3), m, in order; ``stations``: name -> place (3,) of the named points on it."""

    points: Array
    stations: Mapping[str, Array]


def read_line(source: str | Path, *, line: str | None = None, comm: Any = None) -> Line:
    """Read a line, a physical curve of a ``.msh`` or ``.geo`` file with the physical points on it; collective.

    ``line``: name of the physical curve, needed when the file holds several. Give the points to :class:`.Rod` as its curve, and
    the stations as its stations: ``fmbd.Rod("blade", line.points, section, stations=line.stations)``.

    Raises:
        MeshError: no file, no or several lines of that name, a line that branches, is closed or in pieces.
    """
    from mpi4py import MPI

    from ...ranks import together

    path = Path(instance("read_line: source", source, (str, Path)))
    if line is not None:
        word("read_line: line", line)
    comm = MPI.COMM_WORLD if comm is None else instance("read_line: comm", comm, MPI.Comm)
    error, found = None, None
    if comm.rank == 0:
        try:
            found = _read(path, line)
        except Exception as problem:  # sent to all ranks
            error = problem if isinstance(problem, MeshError) else MeshError(f"{source}: {problem}")
    together(comm, error)
    return Line(*comm.bcast(found))


def _read(path: Path, line: str | None) -> tuple[Array, dict[str, Array]]:
    """Rank 0: points and stations."""
    import gmsh

    require_file(path)
    gmsh.initialize(interruptible=False)

    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        model = gmsh.model
        if not len(model.mesh.getNodes()[0]):
            model.mesh.generate(1)
        groups = {model.getPhysicalName(1, tag): tag for _, tag in model.getPhysicalGroups(1)}
        name = line or next(iter(groups), "")
        if name not in groups or (line is None and len(groups) > 1):
            wish = line or "(no name was given)"
            raise MeshError(f"{path}: line {wish} is none of its physical curves. {near(wish, groups)}")
        return _points(model, groups[name], f'{path}: line "{name}"')
    finally:
        gmsh.finalize()


def _points(model: Any, group: int, label: str) -> tuple[Array, dict[str, Array]]:
    """Points of a physical curve from one end to the other, and the physical points among them."""
    chains: list[np.ndarray] = []
    for entity in model.getEntitiesForPhysicalGroup(1, group):
        for kind, _, nodes in zip(*model.mesh.getElements(1, entity), strict=True):
            count = model.mesh.getElementProperties(kind)[3]
            # of an element: both ends, then the nodes between them
            chains.extend(np.asarray(nodes, dtype=int).reshape(-1, count)[:, [0, *range(2, count), 1]])
    order = _ordered(chains, label)
    points = np.array([model.mesh.getNode(tag)[0] for tag in order], dtype=float)

    stations = {}
    for dim, tag in model.getPhysicalGroups(0):
        nodes, places = model.mesh.getNodesForPhysicalGroup(dim, tag)
        if len(nodes) == 1 and int(nodes[0]) in order:
            stations[model.getPhysicalName(0, tag)] = np.asarray(places, dtype=float)
    return points, stations


def _ordered(chains: list[np.ndarray], label: str) -> list[int]:
    """Nodes along one path made of pieces, in the sense of the first piece."""
    at: dict[int, list[int]] = {}
    for i, chain in enumerate(chains):
        for end in (int(chain[0]), int(chain[-1])):
            at.setdefault(end, []).append(i)
    ends = [node for node, pieces in at.items() if len(pieces) == 1]
    if len(ends) != 2 or max(map(len, at.values()), default=0) > 2:
        raise MeshError(f"{label} must be one open path: it has {len(ends)} ends. A rod needs two.")

    starts = {int(chain[0]) for chain in chains}
    order = [next((node for node in ends if node in starts), ends[0])]
    left = set(range(len(chains)))
    while pieces := [i for i in at[order[-1]] if i in left]:
        tags = [int(x) for x in chains[pieces[0]]]
        left.discard(pieces[0])
        order += tags[1:] if tags[0] == order[-1] else tags[-2::-1]
    if left:
        raise MeshError(f"{label} is in pieces that do not meet.")
    return order
