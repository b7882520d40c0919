"""Forces that Python evaluates as a whole, tyres and laws of the motion of two markers, in the driver's tables (whole.c)."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from .....mechanics.forces.force_elements import Loads
from .....mechanics.frames import Kinematics
from .....rotations import Array
from ...declarations import enumeration
from ..places import rates_of, square_places
from ..structures import structure

if TYPE_CHECKING:
    from ..layout import TableLayout

MOST_STAGES = enumeration("MOST_STAGES")["MOST_STAGES"]
WHOLE = enumeration("ROW")["WHOLE"]  # the role


class WholeLoads:
    """Forces of one kind. C gives their markers' motions, Python the wrenches on these and, when asked, the slopes.

    ``batch``: the structure Batch. ``sight`` (markers, d + d^2 + n): x, R and twist; ``push`` (m, 2 n): wrenches on both markers;
    ``K``, ``B`` (m, 2 n, 2 n): over their displacements and velocities, n = d + n_rot; world axes.
    """

    def __init__(self, tables: TableLayout, loads: Loads, number: int) -> None:
        store, d, n = tables.store, tables.dim, tables.twist
        pairs = np.stack((loads.a, loads.b), axis=1).astype(int)
        count = len(loads.a)
        used, local = np.unique(pairs, return_inverse=True)
        local = local.reshape(count, 2)

        self.dim, self.loads = d, copy(loads)  # with the numbers of its own markers alone
        self.loads.a, self.loads.b = local.T
        self.sight, sight = store.array(np.zeros((len(used), d + d * d + n)))
        self.push, push = store.array(np.zeros((count, 2 * n)))
        self.K, K = store.array(np.zeros((count, 2 * n, 2 * n)))
        self.B, B = store.array(np.zeros((count, 2 * n, 2 * n)))
        self.known, known = store.array(np.zeros((count, 2 * self.sight.shape[1] + 2 * n)))
        self.sees = self.sight.size
        self.ahead, ahead = store.array(np.zeros((MOST_STAGES, 1 + self.sees + self.push.size)))
        self.astray, astray = store.array([1], np.int32)

        frames = tables.frame[pairs]
        frames[pairs[:, 0] == pairs[:, 1], 1] = tables.nb
        self.batch = structure("Batch", d)(
            role=WHOLE, n=count, number=number, mapped=1, P=store.address(self._constants(tables, pairs)),
            pair=store.integers(frames), at=store.integers(tables.twist_places(frames).reshape(count, -1)),
            marker=store.integers(local), known=known,
            sight=sight, push=push, K=K, B=B, astray=astray, ahead=ahead, sees=self.sees, answers=self.push.size,
            **square_places(tables, store, rates_of(tables, frames)),
        )  # fmt: skip

    @staticmethod
    def _constants(tables: TableLayout, pairs: np.ndarray) -> np.ndarray:
        """Places and turns of the markers in their frames, (m, 2 (d + d^2)); surfaces are frames themselves."""
        markers, count = tables.system.markers, len(pairs)
        on_surface = (tables.frame[pairs] > tables.nb)[..., None]
        place = np.where(on_surface, 0.0, markers.position[pairs])
        turn = markers.rotation[pairs].reshape(count, 2, -1)
        return np.concatenate((place, turn), axis=2).reshape(count, -1)

    def _kinematics(self, sight: Array) -> Kinematics:
        """The markers as C placed them, of a copy: laws may change what they are given."""
        d = self.dim
        none = np.zeros((len(sight), 0, 0))
        kin = Kinematics(sight[:, :d], sight[:, d : d + d * d].reshape(-1, d, d), none, none)
        kin.twist = sight[:, d + d * d :]
        return kin

    @property
    def memory(self) -> np.ndarray:
        """The slopes, with the state where they were last compared."""
        return np.concatenate((self.astray, self.known.ravel(), self.K.ravel(), self.B.ravel()))

    def recall(self, memory: np.ndarray) -> None:
        """Take a :attr:`memory`."""
        at = 1
        self.astray[0] = int(memory[0])
        for x in (self.known, self.K, self.B):
            x.ravel()[:] = memory[at : at + x.size]
            at += x.size

    def wrenches(self, t: float) -> None:
        """Wrenches on both markers of each force."""
        n = self.push.shape[1] // 2
        self.push[:, :n], self.push[:, n:] = self.loads.wrenches(self._kinematics(self.sight.copy()), t)

    def wrenches_ahead(self, count: int) -> None:
        """The same at so many points of a step."""
        points = self.ahead[:count]
        sights = points[:, 1 : 1 + self.sees].copy().reshape(count, *self.sight.shape)
        kins = [self._kinematics(sight) for sight in sights]
        on_both = self.loads.wrenches_at(kins, list(map(float, points[:, 0])))
        points[:, 1 + self.sees :] = np.concatenate(on_both, axis=2).reshape(count, -1)

    def slopes(self, t: float) -> None:
        """K and B of the state evaluated last."""
        tangent = self.loads.tangent(self._kinematics(self.sight.copy()), t)
        if tangent is not None:
            self.K[:], self.B[:] = tangent.K, tangent.D
