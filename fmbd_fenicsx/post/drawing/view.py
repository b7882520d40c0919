"""What a picture or animation shows of a run, and how: data that :meth:`Run.picture` and :meth:`Run.animate` take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from ...checks import check_fields, whole
from ...errors import require


@dataclass(frozen=True)
class Paint:
    """Colours of elastic bodies by a quantity, say von Mises' stress.

    Args:
        quantity: scalar UFL expression of the displacement u in the body's axes, as for :func:`fmbd_fenicsx.largest`.
        label: what the colour bar says, with the unit: "von Mises stress (Pa)".
        bodies: the bodies that it belongs to; all elastic ones on a mesh by default.
    """

    quantity: Callable[[Any], Any]
    label: str
    bodies: Sequence[Any] | None = None

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class View:
    """How a run is drawn.

    Args:
        camera: direction from the scene to the eye, (3,); by default along z in the plane, obliquely from above in space.
        up: direction that points up in the picture, (3,); against gravity by default.
        zoom: above 1 nearer, below 1 farther.
        instants: how many snapshots a picture shows at once, evenly spaced (an animation shows one at a time).
        forces: arrows of applied forces. reactions: arrows of the forces of joints on their second body.
        contact: arrows of contact forces, at every point that touches.
        floor: a patch of ground below the scene, in space with gravity.
        symbols: joints, drives, springs and dampers.
        size: of an animation, pixels wide and high.
    """

    camera: Sequence[float] | None = None
    up: Sequence[float] | None = None
    zoom: float = 1.0
    instants: int = 6
    forces: bool = False
    reactions: bool = False
    contact: bool = False
    floor: bool = True
    symbols: bool = True
    size: tuple[int, int] = (960, 540)

    def __post_init__(self) -> None:
        check_fields(self)
        require(len(self.size) == 2, f"View: size {self.size} must be two numbers, of pixels wide and high.")
        for pixels in self.size:
            whole("View: size", pixels, least=1)
        require(self.zoom > 0, f"View: zoom = {self.zoom} must be positive.")
        require(self.instants >= 1, f"View: instants = {self.instants} must be at least 1.")
        require(min(self.size) >= 64, f"View: size {self.size} must be at least 64 x 64 pixels.")
        for name, axis in (("camera", self.camera), ("up", self.up)):
            usable = axis is None or (len(axis) == 3 and any(axis))
            require(usable, f"View: {name} {axis} must have three components, not all zero.")
