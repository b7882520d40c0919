"""Results for other programs: time histories as a table, for xarray and pandas (optional both), fields of snapshots for ParaView.

Fields are written with the true motion: the displacement of the points x = r + R (X + u) from where the mesh lies, so that
ParaView's "Warp by Vector" shows the bodies where they are. One ``.pvd`` for each elastic body, full or reduced.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, require
from ...mechanics.reduction.recovery import displacement_field, within_cells
from ...ranks import on_root
from ...rotations import Array
from ...run.result import Run
from ...system.layout import State
from ..drawing.draw import draw
from ..drawing.scene_graph import Drawing, Piece
from ..drawing.view import View
from .files import write_whole

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


Quantity = Callable[[Any], Any]
"""A UFL expression of the displacement u in the body's axes, scalar, vector or tensor: say von Mises' stress."""


def save_series(run: Run, file: str | Path) -> None:
    """Time, every component of every sensor with its unit, and the energies, as comma-separated values; collective, rank 0
    writes.

    Raises InputError where the file cannot be written, or its name promises another format.
    """
    ending = Path(file).suffix.lower()
    require(
        ending in ("", ".csv", ".txt", ".dat"),
        f'run.save writes comma-separated values: the name must end in .csv, .txt or .dat, found "{ending}". run.to_xarray() and '
        "run.to_pandas() write other formats, run.picture and run.animate pictures.",
    )
    names = ["time (s)"]
    for sensor in run.series:
        names += [f"{label} ({run.scene.sensors[sensor].unit_of(k)})" for k, label in enumerate(run.components(sensor))]
    names += [f"{kind} energy (J)" for kind in run.energy]

    columns = np.column_stack((run.times, *run.series.values(), *run.energy.values()))
    # names may hold commas
    heads = ",".join('"' + name.replace('"', '""') + '"' for name in names)

    def write(place: Path) -> None:
        np.savetxt(place, columns, delimiter=",", header=heads, comments="", fmt="%.17g")

    on_root(run.system.comm, lambda: write_whole("The time histories", file, write))
    if run.error_estimate or run.space_error or run.reduction_error:
        on_root(run.system.comm, lambda: _save_errors(run, Path(file)))


def _save_errors(run: Run, file: Path) -> None:
    """The certificate beside the time histories; empty where an error was not stated."""
    kinds = ("space", "time", "modes", "algebra", "total", "share")
    lines = ["sensor,unit," + ",".join(kinds)]
    for s in run.certificate.statements:
        numbers = [getattr(s, k) for k in kinds]
        name = s.sensor.replace('"', '""')
        lines.append(f'"{name}",{s.unit},' + ",".join("" if x is None else f"{x:.6g}" for x in numbers))
    table = "\n".join(lines) + "\n"
    write_whole("The certificate", file.with_suffix(".errors.csv"), lambda place: place.write_text(table))


def save_fields(run: Run, folder: str | Path, quantities: Mapping[str, Quantity] | None = None) -> list[Path]:
    """Displacements and quantities of every elastic body in what a run shows, ``folder/<body>.pvd``, and the whole scene with
    rigid bodies, joints, springs and obstacles, ``folder/scene.pvd``; collective.

    ``quantities`` are those of the middle of each cell. Returns the files, that of the scene last.
    """
    bodies = [b for b in run.scene.bodies.values() if b.meshed]
    files = body_files(Path(folder), [b.name for b in bodies])
    for b in bodies:
        _save_body(run, b, files[b.name], dict(quantities or {}))
    drawing = draw(run, view=View(floor=False))
    on_root(run.system.comm, lambda: save_scene(drawing, Path(folder), files))
    return [*files.values(), Path(folder) / "scene.pvd"]


def _save_body(run: Run, body: Any, file: Path, quantities: dict[str, Quantity]) -> None:
    from dolfinx import fem, io

    u = displacement_field(run, body, run.shown[0])
    mesh = u.function_space.mesh
    moved = fem.Function(u.function_space, name="displacement")
    cells = [within_cells(u, quantity, degree=0, name=name) for name, quantity in quantities.items()]

    with io.VTKFile(mesh.comm, file, "w") as out:
        for state in run.shown:
            # quantities are those of u in the body's axes; what is shown is the motion in the world
            u.x.array[:] = displacement_field(run, body, state).x.array
            moved.x.array[:] = _motion(run, body, state, u)
            for function, expression in cells:
                function.interpolate(expression)
            out.write_function([moved, *(function for function, _ in cells)], state.t)


def _motion(run: Run, body: Any, state: State, u: Any) -> np.ndarray:
    """x - X at the nodes, world axes: r + R (X - r_0 + u) - X with a frame, else u."""
    s = run.system
    _, part = s.part(body.name)
    if part.frame == s.n_frames:
        return np.asarray(u.x.array)
    ev = s.at(state.t, state.q)
    d = s.motions.dim
    X = u.function_space.tabulate_dof_coordinates()[:, :d]

    origin = part.constants.center if body.modal else part.origin
    P = X - origin + u.x.array.reshape(-1, d)
    return np.asarray((ev.pose[part.frame, :d] + P @ ev.rotation[part.frame].T - X).ravel())


def to_xarray(run: Run) -> Any:
    """An ``xarray.Dataset`` of all sensors and energies over time, with units and the names of components."""
    try:
        import xarray
    except ImportError as error:
        raise InputError("run.to_xarray() needs xarray: ./with-dolfinx pip install xarray.") from error

    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {"time": ("time", run.times, {"units": "s", "long_name": "time"})}
    for sensor, values in run.series.items():
        labels = run.components(sensor)
        about = {"units": run.scene.sensors[sensor].unit, "long_name": sensor}
        if len(labels) == 1:
            variables[sensor] = ("time", values[:, 0], about)
            continue
        along = f"{sensor} component"
        coordinates[along] = (along, [label.removeprefix(sensor).strip() for label in labels])
        variables[sensor] = (("time", along), values, about)
    for kind, energy in run.energy.items():
        variables[f"{kind} energy"] = ("time", energy, {"units": "J", "long_name": f"{kind} energy"})

    return xarray.Dataset(variables, coordinates, attrs=_about_run(run))


def _about_run(run: Run) -> dict[str, Any]:
    """What a reader of the file wants to know of the run; text and numbers only, as netCDF takes them."""
    from ... import __version__

    known = {"scene": run.scene.name, "scheme": run.scheme.name, "step size (s)": float(run.dt), "status": run.status}
    errors = {f"estimated error of {name}": float(x) for name, x in run.error_estimate.items()}
    return {**known, **errors, "made by": f"fmbd_fenicsx {__version__}"}


def to_pandas(run: Run) -> Any:
    """A ``pandas.DataFrame`` over time, one column for each component: "tip x (m)"."""
    try:
        import pandas
    except ImportError as error:
        raise InputError("run.to_pandas() needs pandas: ./with-dolfinx pip install pandas.") from error

    columns: dict[str, Any] = {}
    for sensor, values in run.series.items():
        unit = run.scene.sensors[sensor].unit
        columns |= {f"{label} ({unit})": x for label, x in zip(run.components(sensor), values.T, strict=True)}
    columns |= {f"{kind} energy (J)": energy for kind, energy in run.energy.items()}

    return pandas.DataFrame(columns, index=pandas.Index(run.times, name="time (s)"))
