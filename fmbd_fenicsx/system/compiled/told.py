"""Parts that the driver asks Python about: lines, and bodies of the user's own, see ``driver/told.c``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ...mechanics.placements import FrameMotion, Part
from ...mechanics.reduction.reduced import ReducedPart
from ...rotations import Array
from .resting import RestingPart
from .structures import structure

if TYPE_CHECKING:
    from .tables import Tables


def is_told(part: Any) -> bool:
    """Whether Python tells the forces of a replicated part."""
    return not part.distributed and type(part) is not ReducedPart


def can_be_told(part: Any) -> bool:
    """Whether the driver takes such a part: with ports that are constant rows of its coordinates."""
    constant = getattr(type(part), "ports_of", None) in (Part.ports_of, RestingPart.ports_of)
    return constant and part.shortening is None


def motion_in(state: Array, t: float, dim: int, n: int) -> tuple[FrameMotion, Array, tuple[Array, Array, Array]]:
    """Motion and pose of the frame of a part with n coordinates, and these with two rates, as C left them in ``state``."""
    twist, pose = (6, 7) if dim == 3 else (3, 3)
    R, velocity, accel, place, gravity, *local = np.split(state, np.cumsum([dim * dim, twist, twist, pose, dim, n, n]))
    motion = FrameMotion(t, R.reshape(dim, dim), velocity, accel, gravity)
    return motion, place, (local[0].copy(), local[1].copy(), local[2])


def motion_size(dim: int, n: int) -> int:
    """The size of ``state`` in :func:`motion_in`."""
    twist, pose = (6, 7) if dim == 3 else (3, 3)
    return dim * dim + 2 * twist + pose + dim + 3 * n


class ToldPart:
    """One such part, number ``k`` of the system, as the structure Told of ``driver/tables.h``."""

    def __init__(self, tables: Tables, number: int, k: int) -> None:
        self.tables, self.number, self.k = tables, number, k
        self.part: Any = tables.system.parts[k]
        self.rests = isinstance(self.part, RestingPart)
        self.width = tables.twist + self.part.n
        made = tables.store.zeros({
            "state": motion_size(tables.dim, self.part.n), "rows": self.width, "block": (self.width, self.width),
        })  # fmt: skip
        self.state, self.rows, self.block = (x for x, _ in made.values())
        self.addresses = {name: address for name, (_, address) in made.items()}

    def _motion(self, t: float) -> tuple[FrameMotion, Array, tuple[Array, Array, Array]]:
        return motion_in(self.state, t, self.tables.dim, self.part.n)

    def forces(self, t: float) -> None:
        """Rows of the frame and of the coordinates."""
        motion, _, local = self._motion(t)
        self.rows[: self.tables.twist], self.rows[self.tables.twist :] = self.part.force(motion, local)

    def energies(self, t: float) -> None:
        """Kinetic, elastic and weight energy."""
        motion, pose, local = self._motion(t)
        self.rows[:3] = self.part.energies(motion, pose, local[:2])

    def tangents(self, t: float) -> None:
        """M + cd D + ck K, the frame in world axes."""
        d, n, c = self.tables.dim, self.tables.twist, self.tables.c
        motion, _, local = self._motion(t)
        of_frame, coupling, mass = self.part.mass_blocks(motion, local[0])
        if c.cd or c.ck:
            K, D = self.part.stiffness_blocks(motion, local)
            mass = mass + c.cd * D + c.ck * K
        self.block[n:, n:] = mass
        if self.rests:
            self.block[range(n), range(n)] = 1.0
            return

        turn = np.eye(n)
        if d == 3:
            turn[d:, d:] = motion.R
        self.block[:n, :n] = turn @ of_frame @ turn.T
        self.block[n:, :n] = coupling @ turn.T

    def body(self, rigid: Any) -> Any:
        """The structure Body, of a rigid body on the same frame (None: there is none) and the part."""
        tables, system = self.tables, self.tables.system
        frame = self.part.frame
        body = structure("Body", tables.dim)(spin=np.inf, large=np.inf) if rigid is None else rigid
        i, j = np.tril_indices(self.width)
        unknown = tables.at_u[frame] + np.arange(self.width)
        told = structure("Told", tables.dim)(
            number=self.number, rests=int(self.rests), **self.addresses,
            dest=tables.store.integers(tables.fronts.place(unknown[i], unknown[j])),
        )  # fmt: skip

        body.modes, body.at_u, body.told = self.part.n, int(tables.at_u[frame]), tables.store.structure(told)
        body.at_q, body.at_v = system.slices[0][self.k].start, system.slices[1][self.k].start
        return body
