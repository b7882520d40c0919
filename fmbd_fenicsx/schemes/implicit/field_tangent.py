"""The tangent of implicit steps with elastic fields, known by its action: derivatives at one motion, by one evaluation more.

Differences along a direction have the length that velocities and accelerations ask for as well as places.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.system import System
from ..dae import Form
from .stage_pressures import StagePressures

SHIFT = float(np.sqrt(np.finfo(float).eps))  # of a difference quotient, over the model's length


@dataclass(frozen=True, eq=False)
class FieldTangent:
    """The motion at which derivatives are taken, and the balance and rows there, (n_v + levels n_lam,)."""

    system: System
    form: Form
    state: State
    ev: Evaluation
    low: Array
    pressures: StagePressures

    def along(self, dq: Array, dv: Array, da: Array) -> Array:
        """Derivative of balance and rows along (dq, dv, da), one direction or many in one evaluation, complex ones by their two
        parts; collective.
        """
        system, s = self.system, self.state
        direction = np.array((dq, dv, da))
        parts = direction if direction.ndim == 3 else direction[:, None]
        count, wide = parts.shape[1], direction.dtype.kind == "c"
        if wide:
            parts = np.concatenate((parts.real, parts.imag), axis=1)

        sizes = system.each_max_abs(parts)
        eps = np.array([[self._shift(*map(float, each))] for each in sizes.T])

        ev = system.batch(s.t, system.compose(s.q, eps * parts[0]), s.v + eps * parts[1])
        lam = np.array([s.lam] * len(eps))
        a = s.a + eps * parts[2]
        with self.pressures.held(self.pressures.start):
            change = (self.form.lower(ev.balance(a, lam), ev, a) - self.low) / eps
        if self.pressures.fields and sizes[0].any():
            change[:, : system.n_v] += self.pressures.stiffness(parts[0])

        if wide:
            change = change[:count] + 1j * change[count:]
        return change if direction.ndim == 3 else change[0]

    def _shift(self, place: float, speed: float, push: float) -> float:
        """The length of a difference along a direction with parts of these sizes; collective."""
        system, s = self.system, self.state
        if place == speed == 0.0:  # linear: as large as the accelerations that they are added to
            return (system.max_abs(s.a) or 1.0) / (push or 1.0)
        # lengths: positions, and what velocities move within the time in which they change
        return SHIFT * system.length / max(place, speed**2 / max(push, 1e-300))

    @cached_property
    def turnings(self) -> Array:
        """Derivatives of rate(xi, v) by xi at xi = 0, frame by frame: (frames, n_twist, n_twist)."""
        system, count = self.system, self.system.motions.n_twist
        frames, k = system.n_frames, system.n_frames * count
        if system.motions.dim == 2 or not frames:
            return np.zeros((frames, count, count))
        one = np.zeros((count, system.n_v))
        one[:, :k] = np.tile(1e-6 * np.eye(count), frames)

        slopes = (system.rate(one, self.state.v) - system.rate(-one, self.state.v)) / 2e-6
        return np.asarray(slopes[:, :k].reshape(count, frames, count).transpose(1, 2, 0))

    def turning(self, d: Array) -> Array | float:
        """Derivative of rate(xi, v) along d (.., n_v) at xi = 0; not collective."""
        system, k = self.system, self.system.n_frames * self.system.motions.n_twist
        if system.motions.dim == 2 or not k:
            return 0.0
        found = np.zeros_like(d)
        turned = self.turnings @ d[..., :k].reshape(*d.shape[:-1], system.n_frames, -1, 1)
        found[..., :k] = turned.reshape(*d.shape[:-1], k)
        return found
