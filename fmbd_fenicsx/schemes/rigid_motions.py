"""What nodes of rods do beside the rigid motion of their rod: deformations, which error norms measure in another way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..rotations import Array, hat
from ..system.layout import State
from ..system.system import System


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """The rigid motions of rods as they lie: velocities of their nodes by least squares, V + W x (x - mean) and W,

    where rotations count by a hundredth of the rod's size: sections turn against the rod with little inertia.

    ``bases``: numbers in v of a rod's nodes (n,), their weights (n,), and an orthonormal basis (n, 6) of its weighted motions.
    """

    ARM: ClassVar[float] = 1e-2
    bases: tuple[tuple[np.ndarray, Array, Array], ...]

    @staticmethod
    def at(system: System, state: State) -> RigidMotions:
        """Of all rods in a state."""
        ev = system.at(state.t, state.q)
        bases = []
        for elements in system.elements:
            frames = np.unique(elements.frames)
            arms = ev.pose[frames, :3] - ev.pose[frames, :3].mean(axis=0)
            size = float(np.abs(arms).max())
            motions = np.zeros((len(frames), 6, 6))
            motions[:, :3, :3], motions[:, :3, 3:] = np.eye(3), -hat(arms)
            motions[:, 3:, 3:] = np.swapaxes(ev.rotation[frames], 1, 2)  # rotations stand in body axes
            weights = np.tile([1.0, 1.0, 1.0, *[RigidMotions.ARM * size] * 3], len(frames))
            basis = np.linalg.qr(weights[:, None] * motions.reshape(-1, 6))[0]
            bases.append(((6 * frames[:, None] + np.arange(6)).ravel(), weights, basis))
        return RigidMotions(tuple(bases))

    def rest(self, v: Array) -> Array:
        """What velocities (..., n_v) have beside the rigid motions of the rods; zero on all other bodies."""
        out = np.zeros_like(v)
        for at, weights, basis in self.bases:
            own = weights * v[..., at]
            out[..., at] = (own - own @ basis @ basis.T) / weights
        return out
