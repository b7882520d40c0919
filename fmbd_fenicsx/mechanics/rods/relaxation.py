"""Viscoelastic sections: springs in series with dashpots (Maxwell), beside the elastic law.

    S = dW/de + sum_k C_k (e - a_k),      a_k' = (e - a_k) / tau_k                                                  (1)

e are the strains, a_k those of the dashpots: the memory of the rod, changed by accepted steps only. Within a step from t_n the
strains are taken as linear in time, for which (1) has the exact solution

    a(t) = E a_n + (1 - E) e_n + f (e(t) - e_n),     E = exp(-x),   f = 1 - (1 - E) / x,   x = (t - t_n) / tau      (2)

a function of the configuration and of what was kept at t_n: of second order in every scheme, and stable for any tau, since
0 <= f <= 1. Source: Taylor, Pister and Goudreau, doi:10.1002/nme.1620020106.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...rotations import Array


@dataclass(frozen=True)
class ArmMemory:
    """Strains (m, q, 6) and those of the dashpots (arms, m, q, 6) at the time t (s); the same of the step before."""

    t: float
    strain: Array
    inner: Array
    before: ArmMemory | None = None

    def at(self, t: float) -> ArmMemory:
        """What a time is counted from: times between two steps belong to the earlier one."""
        return self if t >= self.t or self.before is None else self.before

    def followed_by(self, t: float, strain: Array, inner: Array) -> ArmMemory:
        """The memory after a step."""
        return ArmMemory(t, strain, inner, replace(self, before=None))


@dataclass(frozen=True, eq=False)
class Arms:
    """The arms of all Gauss points: stiffness ``C`` (arms, m, q, 6, 6) and times ``tau`` (arms,), s."""

    C: Array
    tau: Array

    def relaxed(self) -> ArmMemory:
        """No force in any arm, whatever the strains: at rest since ever."""
        zero = np.zeros(self.C.shape[:-1])
        return ArmMemory(-np.inf, zero[0], zero)

    def _shares(self, kept: ArmMemory, t: float) -> tuple[Array, Array]:
        """E and f of (2), (arms, 1, 1, 1)."""
        x = (t - kept.t) / self.tau
        E = np.exp(-x)
        mean = np.where(x > 0, -np.expm1(-x) / np.where(x > 0, x, 1.0), 1.0)
        return E[:, None, None, None], 1.0 - mean[:, None, None, None]

    def inner(self, memory: ArmMemory, t: float, e: Array) -> Array:
        """Strains of the dashpots at time t under strains e (m, q, 6), (arms, m, q, 6); (2)."""
        kept = memory.at(t)
        E, f = self._shares(kept, t)
        found: Array = E * kept.inner + (1.0 - E) * kept.strain + f * (e - kept.strain)
        return found

    def stress(self, memory: ArmMemory, t: float, e: Array) -> Array:
        """Forces of all arms together, (m, q, 6)."""
        return np.asarray(self._forces(e - self.inner(memory, t, e)).sum(0))

    def tangent(self, memory: ArmMemory, t: float) -> Array:
        """Derivative of :meth:`stress` by e, (m, q, 6, 6)."""
        _, f = self._shares(memory.at(t), t)
        return np.asarray(((1.0 - f)[..., None] * self.C).sum(0))

    def energy(self, memory: ArmMemory, t: float, e: Array) -> Array:
        """Energy in the springs, J/m, (m, q)."""
        stretch = e - self.inner(memory, t, e)
        return np.asarray(0.5 * (stretch * self._forces(stretch)).sum((0, -1)))

    def loss(self, memory: ArmMemory, t: float, e: Array) -> Array:
        """Power turned into heat in the dashpots, W/m, (m, q)."""
        stretch = e - self.inner(memory, t, e)
        return np.asarray((stretch * self._forces(stretch) / self.tau[:, None, None, None]).sum((0, -1)))

    def _forces(self, stretch: Array) -> Array:
        """Forces of the springs, (arms, m, q, 6)."""
        return np.asarray((self.C @ stretch[..., None])[..., 0])
