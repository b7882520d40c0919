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
KEPT = 7  # numbers of each
AT_ONCE = 2.0  # steps
CHATTERS = 3  # turns that are no motion
ROUNDOFF = 1e-9  # of what the ends of a joint move: rates below are those of projections onto the joints


class DryFrictionLoads(ScalarLoads):
    """Elements (1) of one kind of coordinate; ``kept`` (m, 7): the point p where each sticks, the time (s) since which, both
    before the last step, or before the last part of one with impacts; on which side it slid last, steps since then, how often
    it went back at once.
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
        offset = np.abs(self.relative.values(kin) - self._dragged(kin, t))
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
        return np.column_stack((p, now, s, now, np.zeros((len(p), 3))))  # p is not s where it slides

    def overran(self, ev: Any, h: float) -> bool:
        """Whether what slides where the step ends, or sticks there and slid where it began, goes backwards: it turned within the
        step, by more than the spring before sliding gives.
        """
        s, rate = self._state(ev.kin)
        trial = self._trial(s, rate, ev.t)
        ahead = np.where(np.abs(trial) > self.limit, trial, self.kept[:, 0] - self.kept[:, 2])
        wrong = (ahead * rate < 0) & (self.k * np.abs(rate) * h > self.limit)
        return bool(wrong.any())

    def accepted(self, ev: Any, state: Any) -> Array:
        """p after a step, and what was before it."""
        earlier = (ev.t > self.kept[:, 1])[:, None]
        p = self._dragged(ev.kin, ev.t)
        points = np.column_stack((p, np.full(len(p), ev.t), np.where(earlier, self.kept[:, :2], self.kept[:, 2:4])))

        # those that slide back at once: p moves by more than their springs give
        N, (side, ago, chattered) = self.effort(*self._state(ev.kin), ev.t), self.kept.T[4:]
        slid = self.k * np.abs(p - self.kept[:, 0]) > self.limit
        back = slid & (side * N < 0.0)
        chattered = chattered + (back & (ago <= AT_ONCE))
        turned = np.column_stack((np.where(slid, np.sign(N), side), np.where(back, 1.0, ago + 1.0), chattered))
        return np.concatenate((points, np.where(earlier, turned, self.kept[:, 4:])), axis=1)

    @property
    def chattering(self) -> list[str]:
        """Names of those that went from limit to limit and back in one or two steps, again and again: they hold nothing."""
        return [f.name for f, count in zip(self.forces, self.kept[:, 6], strict=True) if count >= CHATTERS]

    def _dragged(self, kin: Kinematics, t: float) -> Array:
        """p if a step ends here, (m,)."""
        s, rate = self._state(kin)
        slides = np.abs(self._trial(s, rate, t)) > self.limit
        return np.where(slides, s - (self.effort(s, rate, t) - self.c * rate) / self.k, self._stuck(t))


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
