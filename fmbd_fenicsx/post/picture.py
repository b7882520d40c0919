"""Pictures of a run's snapshots: bodies where they are, drawn by pyvista without a window.

Elastic bodies show their deformed surface (in the plane: themselves), x = r + R (X + u) or x = X + u. Bodies
without a mesh (rigid, reduced) show as a ball at the origin of their frame with bars to their joints, joints
as small balls. Geometry is gathered to rank 0, which alone loads pyvista and draws.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import dolfinx_compat as compat
from ..errors import InputError, require
from ..mechanics.reduction.recovery import displacement_field
from ..rotations import Array
from ..run.solve import Run
from ..system.system import Evaluation, State

LARGEST = 2_000_000  # triangles that are still drawn


@dataclass(frozen=True)
class View:
    """An image (rows, columns, 3) and, in the plane, the world rectangle (x0, x1, y0, y1) in m that it
    shows.
    """

    image: Array
    extent: tuple[float, float, float, float] | None


@dataclass(frozen=True)
class Skin:
    """What is drawn of an elastic body, in its global node numbers: triangles (m, 3) and edge segments (k,
    2).
    """

    triangles: Array
    edges: Array


@dataclass(frozen=True)
class Moment:
    """One snapshot: nodal positions of each elastic body, bars (k, 2, 3), origins of other bodies and joints
    (n, 3), m.
    """

    nodes: list[Array]
    bars: Array
    origins: Array
    joints: Array

    def lifted(self, z: float) -> Moment:
        """The same farther to the front: in the plane later snapshots cover earlier ones."""
        lift = np.array([0.0, 0.0, z])
        return Moment([x + lift for x in self.nodes], self.bars + lift, self.origins + lift, self.joints + lift)

    def points(self) -> Array:
        """All positions, (n, 3)."""
        return np.concatenate([*self.nodes, self.bars.reshape(-1, 3), self.origins, self.joints])


# -- geometry, collective ------------------------------------------------------------------------------
def gather(run: Run) -> tuple[list[Skin], list[Moment]]:
    """Skins of the elastic bodies and all snapshots' positions; collective, complete on rank 0 only."""
    require(bool(run.snapshots), "A picture needs snapshots: solve(..., output=Output(snapshots=6)).")
    skins = [skin(part.field) for part in run.system.parts if hasattr(part, "field")]
    number = sum(len(s.triangles) for s in skins)
    require(
        number <= LARGEST,
        f"The surface has {number} triangles, too many for a picture: use run.save_fields() and ParaView.",
    )
    return skins, [moment(run, state) for state in run.snapshots]


def skin(field: Any) -> Skin:
    """Skin of a displacement field; collective. Curved (P2) facets are drawn with their mid nodes."""
    from dolfinx import mesh as dm

    msh, V = field.space.mesh, field.space
    tdim = msh.topology.dim
    msh.topology.create_connectivity(tdim - 1, tdim)
    msh.topology.create_connectivity(tdim, tdim - 1)
    outer = dm.exterior_facet_indices(msh.topology)
    cell_of, facets_of = msh.topology.connectivity(tdim - 1, tdim), msh.topology.connectivity(tdim, tdim - 1)
    layout, numbers = V.dofmap.dof_layout, V.dofmap.index_map.local_to_global
    borders = []
    for facet in outer:
        cell = cell_of.links(facet)[0]
        local = int(np.flatnonzero(facets_of.links(cell) == facet)[0])
        borders.append(V.dofmap.cell_dofs(cell)[layout.entity_closure_dofs(tdim - 1, local)])
    if tdim == 3:
        faces, lines = borders, [line for face in borders for line in _outline(face)]
    else:
        cells = range(msh.topology.index_map(tdim).size_local)
        closure = layout.entity_closure_dofs(tdim, 0)
        faces = [V.dofmap.cell_dofs(c)[closure] for c in cells]
        lines = [_polyline(b) for b in borders]
    triangles = _gathered(msh.comm, numbers, [t for face in faces for t in _triangles(face)], 3)
    return Skin(triangles, _gathered(msh.comm, numbers, [s for line in lines for s in line], 2))


def painted(run: Run, body: Any, quantity: Any) -> list[Array]:
    """A scalar quantity(u) in UFL on every triangle of a plane body's :func:`skin`, one array for each snapshot; collective.

    u is the displacement in the body's axes, as for ``fmbd.largest``.
    """
    from dolfinx import fem

    found = []
    for state in run.snapshots:
        u = displacement_field(run, body, state)
        V, msh = u.function_space, u.function_space.mesh
        nodes = compat.interpolation_points(V)
        middles = np.array([nodes[t].mean(0) for t in _triangles(np.arange(len(nodes)))])
        cells = np.arange(msh.topology.index_map(msh.topology.dim).size_local, dtype=np.int32)
        values = fem.Expression(quantity(u), middles).eval(msh, cells)
        found.append(np.concatenate(msh.comm.allgather(values.ravel())))
    return found


def _gathered(comm: Any, numbers: Any, local: list[Any], width: int) -> Array:
    """Rows of local node numbers as global ones, of all ranks."""
    own = np.array(local, dtype=np.int32).reshape(-1, width)
    return np.concatenate(comm.allgather(numbers(own.ravel()).reshape(-1, width)))


def _triangles(n: Any) -> list[list[int]]:
    """Triangles of a face: 3 nodes, 6 (corners, then the mid nodes opposite to them), 4 or 9 (tensor
    order).
    """
    if len(n) in (4, 9):
        return [[n[0], n[1], n[3]], [n[0], n[3], n[2]]]
    if len(n) == 6:
        return [[n[i] for i in t] for t in ((0, 5, 4), (5, 1, 3), (4, 3, 2), (3, 4, 5))]
    return [[n[0], n[1], n[2]]]


def _outline(n: Array) -> list[list[list[int]]]:
    """Border of a face as polylines."""
    if len(n) in (4, 9):
        return [[[n[a], n[b]]] for a, b in ((0, 1), (1, 3), (3, 2), (2, 0))]
    if len(n) == 6:
        return [[[n[a], n[m]], [n[m], n[b]]] for a, m, b in ((0, 5, 1), (1, 3, 2), (2, 4, 0))]
    return [[[n[a], n[b]]] for a, b in ((0, 1), (1, 2), (2, 0))]


def _polyline(n: Array) -> list[list[int]]:
    """Segments of an edge with two ends and, for P2, a mid node."""
    return [[n[0], n[2]], [n[2], n[1]]] if len(n) == 3 else [[n[0], n[1]]]


def moment(run: Run, state: State) -> Moment:
    """Positions of one snapshot; collective, nodes complete on rank 0 only."""
    s = run.system
    ev = s.at(state.t, state.q)
    nodes = []
    for k, part in enumerate(s.parts):
        if hasattr(part, "field"):
            found = _nodes(ev, k)
            comm = part.field.comm
            parts = comm.gather(found)
            nodes.append(_in_space(np.concatenate(parts) if parts is not None else found))
    pairs = [batch for batch, _ in s.batches if hasattr(batch, "a")]  # couplings act on joints drawn anyway
    ends = sorted({int(i) for batch in pairs for i in (*batch.a, *batch.b)})
    meshed = {part.frame for part in s.parts if hasattr(part, "field")}
    rigid = [f for f in range(s.n_frames) if f not in meshed]
    bars = [[ev.pose[f, : s.motions.dim], ev.kin.x[i]] for i in ends for f in [int(s.markers.frame[i])] if f in rigid]
    return Moment(
        nodes,
        _in_space(np.array(bars).reshape(-1, s.motions.dim)).reshape(-1, 2, 3),
        _in_space(ev.pose[rigid, : s.motions.dim]),
        _in_space(ev.kin.x[ends]),
    )


def _nodes(ev: Evaluation, k: int) -> Array:
    """World positions of the owned nodes of part k, (n, d)."""
    part, d = ev.system.parts[k], ev.system.motions.dim
    field: Any = part.field  # type: ignore[attr-defined]
    P = field.points(ev.system.local_q(ev.q, k))
    if part.frame == ev.system.n_frames:  # absolute: displacements from the place where the mesh lies
        return np.asarray(field.center + P)
    return np.asarray(ev.pose[part.frame, :d] + P @ ev.rotation[part.frame].T)


def _in_space(x: Array) -> Array:
    """Points (n, d) as (n, 3)."""
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


# -- drawing, rank 0 -----------------------------------------------------------------------------------
def render(run: Run, geometry: tuple[list[Skin], list[Moment]], colors: Array, width: int = 1600) -> View:
    """Draw all snapshots in one image, each in its colour (n, 3); rank 0 only."""
    try:
        import pyvista as pv
    except ImportError as error:
        raise InputError("A picture needs pyvista: install fmbd_fenicsx[plot].") from error
    ensure_display()
    skins, moments = geometry
    points = np.concatenate([m.points() for m in moments])
    low, high = points.min(0), points.max(0)
    size = float(np.linalg.norm(high - low)) or 1.0
    plane = run.system.motions.dim == 2
    middle = 0.5 * (low + high)
    margin = 0.05 * size
    w, h = (high - low)[:2] + 2 * margin
    height = round(width * h / w) if plane else round(0.8 * width)
    plotter = pv.Plotter(off_screen=True, window_size=[width, min(max(height, width // 4), 2 * width)])
    plotter.set_background("white")
    for k, (color, m) in enumerate(zip(colors, moments, strict=True)):
        _draw(pv, plotter, skins, m.lifted(0.05 * size * k if plane else 0.0), color, 0.012 * size)
    if plane:
        plotter.view_xy()
        plotter.enable_parallel_projection()
        plotter.camera.focal_point = (*middle[:2], 0.0)
        plotter.camera.position = (*middle[:2], (10 + 0.1 * len(moments)) * size)
        plotter.camera.parallel_scale = h / 2
    else:
        up = _up(run)
        side = np.eye(3)[int(np.argmin(np.abs(up)))]
        plotter.camera_position = [middle + 0.3 * side + 0.35 * up + np.cross(side, up), middle, up]
        plotter.reset_camera()
        plotter.camera.zoom(1.2)
        plotter.add_axes()
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(return_img=True)
    shown = plotter.window_size
    plotter.close()
    half = 0.5 * h * shown[0] / shown[1]
    x, y = middle[:2]
    return View(np.asarray(image), (x - half, x + half, y - h / 2, y + h / 2) if plane else None)


def _up(run: Run) -> Array:
    """The direction against gravity, (3,); y without gravity."""
    g = np.zeros(3) if run.scene.gravity is None else np.asarray(run.scene.gravity, dtype=float)
    size = float(np.linalg.norm(g))
    return np.asarray(-g / size) if size > 0 and len(g) == 3 else np.array([0.0, 1.0, 0.0])


def _draw(pv: Any, plotter: Any, skins: list[Skin], m: Moment, color: Any, radius: float) -> None:
    flat = np.ptp(m.points()[:, 2]) == 0.0
    for s, x in zip(skins, m.nodes, strict=True):
        faces = np.hstack((np.full((len(s.triangles), 1), 3), s.triangles)).ravel()
        plotter.add_mesh(pv.PolyData(x, faces), color=color, smooth_shading=False, ambient=0.35)
        lines = np.hstack((np.full((len(s.edges), 1), 2), s.edges)).ravel()
        line_at = x + [0.0, 0.0, 0.01 * radius] if flat else x
        plotter.add_mesh(
            pv.PolyData(line_at, lines=lines),
            color=0.4 * color,
            line_width=3 if flat else 1.5,
            lighting=False,
        )
    for a, b in m.bars:
        if np.linalg.norm(b - a) > 0:
            plotter.add_mesh(pv.Tube(pointa=a, pointb=b, radius=0.4 * radius, n_sides=16), color=color)
    for x in m.origins:
        plotter.add_mesh(pv.Sphere(radius=1.3 * radius, center=x), color=color)
    for x in m.joints:
        plotter.add_mesh(pv.Sphere(radius=0.8 * radius, center=x), color="#303030")


def ensure_display() -> None:
    """Give VTK before 9.4, which draws only through X, an X server that ends with this process; nothing where
    there is one.
    """
    import vtk

    version = tuple(int(p) for p in vtk.vtkVersion().GetVTKVersion().split(".")[:2])
    have = shutil.which("Xvfb") and shutil.which("setpriv")
    if version >= (9, 4) or os.environ.get("DISPLAY") or not have:
        return
    display = f":{1000 + os.getpid() % 50000}"  # its own: two servers that start together must not claim one
    read, write = os.pipe()
    server = [
        "Xvfb",
        display,
        "-displayfd",
        str(write),
        "-screen",
        "0",
        "1600x1200x24",
        "-nolisten",
        "tcp",
        "-noreset",
    ]
    subprocess.Popen(
        ["setpriv", "--pdeathsig", "TERM", *server],
        pass_fds=(write,),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.close(write)
    with os.fdopen(read) as ready:  # a whole line: the server ends when it cannot write all of it
        if ready.readline().strip():
            os.environ["DISPLAY"] = display
