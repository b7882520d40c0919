"""Parts that the driver asks Python about (``driver/bodies/told.c``): lines, loaded reduced bodies, the user's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .....mechanics.placements import FrameMotion, Part
from .....mechanics.reduction.reduced import ReducedPart
from .....rotations import Array
from ...declarations import enumeration
from ..resting import RestingPart
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout


def is_told(part: Any) -> bool:
    """Whether Python tells the forces of a part: of replicated ones all but those of reduced bodies that nothing loads."""
    return not part.distributed and (type(part) is not ReducedPart or bool(part.constants.loads))


def can_be_told(part: Any) -> bool:
    """Whether the driver takes such a part: with ports that are constant rows of its coordinates."""
    own = type(part.part if isinstance(part, RestingPart) else part)
    constant = own.ports_of is Part.ports_of and own.port_force is Part.port_force
    return constant and part.shortening is None


MOST_STAGES = enumeration("MOST_STAGES")["MOST_STAGES"]


class ToldMotion:
    """The motion of a part with n coordinates, as C leaves it in ``state``; ``address``: of this array."""

    def __init__(self, tables: TableLayout, n: int) -> None:
        d, twist, pose = tables.dim, tables.twist, tables.system.motions.n_pose
        sizes = (d * d, twist, twist, pose, d, n, n, n)
        self.state, self.address = tables.store.array(np.zeros(sum(sizes)))
        R, *self._frame, self._u, self._rate, self._second = np.split(self.state, np.cumsum(sizes)[:-1])
        self._R = R.reshape(d, d)

    def at(self, t: float) -> tuple[FrameMotion, Array, tuple[Array, Array, Array]]:
        """Motion and pose of the frame, and the coordinates with two rates, which may be kept."""
        twist, accel, pose, gravity = self._frame
        return FrameMotion(t, self._R, twist, accel, gravity), pose, (self._u.copy(), self._rate.copy(), self._second)


def _beside_rest(n: int, mass: Array, held: float = 1.0) -> Array:
    """The block of a part beside that of a frame with n rates, which rests."""
    block = np.zeros((n + len(mass), n + len(mass)))
    block[range(n), range(n)] = held
    block[n:, n:] = mass
    return block


class ToldPart:
    """One such part, number ``k`` of the system, as the structure Told of ``driver/tables.h``."""

    def __init__(self, tables: TableLayout, number: int, k: int) -> None:
        self.tables, self.number, self.k = tables, number, k
        self.part: Any = tables.system.parts[k]
        self.rests = isinstance(self.part, RestingPart)
        n = self.part.n
        self.width = tables.twist + n
        self.motion = ToldMotion(tables, n)

        sizes = {"rows": self.width, "block": (self.width, self.width), "slopes": (2, n, n), "known": 3 * n}
        made = tables.store.zeros(sizes)
        self.rows, self.block, self.by_motion, _ = (x for x, _ in made.values())
        self.addresses = {name: address for name, (_, address) in made.items()}
        self._ahead, ahead = tables.store.array(np.zeros((MOST_STAGES, 1 + 4 * n)))
        if self.rests and self.part.together:
            self.addresses["ahead"] = ahead

        self._of_time, self._force = self.part.of_time, self.part.force
        self._told: Any = None  # the structure
        self._last: tuple[bytes, Array] | None = None  # motion and rows of forces, of a part that knows no time

    def forces(self, t: float) -> None:
        """Rows of the frame and of the coordinates."""
        last, known = self._last, self.motion.state.tobytes()
        if last is not None and last[0] == known:
            self.rows[:] = last[1]
            return

        motion, _, local = self.motion.at(t)
        self.rows[: self.tables.twist], self.rows[self.tables.twist :] = self._force(motion, local)
        if not self._of_time:
            self._last = known, self.rows.copy()

    def points(self) -> None:
        """Rows of the coordinates at the points of a step, by one call."""
        n, asked = self.part.n, self._ahead[: self._told.foretold]
        seen = asked.T[: 1 + 3 * n].copy()
        u, rate, second = seen[1 : 1 + n].T, seen[1 + n : 1 + 2 * n].T, seen[1 + 2 * n :].T
        asked[:, 1 + 3 * n :] = self.part.force_many(seen[0], (u, rate, second))

    def energies(self, t: float) -> None:
        """Kinetic, elastic and weight energy."""
        motion, pose, local = self.motion.at(t)
        self.rows[:3] = self.part.energies(motion, pose, local[:2])

    def slopes(self, t: float) -> None:
        """Derivatives of the rows by coordinates and by rates."""
        motion, _, local = self.motion.at(t)
        self.by_motion[:] = self.part.stiffness_blocks(motion, local)

    def tangents(self, t: float) -> None:
        """M + cd D + ck K, the frame in world axes; of an imaginary part without M."""
        d, n, c = self.tables.dim, self.tables.twist, self.tables.c
        motion, _, local = self.motion.at(t)
        of_frame, coupling, mass = ((1 - c.imaginary) * x for x in self.part.mass_blocks(motion, local[0]))
        if c.cd or c.ck:
            K, D = self.part.stiffness_blocks(motion, local)
            mass = mass + c.cd * D + c.ck * K
        if self.rests:
            self.block[:] = _beside_rest(n, mass, 1.0 - c.imaginary)
            return
        self.block[n:, n:] = mass

        turn = np.eye(n)
        if d == 3:
            turn[d:, d:] = motion.R
        self.block[:n, :n] = turn @ of_frame @ turn.T
        self.block[n:, :n] = coupling @ turn.T

    def body(self, rigid: Any) -> Any:
        """The structure Body, of a rigid body on the same frame (None: there is none) and the part."""
        tables, system = self.tables, self.tables.system
        frame = self.part.frame
        body = structure("Body", tables.dim)(large=np.inf) if rigid is None else rigid
        mass = self.part.constant_mass if self.rests else None
        masses = None if mass is None else tables.store.address(_beside_rest(tables.twist, mass))
        i, j = np.tril_indices(self.width)
        unknown = tables.at_u[frame] + np.arange(self.width)
        told = self._told = structure("Told", tables.dim)(
            number=self.number, rests=int(self.rests), state=self.motion.address, masses=masses, **self.addresses,
            dest=tables.store.integers(tables.fronts.place(unknown[i], unknown[j])),
        )  # fmt: skip

        body.modes, body.at_u, body.told = self.part.n, int(tables.at_u[frame]), tables.store.structure(told)
        body.at_q, body.at_v = system.slices[0][self.k].start, system.slices[1][self.k].start
        return body
