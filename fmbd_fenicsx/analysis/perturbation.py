"""Small motions about a steady state: the exact matrices M, C, K of a whole scene as operators.

Axes turn with the steady spin, so coefficients are constant. With y small increments of the configuration,

    v = v_0 + y' + B y,      a = a_0 + y'' + B_1 y' + B_2 y                                                   (1)

    translations   B = W~,  B_1 = 2 W~,  B_2 = W~ W~        rotations (body axes)   B = B_1 = w~,  B_2 = 0

and none of them for coordinates in body axes. The residual r of the balance, linear in a, then gives

    M y'' + C y' + K y + G^T lambda = f,     G y = 0                                                          (2)

by central differences of fourth order along y: stress, reactions, weights, spins and springs stiffen as in the equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..rotations import Array
from ..system.system import State, System
from .steady import Spin

SHIFT = 1e-4  # of a difference, over the model's length
SIDES = ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0))  # weights over 12 h


@dataclass(frozen=True, eq=False)
class Perturbation:
    """The operators of (2) at a state; products are collective."""

    system: System
    state: State
    spin: Spin | None = None

    def stiffness(self, y: Array) -> Array:
        """K y, like v."""
        return self._difference(y, (y, self._turned(y), self._turned_twice(y)))

    def damping(self, rate: Array) -> Array:
        """C y', like v: dampers, gyroscopic terms."""
        return self._difference(rate, (None, rate, self._coriolis(rate)))

    def mass(self, accel: Array) -> Array:
        """M y'', like v."""
        s = self.state
        return self._here.balance(s.a + accel, s.lam) - self._balance

    def rows(self, y: Array) -> Array:
        """G y, (n_lam,)."""
        return self._here.jacobian.times(y)

    @cached_property
    def _here(self):  # type: ignore[no-untyped-def]
        s = self.state
        return self.system.at(s.t, s.q, s.v)

    @cached_property
    def _balance(self) -> Array:
        return self._here.balance(self.state.a, self.state.lam)

    def residual(self) -> Array:
        """What is left of the balance at the state, like v: zero in a steady motion."""
        return self._balance

    # -- differences ------------------------------------------------------------------------------------------------
    def _difference(self, along: Array, moved: tuple[Array | None, Array, Array]) -> Array:
        """Derivative of the balance for increments (q, v, a)."""
        size = self.system.max_abs(along)
        if size == 0.0:
            return np.zeros_like(along)
        h, s, (y, v, a) = SHIFT * self.system.length / size, self.state, moved
        total: Array = np.zeros_like(along)
        for side, weight in SIDES:
            e = side * h
            q = s.q if y is None else self.system.compose(s.q, e * y)
            ev = self.system.at(s.t, q, s.v + e * v)
            total += weight * ev.balance(s.a + e * a, s.lam)
        return total / (12.0 * h)

    def _turned(self, y: Array) -> Array:
        return self._spun(y, 1.0, 1.0)

    def _turned_twice(self, y: Array) -> Array:
        return self._spun(self._spun(y, 1.0, 0.0), 1.0, 0.0)

    def _coriolis(self, y: Array) -> Array:
        return self._spun(y, 2.0, 1.0)

    def _spun(self, y: Array, translation: float, rotation: float) -> Array:
        """W~ times translations and w~ times rotations of an array like v, each with its factor."""
        out = np.zeros_like(y)
        if self.spin is None:
            return out
        s, d, n = self.system, self.system.motions.dim, self.system.motions.n_twist
        W, k = self.spin.matrix(d), self.system.n_frames * self.system.motions.n_twist
        twists, turned = y[:k].reshape(-1, n), np.zeros((s.n_frames, n))
        turned[:, :d] = translation * twists[:, :d] @ W.T
        if d == 3:
            spins = self.state.v[:k].reshape(-1, n)[:, 3:]
            turned[:, 3:] = rotation * np.cross(spins, twists[:, 3:])
        out[:k] = turned.ravel()
        for i, p in s.fields:
            if p.frame == s.n_frames:
                out[s.slices[1][i]] = (translation * s.local_v(y, i).reshape(-1, d) @ W.T).ravel()
        return out
