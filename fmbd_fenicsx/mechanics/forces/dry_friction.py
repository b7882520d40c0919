"""Dry friction with true rest, by a point that sticks and is dragged along:

    N = k (s - p) + c s',  cut at +- F;     after a step that slides   p := s - (N - c s') / k                     (1)

It is the set-valued law of Coulomb with a stiffness k, and a damping c, before sliding (Prandtl's element, plasticity of one
number); inside a step (1) is the return mapping of that law, with the slopes k and c while it sticks and 0 while it slides.
There p is that of its beginning, also where somebody looks back into a step that was accepted: p of its end lies ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...rotations import Array, Motions
from ..frames import Kinematics
from ..joints.relative import RelativeCoordinates
from ..joints.sums import Coordinate
from .force_elements import Loads, ScalarLoads
from .forces import Force
from .formulas import MEMORY, Formula, table

ALL = slice(None)
ON_LIMIT = 1e-9  # share of the limit within which a force lies on it
DIGITS = 1.8e-15  # share of s and p that is roundoff
WITHIN = 1e-9  # share of the last step by which its end is not within it
KEPT = 11  # numbers of each
AT_ONCE = 2.0  # steps
CHATTERS = 3  # turns that are no motion
ROUNDOFF = 1e-9  # of what the ends of a joint move: rates below are those of projections onto the joints


class DryFrictionLoads(ScalarLoads):
    """Elements (1) of one kind of coordinate; ``kept`` (m, 11): the point p where each sticks, the time (s) since which, both
    before the last step, or before the last part of one with impacts; on which side it slid last, steps since then, how often
    it went back at once; where its spring ended and s' then, and the largest sizes of s and s' so far.
    """

    by_ends = True
    follows_laws = True  # what sticks may slide at the next end of a step

    def __init__(
        self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]], relative: RelativeCoordinates
    ) -> None:
        super().__init__(motions, forces, markers, relative)
        self.limit = np.array([f.limit for f in forces])
        self.kept: Array = np.zeros((len(forces), KEPT))

    def formulas(self) -> list[Formula]:
        """Dry friction, with the points where it sticks."""

        def kept() -> Array:
            return np.pad(self.kept, ((0, 0), (0, MEMORY - KEPT)))

        def keep(memory: Array) -> None:
            self.kept = memory[:, :KEPT].copy()

        numbers = table(list(zip(self.k, self.c, self.limit, strict=True)))
        return [Formula(self.relative, "DRY", np.arange(len(self.k)), numbers, kept=kept, keep=keep)]

    def effort(self, s: Array, rate: Array, t: float) -> Array:
        """N of (1), (m,)."""
        return np.clip(self._trial(s, rate, t), -self.limit, self.limit)

    def _stuck(self, t: float, which: Any = ALL) -> Array:
        """p of some elements at a time t, (m,): within the last step that of its beginning."""
        p, since, before, began = self.kept[which].T[:4]
        return np.where(t < since - WITHIN * (since - began), before, p)

    def _trial(self, s: Array, rate: Array, t: float, which: Any = ALL) -> Array:
        """N of some elements if they stick, (m,)."""
        trial = np.asarray(self.k[which] * (s - self._stuck(t, which)) + self.c[which] * rate)
        # an earlier part of the step slid to where the next one began
        elsewhere = (t < self.kept[which, 3]) & (np.abs(trial) > self.limit[which])
        return np.where(elsewhere, np.copysign(trial, rate), trial)

    def energy(self, kin: Kinematics, t: float) -> float:
        """k (s - p)^2 / 2 with p as it would be after this step, at most F^2 / 2 k: what is stored before sliding, J.

        While it slides against its damping p runs ahead of the spring, by c s' / k: an offset that is gone when the joint
        comes to rest, and no energy.
        """
        s, rate = self._state(kin)
        offset = np.abs(s - self._dragged(self._stuck(t), self._end(s, rate)))
        stretch = np.minimum(offset, self.limit / self.k)
        return 0.5 * float((self.k * stretch**2).sum())

    def slopes(self, which: Any, s: Array, rate: Array, t: float) -> tuple[Array, Array]:
        """k and c where it sticks, 0 where it slides.

        A point that was dragged lies on the limit: there it slides, and roundoff, after many turns too, does not decide.
        """
        roundoff = DIGITS * self.k[which] * (np.abs(s) + np.abs(self._stuck(t, which)))
        sticks = np.abs(self._trial(s, rate, t, which)) <= (1.0 - ON_LIMIT) * self.limit[which] - roundoff
        return self.k[which] * sticks, self.c[which] * sticks

    def _all_slopes(self, s: Array, rate: Array, t: float) -> tuple[Array, Array]:
        return self.slopes(ALL, s, rate, t)

    def first(self, ev: Any, state: Any) -> Array:
        """p of a joint at rest: where it is, without a force; of one that moves: where it is dragged, the force at its limit."""
        s, rate = self._state(ev.kin)
        moves = np.abs(rate) > ROUNDOFF * self.relative.swept(ev.kin)
        p = s - np.where(moves, np.sign(rate) * self.limit - self.c * rate, 0.0) / self.k
        now = np.full(len(p), ev.t)
        return np.column_stack(
            (p, now, s, now, np.zeros((len(p), 3)), self._end(s, rate), rate, np.abs(s), np.abs(rate))
        )  # p is not s where it slides

    def overran(self, ev: Any, h: float, rtol: float) -> bool:
        """Whether what slides has turned within the step, farther from its ends than this share of the largest s and s' so far.

        By the ends of steps p is not dragged on to the turn, so that N stays on its limit all the way back. What is wrong of the
        way, up to the turn or behind it, is the less of both; of s' it is as much as N has changed there. The turn is the farther
        one of those that rates which change evenly lead to from either end.
        """
        (s, rate), p = self._state(ev.kin), self.kept[:, 0]
        began, before, reach, fastest = self.kept[:, 7:].T
        end, leads = self._end(s, rate), self.c / self.k * (rate - before) / h
        first, last = before + leads, rate + leads
        turns = first * last < 0.0
        slows = np.divide(0.5 * h, first - last, out=np.zeros_like(rate), where=turns)
        ways = began + slows * first**2, end + slows * last**2
        turn = np.where(first > 0.0, np.maximum(*ways), np.minimum(*ways))
        way = np.minimum(np.abs(self._dragged(p, turn) - p), np.abs(turn - end))
        gained = np.minimum(np.abs(first), np.abs(last)) * np.minimum(0.5 * self.k / self.limit * way, 1.0)
        far = way > rtol * np.maximum(reach, self.limit / self.k)
        return bool((turns & (far | (gained > rtol * np.maximum(fastest, np.abs(rate))))).any())

    def accepted(self, ev: Any, state: Any) -> Array:
        """p after a step, and what was before it."""
        earlier = (ev.t > self.kept[:, 1])[:, None]
        s, rate = self._state(ev.kin)
        p = self._dragged(self._stuck(ev.t), self._end(s, rate))
        points = np.column_stack((p, np.full(len(p), ev.t), np.where(earlier, self.kept[:, :2], self.kept[:, 2:4])))

        # those that slide back at once: p moves by more than their springs give
        N, (side, ago, chattered) = self.effort(s, rate, ev.t), self.kept.T[4:7]
        slid = self.k * np.abs(p - self.kept[:, 0]) > self.limit
        back = slid & (side * N < 0.0)
        chattered = chattered + (back & (ago <= AT_ONCE))
        turned = np.column_stack((np.where(slid, np.sign(N), side), np.where(back, 1.0, ago + 1.0), chattered))
        reached = np.column_stack((self._end(s, rate), rate))
        sizes = np.maximum(self.kept[:, 9:], np.abs(np.column_stack((s, rate))))
        return np.concatenate((points, np.where(earlier, turned, self.kept[:, 4:7]), reached, sizes), axis=1)

    @property
    def chattering(self) -> list[str]:
        """Names of those that went from limit to limit and back in one or two steps, again and again: they hold nothing."""
        return [f.name for f, count in zip(self.forces, self.kept[:, 6], strict=True) if count >= CHATTERS]

    def _end(self, s: Array, rate: Array) -> Array:
        """Where the spring ends whose other end is p: N = k (end - p) while it sticks, (m,)."""
        return np.asarray(s + self.c / self.k * rate)

    def _dragged(self, p: Array, end: Array) -> Array:
        """p behind a spring that ends there, (m,)."""
        most = self.limit / self.k
        return np.where(np.abs(end - p) > most, end - np.copysign(most, end - p), p)


@dataclass(frozen=True, eq=False)
class DryFriction(Force):
    """See :func:`~fmbd_fenicsx.dry_friction`; ``limit`` F, ``stiffness`` k and ``damping`` c of (1)."""

    on: Coordinate = None  # type: ignore[assignment]
    limit: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    length: float = 0.0
    law: None = None

    batch: ClassVar[type[Loads]] = DryFrictionLoads
    kind: ClassVar[str] = "dry friction"

    @property
    def coordinate(self) -> Coordinate:
        """The joint coordinate on which it acts."""
        return self.on
