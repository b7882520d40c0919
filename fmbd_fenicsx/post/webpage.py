"""An animation as one web page without any other file: the drawing as numbers, and a small viewer that draws it.

Points of deforming pieces are stored as 16-bit numbers over the box that they move in (1/65535 of it), all others as they are.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..rotations import Array
from .drawing.render import ARROWS, color_of
from .drawing.scene_graph import Deforming, MovingPoints, Piece, Role
from .plot import series_of

if TYPE_CHECKING:
    from .animation import Story

MOST = 600  # points of a curve
VIEWER = Path(__file__).with_name("viewer.html")


def page(story: Story) -> str:
    """The page as text; rank 0."""
    data = json.dumps(_content(story), separators=(",", ":"))
    text = VIEWER.read_text(encoding="utf-8")

    return text.replace("{{title}}", html.escape(story.drawing.title)).replace("{{data}}", data.replace("</", "<\\/"))


def _content(story: Story) -> dict[str, Any]:
    drawing = story.drawing
    low, high = drawing.bounds()
    chosen = story.frames
    camera = story.view.camera

    return {
        "title": drawing.title,
        "dim": drawing.dim,
        "up": _numbers(drawing.up),
        "camera": None if camera is None else [float(x) for x in camera],
        "low": _numbers(low),
        "high": _numbers(high),
        # the frames of the animation
        "times": [float(drawing.times[k]) for k in chosen],
        "seconds": story.seconds,
        "pace": story.pace,
        "zoom": float(story.view.zoom),
        "label": drawing.label,
        "arrows": [{"text": s.text, "color": ARROWS[s.shade]} for s in drawing.scales],
        "span": drawing.span,
        "colors": _viridis(),
        # what is drawn
        "pieces": [_piece(p, chosen) for p in drawing.pieces],
        "curves": [_curve(story, name) for name in story.sensors],
    }


def _piece(piece: Piece, chosen: list[int]) -> dict[str, Any]:
    made: dict[str, Any] = {
        "name": piece.name,
        "role": piece.role.value,
        "layer": piece.role.layer + 0.09 * (piece.shade % 9),
        "color": str(color_of(piece, 0)),
        "faint": piece.role is Role.GROUND and piece.name.startswith("ground, grid"),
        "triangles": _packed(piece.triangles, "<u4"),
        "edges": _packed(piece.edges, "<u4"),
    }

    motion = piece.motion
    if isinstance(motion, Deforming):
        x = motion.points[chosen]
        # 16 bits for each number, over the box that it moves in
        low = x.min((0, 1))
        size = np.maximum(np.ptp(x, axis=(0, 1)), 1e-300)
        made |= {"low": _numbers(low), "size": _numbers(size)}
        made["deforming"] = _packed(np.round((x - low) / size * 65535), "<u2")
    elif isinstance(motion, MovingPoints):
        made["points"] = _packed(motion.points, "<f4")
        places = np.concatenate((motion.matrix[chosen].reshape(-1, 9), motion.origin[chosen]), axis=1)
        made["places"] = _packed(places, "<f4")
    else:
        made["points"] = _packed(motion.at(0), "<f4")

    if piece.paint is not None:
        made["paint"] = _packed(piece.paint[chosen], "<f4")
    if piece.flag is not None:
        made["flag"] = [bool(piece.flag[k]) for k in chosen]
    return made


def _curve(story: Story, name: str) -> dict[str, Any]:
    labels, values, unit = series_of(story.run, name)
    every = max(len(values) // MOST, 1)
    return {
        "name": f"{name} ({unit})",
        "labels": labels,
        "times": _numbers(story.run.times[::every]),
        "values": [_numbers(x) for x in values[::every].T],
    }


def _numbers(x: Array) -> list[float]:
    return [float(f"{v:.7g}") for v in np.asarray(x, dtype=float).ravel()]


def _packed(x: Any, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(x, dtype=kind).tobytes()).decode("ascii")


def _viridis() -> list[list[int]]:
    """Sixteen colours of the colour map that figures use, 0 ... 255."""
    import matplotlib

    return [[int(255 * c) for c in matplotlib.colormaps["viridis"](k / 15)[:3]] for k in range(16)]
