"""What laws of the user's own do between the coordinates at which a run has asked them.

A bump on a way that is narrower than what a step moves is passed over: no scheme asks the law there, its error knows nothing of
it, and runs with other steps agree. A coordinate goes on all in one piece, so that it has been at all places between those at
which its law was asked; where the law rises far above both of its values beside such a gap, steps have missed something.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import FmbdError
from ...rotations import Array

LOOKED_AT, FEWEST = 1000, 50  # places of a law, or of many of them together, and of each at least
GATHERED = 2000  # calls after which places that are near to each other are one
SHARE = 0.01  # of the largest effort at all places: what is less is none


@dataclass(frozen=True)
class PassedOver:
    """A law ``name`` with an ``effort`` at a place s between two at which it was asked, far above those there."""

    name: str
    at: float
    effort: float
    between: tuple[float, float]


class Asked:
    """Coordinates at which the laws of n elements were asked."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.rows: list[Array] = []

    def note(self, s: Array) -> None:
        """Coordinates (.., n) of a call."""
        self.rows.append(s)
        if len(self.rows) > GATHERED:
            self.rows = [self._thinned()]

    @classmethod
    def of(cls, places: Array) -> Asked:
        """Of one law that was asked at these (k,)."""
        made = cls(1)
        made.note(places)
        return made

    @property
    def places(self) -> Array | None:
        """All of them, (k, n), those of each element ascending by themselves; None where nobody asked."""
        self.rows = [self._thinned()] if self.rows else []
        return self.rows[0] if self.rows else None

    def _thinned(self) -> Array:
        """Fewer places with the same gaps, (k, n), ascending."""
        places = np.sort(np.concatenate([s.reshape(-1, self.n) for s in self.rows]), axis=0)
        if len(places) <= 4 * LOOKED_AT:
            return places
        low, high = places[0], places[-1]
        # the lowest and the highest of each interval
        edges = low + np.linspace(0.0, 1.0, 2 * LOOKED_AT + 1)[:, None] * (high - low)
        kept = [np.searchsorted(x, e) for x, e in zip(places.T, edges.T, strict=True)]
        rows = [
            np.concatenate((x[k.clip(max=len(x) - 1)], x[(k - 1).clip(0)])) for x, k in zip(places.T, kept, strict=True)
        ]
        return np.sort(np.array(rows).T, axis=0)

    def passed_over(self, laws: Sequence[Any], t: float) -> Iterable[PassedOver]:
        """Which laws do more between these coordinates, at rest at a time t (s), than at them."""
        places = self.places
        for law, column in zip(laws, () if places is None else places.T, strict=places is not None):
            x: Array = np.asarray(column)
            gaps = np.diff(x)
            gaps[gaps <= (x[-1] - x[0]) / LOOKED_AT] = 0.0
            ends = np.cumsum(gaps)
            if not ends.size or ends[-1] == 0.0:
                continue

            # places in the gaps, evenly on what these are together, and those beside them
            count = max(LOOKED_AT // self.n, FEWEST)
            way = (np.arange(count) + 0.5) / count * ends[-1]
            k = np.searchsorted(ends, way)
            inside = x[k + 1] - (ends[k] - way)
            beside = np.unique(np.concatenate((k, k + 1)))
            try:
                efforts = _efforts(law, np.concatenate((inside, x[beside])), t)
            except FmbdError:
                continue

            # how far the law rises above both ends of a gap, or falls below, more than these are themselves
            before, behind = (efforts[count + np.searchsorted(beside, i)] for i in (k, k + 1))
            over = np.maximum(
                efforts[:count] - np.maximum(before, behind), np.minimum(before, behind) - efforts[:count]
            )
            over -= np.maximum(np.abs(before), np.abs(behind))

            i = int(over.argmax())
            at, between = float(inside[i]), (float(x[k[i]]), float(x[k[i] + 1]))
            if over[i] > SHARE * np.abs(efforts[count:]).max() and np.isclose(law.number(at, 0.0, t), efforts[i]):
                yield PassedOver(law.name, at, float(efforts[i]), between)


def _efforts(law: Any, s: Array, t: float) -> Array:
    """N (n,) at coordinates, by one call where it takes arrays."""
    try:
        found = np.asarray(law.function(s, np.zeros_like(s), t), dtype=float)
    except Exception:
        found = np.zeros(0)
    return found if found.shape == s.shape else np.array([law.number(float(x), 0.0, t) for x in s])
