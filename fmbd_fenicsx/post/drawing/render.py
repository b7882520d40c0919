"""Drawings as images, by pyvista without a window. Rank 0 only."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...rotations import Array
from .scene_graph import Drawing, Piece, Role, Still
from .view import View

COLORS = {
    Role.GROUND: "#a9a9a9",
    Role.OBSTACLE: "#c3c3c3",
    Role.WIRE: "#303030",
    Role.SPRING: "#b03a2e",
    Role.JOINT: "#303030",
    Role.DRIVE: "#e67e22",
}
ARROWS = ("#d62728", "#1f5fd6", "#c218a5")  # applied forces, reactions, contact forces
BODIES = ("#4c78a8", "#72b7b2", "#eeca3b", "#b279a2", "#9d755d", "#54a24b", "#e08b3e", "#8cb4d9")
SLACK = "#e45756"
SUPERSAMPLING = 2.5  # widths of lines that look the same with and without it
MARGIN = 1.08  # of the image in space, over what is seen
LIGHT = {"ambient": 0.35, "smooth_shading": False}


@dataclass(frozen=True)
class Picture:
    """An image (rows, columns, 3) and, in the plane, the world rectangle (x0, x1, y0, y1) in m that it shows."""

    image: Array
    extent: tuple[float, float, float, float] | None


class Renderer:
    """A drawing on a canvas of its own: :meth:`add` instants, :meth:`turn_to` one of them, :meth:`image`."""

    def __init__(self, drawing: Drawing, view: View, *, size: tuple[int, int]) -> None:
        self.drawing, self.view, self.flat = drawing, view, drawing.dim == 2
        self.pv = pyvista()
        ensure_display()
        self.low, self.high = drawing.bounds()
        self.reach = float(np.linalg.norm(self.high - self.low)) or 1.0
        self.plotter = self.pv.Plotter(off_screen=True, window_size=list(size))
        self.plotter.set_background("white")
        self.shown: list[tuple[Piece, Any, Any, float]] = []
        self.edges: list[Any] = []

    # -- contents ------------------------------------------------------------------------------------------------
    def add(self, k: int, *, color: Any = None, lift: float = 0.0, opacity: float = 1.0, moving: bool = False) -> None:
        """Pieces at instant k, only those that move when asked; bodies in ``color`` where they are not painted, ``lift`` nearer
        to the eye (plane).
        """
        for piece in self.drawing.pieces:
            if moving and (piece.role is Role.GROUND or isinstance(piece.motion, Still)):
                continue
            # in the plane layers lie one above the other, or they would flicker
            depth = lift + (self.reach * (0.004 * piece.role.layer + 0.0004 * (piece.shade % 9)) if self.flat else 0.0)

            surface, lines = self._meshes(piece, k, depth)
            own = color if color is not None and piece.role is Role.BODY else color_of(piece, k)
            if surface is not None:
                self._surface(piece, surface, own, opacity)
            if lines is not None:
                self._lines(piece, lines, own, opacity)
            self.shown.append((piece, surface, lines, depth))

    def _meshes(self, piece: Piece, k: int, depth: float) -> tuple[Any, Any]:
        """Surface and edges of a piece at instant k."""
        points = self._points(piece, k, depth)
        surface = lines = None
        if len(piece.triangles):
            # VTK wants the number of corners before each cell
            faces = np.hstack((np.full((len(piece.triangles), 1), 3), piece.triangles)).ravel()
            surface = self.pv.PolyData(points, faces)
            if piece.paint is not None:
                surface.cell_data["paint"] = piece.paint[k]
        if len(piece.edges):
            chains = np.hstack((np.full((len(piece.edges), 1), 2), piece.edges)).ravel()
            lines = self.pv.PolyData(points + self._nearer(), lines=chains)
        return surface, lines

    def _points(self, piece: Piece, k: int, depth: float) -> Array:
        points = np.array(piece.at(k), dtype=float)
        if self.flat:
            points[:, 2] = depth
        return points

    def _nearer(self) -> Array:
        """Edges lie a little in front of their surface in the plane."""
        return np.array([0.0, 0.0, 0.0002 * self.reach if self.flat else 0.0])

    def _surface(self, piece: Piece, surface: Any, color: Any, opacity: float) -> None:
        lit = not self.flat and piece.paint is None  # a lit surface would not have the colours of the bar
        look: dict[str, Any] = {"opacity": opacity, "lighting": lit, **(LIGHT if lit else {})}
        if piece.role is Role.GROUND and not self.flat:
            look["opacity"] = 0.35 if piece.name.startswith("ground, grid") else 1.0
        if piece.paint is None:
            self.plotter.add_mesh(surface, color=color, **look)
            return

        look |= {"scalars": "paint", "clim": self.drawing.span, "cmap": "viridis", "show_scalar_bar": False}
        self.plotter.add_mesh(surface, **look)

    def _lines(self, piece: Piece, lines: Any, color: Any, opacity: float) -> None:
        bare = not len(piece.triangles)
        dark = color if bare else 0.4 * np.array(self.pv.Color(color).float_rgb)
        width = 3.0 if bare else 2.0 if self.flat else 1.0
        if piece.role is Role.GROUND:
            dark, width = "#8c8c8c", 1.0
        width *= self.plotter.window_size[0] / 800  # a large image is shown small
        self.edges.append(self.plotter.add_mesh(lines, color=dark, line_width=width, lighting=False, opacity=opacity))

    def turn_to(self, k: int) -> None:
        """Move all pieces to instant k."""
        for piece, surface, lines, depth in self.shown:
            points = self._points(piece, k, depth)
            if surface is not None:
                surface.points = points
                if piece.paint is not None:
                    surface.cell_data["paint"] = piece.paint[k]
            if lines is not None:
                lines.points = points + self._nearer()

    # -- the eye -------------------------------------------------------------------------------------------------
    def look(self) -> None:
        """Place the camera so that all instants are seen."""
        camera = self.plotter.camera
        middle = 0.5 * (self.low + self.high)

        # a plane scene is seen from the front, to scale
        if self.flat and self.view.camera is None:
            width, height = self.plotter.window_size
            w, h = (self.high - self.low)[:2] + 0.1 * self.reach
            self.plotter.enable_parallel_projection()
            camera.focal_point = (*middle[:2], 0.0)
            camera.position = (*middle[:2], 50 * self.reach)
            camera.up = (0.0, 1.0, 0.0)
            camera.parallel_scale = 0.5 * max(h, w * height / width) / self.view.zoom
            camera.clipping_range = (self.reach, 100 * self.reach)
            return

        # in space from obliquely above, unless a camera is given
        up = self.drawing.up
        side = np.eye(3)[int(np.argmin(np.abs(up)))]
        default = 0.3 * side + 0.35 * up + np.cross(side, up)
        eye = default if self.view.camera is None else np.asarray(self.view.camera, dtype=float)
        self.plotter.camera_position = [middle + eye, middle, up]

        box = np.column_stack((self.low, self.high)).ravel()
        self.plotter.reset_camera(bounds=tuple(box))
        camera.view_angle = self._angle(np.asarray(camera.position), middle, up) / self.view.zoom
        self.plotter.add_axes(line_width=3)

    def _angle(self, eye: Array, middle: Array, up: Array) -> float:
        """The angle of view, degrees from top to bottom, into which everything fits at all instants with a margin."""
        ahead = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(ahead, up)
        right /= np.linalg.norm(right)
        axes = np.stack((right, np.cross(right, ahead), ahead), axis=1)

        width, height = self.plotter.window_size
        half = 0.0
        for place in self.drawing.places():
            across, above, depth = ((place - eye) @ axes).T
            half = max(half, float((np.maximum(np.abs(across) * height / width, np.abs(above)) / depth).max()))
        return float(2.0 * np.degrees(np.arctan(MARGIN * (half or 0.25))))

    def image(self) -> Picture:
        """What is seen now."""
        self.plotter.render()
        image = np.asarray(self.plotter.screenshot(return_img=True))
        if not self.flat or self.view.camera is not None:
            return Picture(image, None)
        # what the axes beside the image have to say: half of the height is the camera's scale
        half_h = self.plotter.camera.parallel_scale
        half_w = half_h * image.shape[1] / image.shape[0]
        x, y = 0.5 * (self.low + self.high)[:2]
        return Picture(image, (x - half_w, x + half_w, y - half_h, y + half_h))

    def smooth(self) -> None:
        """Edges without steps: drawn larger and averaged, which thins lines by as much."""
        self.plotter.enable_anti_aliasing("ssaa")
        for actor in self.edges:
            actor.prop.line_width *= SUPERSAMPLING

    def close(self) -> None:
        """Free the canvas."""
        self.plotter.close()


def color_of(piece: Piece, k: int) -> Any:
    """The colour of a piece by its role, of bodies by their number."""
    if piece.flag is not None and piece.flag[k]:
        return SLACK
    if piece.role is Role.BODY:
        return BODIES[piece.shade % len(BODIES)]
    if piece.role is Role.ARROW:
        return ARROWS[piece.shade]
    return COLORS[piece.role]


def strobe(drawing: Drawing, view: View, colors: Sequence[Any] | None, width: int = 1600) -> Picture:
    """Several instants in one image, each body in the colour of its instant where it is not painted; rank 0."""
    low, high = drawing.bounds()
    reach = float(np.linalg.norm(high - low)) or 1.0
    w, h = (high - low)[:2] + 0.1 * reach
    # in the plane as high as the scene asks for, within limits
    height = round(width * h / w) if drawing.dim == 2 else round(0.8 * width)
    canvas = Renderer(drawing, view, size=(width, min(max(height, width // 4), 2 * width)))

    count = len(drawing.times)
    for k in range(count):
        flat = drawing.dim == 2
        last = k == count - 1
        color = None if colors is None else colors[k]
        # later instants lie above earlier ones; in space earlier ones are faint
        lift = 0.05 * reach * k if flat else 0.0
        canvas.add(k, color=color, lift=lift, opacity=1.0 if flat or last else 0.45, moving=not last)
    canvas.look()
    canvas.smooth()
    found = canvas.image()
    canvas.close()
    return found


def pyvista() -> Any:
    """The library that draws; refused where it is not installed."""
    try:
        import pyvista as pv
    except ImportError as error:
        raise InputError("A picture needs pyvista: install fmbd_fenicsx[plot].") from error
    return pv


def ensure_display() -> None:
    """Give VTK before 9.4, which draws only through X, an X server that ends with this process; nothing where there is one."""
    import vtk

    version = tuple(int(p) for p in vtk.vtkVersion().GetVTKVersion().split(".")[:2])
    have = shutil.which("Xvfb") and shutil.which("setpriv")
    if version >= (9, 4) or os.environ.get("DISPLAY") or not have:
        return

    display = f":{1000 + os.getpid() % 50000}"  # its own: two servers that start together must not claim one
    read, write = os.pipe()
    screen = ["-screen", "0", "1600x1200x24", "-nolisten", "tcp", "-noreset"]
    subprocess.Popen(
        ["setpriv", "--pdeathsig", "TERM", "Xvfb", display, "-displayfd", str(write), *screen],
        pass_fds=(write,),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    os.close(write)
    with os.fdopen(read) as ready:  # a whole line: the server ends when it cannot write all of it
        if ready.readline().strip():
            os.environ["DISPLAY"] = display
