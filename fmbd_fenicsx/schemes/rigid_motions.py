"""What nodes of rods and frames of elastic bodies do beside rigid motions: deformations, which error norms measure apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..rotations import Array, hat
from ..system.layout import State
from ..system.system import System


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """The rigid motions of rods as they lie: velocities of their nodes by least squares, V + W x (x - mean) and W,

    where rotations count by a hundredth of the rod's size: sections turn against the rod with little inertia.

    A frame that hangs on a part of its body moves with the vibrations of that part. With its twist V and the mean twist T u' of
    the body's mass in it, the mass moves by V + T u': of each component the smaller one of both is a rigid motion.

    ``bases``: numbers in v of a rod's nodes (n,), their weights (n,), and an orthonormal basis (n, 6) of its weighted motions.
    ``frames``: places in v of a frame and of what is local in it, its rotation (d, d), and the part.
    """

    ARM: ClassVar[float] = 1e-2
    bases: tuple[tuple[np.ndarray, Array, Array], ...]
    frames: tuple[tuple[slice, slice, Array, Any], ...]

    @staticmethod
    def differ(system: System) -> bool:
        """Whether a system has bodies with such deformations."""
        return bool(system.elements) or any(p.mean_rates is not None for p in system.parts)

    @staticmethod
    def at(system: System, state: State) -> RigidMotions:
        """Of all rods and frames in a state."""
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
        return RigidMotions(tuple(bases), RigidMotions.of_frames(system, state).frames)

    @staticmethod
    def of_frames(system: System, state: State) -> RigidMotions:
        """Of all frames that hang on a part of their body, without rods."""
        width, in_v = system.motions.n_twist, system.slices[1]
        hanging = [(k, p) for k, p in enumerate(system.parts) if p.mean_rates is not None]
        turns: Any = system.at(state.t, state.q).rotation if hanging else ()
        return RigidMotions(
            (), tuple((slice(width * p.frame, width * (p.frame + 1)), in_v[k], turns[p.frame], p) for k, p in hanging)
        )

    def rest(self, v: Array) -> Array:
        """What velocities or small ways (..., n_v) have beside those of rigid bodies, zero elsewhere; collective with fields."""
        out = np.zeros_like(v)
        for at, weights, basis in self.bases:
            own = weights * v[..., at]
            out[..., at] = (own - own @ basis @ basis.T) / weights
        for frame, local, R, part in self.frames:
            mean = v[..., local] @ part.mean_rates.T
            if part.distributed:
                mean = part.field.total(mean)
            mean[..., : len(R)] = mean[..., : len(R)] @ R.T
            out[..., frame] = np.where(np.abs(v[..., frame] + mean) < np.abs(v[..., frame]), -mean, 0.0)
        return out
