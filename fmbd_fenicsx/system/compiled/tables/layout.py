"""What stands where in the tables of one system: bodies and rows among the unknowns of C, markers in its frames."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from ....rotations import Array
from ...system import System
from ..order import Fronts
from ..recording import Looks
from .items.items import FORMULA, Items
from .items.tied import TiedPoints
from .matrix_structure import Structure
from .resting import twin_of
from .structures import Store

ONE_SIDED = ("dead", "couple", "follower", "follower_couple")


class TableLayout:
    """The places that all parts of the tables are made with; ``c`` is the driver's System, the parts' ``arrays`` those that C
    reads and writes, ``sources`` the items behind its first batches.
    """

    modes: np.ndarray  # of the bodies
    width: np.ndarray  # of the bodies' blocks
    at_u: np.ndarray  # where they begin among the unknowns
    nu: int
    rows: int
    surfaces: np.ndarray  # markers on surfaces that something acts on, each a frame behind the ground
    frame: np.ndarray  # of all markers
    nothing: int  # place of what the ground would have
    held: dict[int, np.ndarray]  # bodies on whose attitude nothing but rows of their own acts, and these, see apart.py
    structure: Structure
    fronts: Fronts
    sources: list[Items]
    arrays: dict[str, Array]
    c: Any  # the structure System

    def __init__(self, system: System) -> None:
        self.twin = twin_of(system)
        self.tied = TiedPoints(self.twin.system)
        # with a frame for each absolute body, and with what ties see of bodies among the markers
        self.system = system = self.tied.system
        self.store = Store()
        self.dim = system.motions.dim
        self.nb = system.n_frames
        self.twist = system.motions.n_twist
        reduced: tuple[Any, ...] = system.parts
        self.parts: dict[int, tuple[int, Any]] = {p.frame: (k, p) for k, p in enumerate(reduced)}
        self.floating: dict[int, Any] = {}  # the tables of fields, by their frames
        self.looks = Looks(system)
        self.maps: list[Array] = []  # of surfaces: twist from the rates of the body

    def _lay_out(self) -> None:
        """Widths of the bodies' blocks and where they begin; the rows come behind."""
        modes = [self.parts[b][1].n if b in self.parts else 0 for b in range(self.nb)]
        for frame, field in self.floating.items():
            modes[frame] = field.count
        self.modes = np.array(modes, dtype=int)
        self.width = self.twist + self.modes
        self.at_u = np.cumsum(self.width) - self.width
        self.nu, self.rows = int(self.width.sum()), self.system.n_lam

    @property
    def formulas(self) -> int:
        """How many efforts are by formulas with a name."""
        return sum([len(items) for items in self.sources if items.role == FORMULA])

    @cached_property
    def sampled(self) -> list[Any]:
        """Items whose efforts stay the same between samples."""
        return [items for items in self.sources if items.sampled is not None]

    def _place_surfaces(self, used: np.ndarray) -> None:
        """The markers on surfaces among those that something acts on."""
        mk = self.system.markers
        self.surfaces = np.intersect1d(used, mk.surface).astype(int) if mk.surface.size else np.zeros(0, int)
        self.frame = mk.frame.copy()
        self.frame[self.surfaces] = self.nb + 1 + np.arange(len(self.surfaces))
        self.nothing = self.nu + self.twist * len(self.surfaces)

    def body_of(self, frame: np.ndarray) -> np.ndarray:
        """The body of frames, -1 for the ground."""
        on = np.append(np.arange(self.nb), -1)
        on = np.append(on, self.system.markers.frame[self.surfaces])
        return np.asarray(on[frame])

    def port_matrix(self, body: int) -> Array:
        """Rates of the ports of a body from those of its modes, (ports, modes)."""
        part: Any = self.floating.get(body) or self.parts[body][1]
        matrix: Array = part.port_matrix
        return matrix

    def twist_places(self, frame: np.ndarray) -> np.ndarray:
        """Places of the twists of frames in arrays of velocities, (..., n_twist)."""
        first = np.concatenate((self.at_u, [self.nothing], self.nu + self.twist * np.arange(len(self.surfaces))))
        places = first[frame][..., None] + np.arange(self.twist)
        return np.where((frame == self.nb)[..., None], self.nothing, places)

    def rates(self, frame: int) -> np.ndarray:
        """The unknowns that move a frame."""
        body = int(self.body_of(np.array(frame)))
        if body < 0:
            return np.zeros(0, int)
        width = self.twist if frame < self.nb else self.width[body]
        return np.asarray(self.at_u[body] + np.arange(width))

    def _frames_of(self, items: Items) -> np.ndarray:
        """Frames of both sides, (n, 2); loads have the ground for their first."""
        frames = self.frame[items.markers]
        if items.kind.name in ONE_SIDED:
            frames[:, 0] = self.nb
        return frames
