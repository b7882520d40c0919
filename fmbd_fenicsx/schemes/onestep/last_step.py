"""The last step of a collocation method, whose polynomial foretells the stages of the next one and gives states within it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ...system.layout import State
from ...system.serialisation import Memory
from ...system.system import System
from ..dae import Points
from .collocation import Tableau

Stages = tuple[Array, Array, Array]  # xi, v and multipliers of each


@dataclass(frozen=True)
class LastStep:
    """Its size h (s), q and v at its start, its stages, and whether they were nearer to a straight way than to the polynomial of
    the step before: it strays where vibrations are not resolved. Of many steps with these as first axis.
    """

    h: Any
    q: Array
    v: Array
    points: Points
    strays: Any = False

    def foretell(self, system: System, tab: Tableau, h: float, q: Array) -> Stages:
        """The stages of a step of size h (s) from its end, q, on."""
        powers = (1.0 + tab.c * h / self.h)[:, None] ** np.arange(len(tab.c) + 1)
        basis = (powers @ tab.basis)[:, 1:]
        ahead = basis @ self.points.xi
        moved = system.difference(q, system.compose(self.q, ahead), near=ahead - self.points.xi[-1])
        mult = powers[:, :-1] @ tab.stage_basis @ self.points.mult
        return moved, self.v + basis @ (self.points.v - self.v), mult

    def at(self, system: System, tab: Tableau, x: Array) -> tuple[Array, Array, Array, Array, Array]:
        """q, v, a, lambda and all multipliers at the share x of the step."""
        k, points = len(tab.c), self.points

        # values and slopes of the polynomial through the start and the stages
        powers = x[..., None] ** np.arange(k + 1)
        slopes = np.arange(k + 1) * np.roll(powers, 1, axis=-1) / np.asarray(self.h)[..., None]
        values, rates = ((y @ tab.basis)[..., None, 1:] for y in (powers, slopes))

        change = points.v - self.v[..., None, :]
        mult = (powers[..., None, :-1] @ tab.stage_basis @ points.mult)[..., 0, :]
        q = system.compose(self.q, (values @ points.xi)[..., 0, :])
        return q, self.v + (values @ change)[..., 0, :], (rates @ change)[..., 0, :], mult[..., : system.n_lam], mult


def keep_last(m: Memory, name: str, last: LastStep | None) -> LastStep | None:
    """For checkpoints, in an order that does not depend on the ranks."""
    m = m.inside(name)
    if not m("known", last is not None):
        return None
    h, q, v, p = (None,) * 4 if last is None else (last.h, last.q, last.v, last.points)
    stages = m("stages", 0 if p is None else len(p.xi))

    def rows(name: str, values: Array | None) -> Array:
        return np.array([m.like_v(f"{name} {i}", None if values is None else values[i]) for i in range(stages)])

    xi, rate, vs, vd = (rows(x, None if p is None else getattr(p, x)) for x in ("xi", "rate", "v", "vd"))
    points = Points(xi, rate, vs, vd, m("mult", None if p is None else p.mult))
    strays = bool(m("strays", last is not None and last.strays))
    return LastStep(m("h", h), m.like_q("q", q), m.like_v("v", v), points, strays)


@dataclass(frozen=True)
class StageStart:
    """Where a step begins: a state, its multipliers (n_mult,), and the step before, None after a new start."""

    state: State
    mult: Array
    last: LastStep | None

    def predict(self, system: System, tab: Tableau, h: float) -> Stages:
        """The stages of a step of size h (s): on the polynomial of the step before, on a straight way where that one strayed,
        on the parabola at a new start.
        """
        if self.last is not None and not self.last.strays:
            return self.last.foretell(system, tab, h, self.state.q)
        s, x = self.state, (tab.c * h)[:, None]
        a = s.a if self.last is None else np.zeros_like(s.a)
        xi = x * s.v + 0.5 * x * x * a
        return xi, s.v + x * a, np.repeat(self.mult[None], len(tab.c), axis=0)

    def strays(self, system: System, tab: Tableau, h: float, xi: Array) -> bool:
        """Whether the stages of a step of size h (s) are nearer to a straight way than to the polynomial of the step before."""
        if self.last is None:
            return False
        ahead = self.last.foretell(system, tab, h, self.state.q)[0]
        straight = (tab.c * h)[:, None] * self.state.v
        return system.max_abs(straight - xi) < system.max_abs(ahead - xi)
