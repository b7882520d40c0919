"""A run as a drawing: its bodies where they are, what joins them, what they touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import InputError, require
from ...rotations import Array
from ...run.result import Run
from ...system.layout import State
from . import rods  # noqa: F401, registers what rods look like
from .bodies import LARGEST, pieces_of
from .connections import connection_pieces
from .places import Places, places
from .scene_graph import ArrowScale, Drawing, Piece, Role, Still
from .view import Paint, View

SYMBOL = 0.012  # size of joints, of the scene's
AT_REST = View()


def draw(
    run: Run, *, view: View = AT_REST, paint: Paint | None = None, states: Sequence[State] | None = None
) -> Drawing:
    """The drawing of what a run shows, or of the given states; collective, complete on rank 0 only.

    Raises:
        InputError: more triangles than can be drawn.
    """
    at = places(run, list(run.shown if states is None else states))
    up = direction_up(run, view)
    size = _size(at)
    symbol = SYMBOL * size

    pieces: list[Piece] = []
    for shade, body in enumerate(run.scene.bodies.values()):
        found = pieces_of(body, at, paint, symbol)
        pieces += [_shaded(piece, shade) for piece in found]
    number = sum(len(p.triangles) for p in pieces)
    if number > LARGEST:
        raise InputError(
            f"The surfaces have {number} triangles, too many for a picture: use run.save_fields() and ParaView."
        )
    if paint is not None:
        on = [p.name for p in pieces if p.paint is not None]
        require(
            bool(on), f'Nothing is painted with "{paint.label}": the scene has no elastic body on a mesh that it names.'
        )

    drawing = Drawing(run.scene.name, run.system.motions.dim, up, np.array([s.t for s in at.states]), tuple(pieces))
    if view.symbols:
        pieces += connection_pieces(at, symbol, up)
    bounds = _bounds(drawing, at)
    if run.scene.contacts:  # the shapes of contact are loaded by scenes that have one
        from .obstacles import obstacle_pieces

        pieces += obstacle_pieces(at, bounds)
    scales: tuple[ArrowScale, ...] = ()
    if view.forces or view.reactions or view.contact:
        from .arrows import arrow_pieces

        arrows, scales = arrow_pieces(at, view, size)
        pieces += arrows
    if view.floor and _floor_fits(run, pieces):
        pieces.append(_floor(bounds, up))
    label = "" if paint is None else paint.label
    return Drawing(drawing.title, drawing.dim, up, drawing.times, tuple(pieces), label, scales)


def direction_up(run: Run, view: View) -> Array:
    """The direction of the view, that against gravity, or y, (3,)."""
    if view.up is not None:
        given = np.asarray(view.up, dtype=float)
        return np.asarray(given / np.linalg.norm(given))
    g = run.system.gravity.usual if run.system.motions.dim == 3 else np.zeros(3)
    size = float(np.linalg.norm(g))
    return np.asarray(-g / size) if size > 0 else np.array([0.0, 1.0, 0.0])


def _shaded(piece: Piece, shade: int) -> Piece:
    from dataclasses import replace

    return replace(piece, shade=shade)


def _size(at: Places) -> float:
    """Diameter of the place in which frames and markers move, at least the model's length; equal on all ranks."""
    points = np.concatenate((at.frames[:, :-1].reshape(-1, 3), at.markers.reshape(-1, 3)))
    spread = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0

    return max(spread, float(at.run.system.length))


def _bounds(drawing: Drawing, at: Places) -> tuple[Array, Array]:
    """The box that bodies and markers stay in."""
    low, high = drawing.bounds()
    if at.markers.size:
        low = np.minimum(low, at.markers.reshape(-1, 3).min(0)) if drawing.pieces else at.markers.reshape(-1, 3).min(0)
        high = (
            np.maximum(high, at.markers.reshape(-1, 3).max(0)) if drawing.pieces else at.markers.reshape(-1, 3).max(0)
        )
    return low, high


def _floor_fits(run: Run, pieces: list[Piece]) -> bool:
    """In space, under gravity, without an obstacle that is a ground itself."""
    return (
        run.system.motions.dim == 3 and run.system.gravity.size > 0 and not any(p.role is Role.OBSTACLE for p in pieces)
    )


def _floor(bounds: tuple[Array, Array], up: Array) -> Piece:
    """A square below the scene with lines that show its scale."""
    from .solids import frame_of

    low, high = bounds
    corners = np.array(
        [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    reach = float(np.linalg.norm(high - low)) or 1.0
    middle = 0.5 * (low + high)
    below = float((corners @ up).min()) - 0.06 * reach
    middle = middle + (below - middle @ up) * up
    step = grid_step(reach)
    half = step * np.ceil(0.62 * reach / step)
    across = frame_of(up)

    lines = np.arange(-half, half + 0.5 * step, step)
    ends = [(a, b) for s in lines for a, b in (((s, -half), (s, half)), ((-half, s), (half, s)))]
    flat = np.array([(-half, -half), (half, -half), (half, half), (-half, half), *(p for pair in ends for p in pair)])
    points = middle + flat @ across[:, :2].T
    edges = 4 + np.arange(2 * len(ends)).reshape(-1, 2)
    triangles = np.array([(0, 1, 2), (0, 2, 3)])
    return Piece(f"ground, grid of {step:g} m", Role.GROUND, triangles, edges, Still(points))


def grid_step(reach: float) -> float:
    """A round length, 1, 2 or 5 times a power of ten, of about an eighth of the scene's size."""
    power = 10.0 ** np.floor(np.log10(reach / 8))

    return float(power * next(f for f in (1, 2, 5, 10) if f * power >= reach / 8))
