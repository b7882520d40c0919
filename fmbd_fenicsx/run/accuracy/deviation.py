"""Estimated errors of a sensor over time, with their signs: errors of several kinds add up, or cancel, instant by instant."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ...rotations import Array

TRUSTED = 1.0 / 3.0  # share of the sum that errors are left with, however well they seem to cancel


@dataclass(frozen=True)
class Deviation:
    """What a sensor is too small by, as an estimate: ``values`` (n, size), in its unit, at ``times`` (n,) s."""

    times: Array
    values: Array

    @property
    def size(self) -> float:
        """The largest over the run."""
        return float(np.abs(self.values).max(initial=0.0))

    @property
    def mean(self) -> float:
        """Root mean square over the run and the components."""
        return float(np.sqrt(np.mean(np.square(self.values)))) if self.values.size else 0.0

    @property
    def when(self) -> float:
        """When it is largest (s)."""
        rows = np.abs(self.values).reshape(len(self.times), -1).max(axis=1)
        return float(self.times[int(np.argmax(rows))])

    def near(self, time: float, width: float) -> float:
        """The largest within ``width`` (s) of a time, 0 where there is none."""
        return float(np.abs(self.values[np.abs(self.times - time) <= width]).max(initial=0.0))

    def at(self, times: Array) -> Array:
        """Values at other times, straight lines between."""
        if not len(self.times):
            return np.zeros((len(times), *self.values.shape[1:]))
        flat = self.values.reshape(len(self.times), -1)
        found = [np.interp(times, self.times, column) for column in flat.T]
        return np.stack(found, axis=1).reshape(len(times), *self.values.shape[1:])


def scaled(deviation: Deviation, factor: float) -> Deviation:
    """A deviation times a factor."""
    return replace(deviation, values=factor * deviation.values)


def at_least(deviation: Deviation, other: Deviation, most: float) -> Deviation:
    """A deviation, made as large as another one that tells the same less well, but larger by ``most`` at most."""
    size = deviation.size
    return scaled(deviation, min(other.size / size, most)) if other.size > size > 0.0 else deviation


def alignment(a: Deviation, b: Deviation) -> float:
    """The cosine between two deviations at the times of ``b``: 1 where these are the same function of time but for their size."""
    x, y = a.at(b.times), b.values
    size = float(np.linalg.norm(x) * np.linalg.norm(y))
    return float(np.vdot(x, y)) / size if size > 0.0 else 1.0


def sizes(found: dict[str, Deviation]) -> dict[str, float]:
    """Sensor -> largest error."""
    return {name: deviation.size for name, deviation in found.items()}


def added_up(found: Iterable[Deviation]) -> float:
    """The largest error of a sensor by several kinds at once:

        max_t |e_1(t) + e_2(t) + ...|,  at least a third of  max |e_1| + max |e_2| + ...                              (1)

    Kinds of opposite signs cancel, and their largest values may come at different times. The estimates are known to some tens of
    percent only, so that no more than two thirds of their sum count as cancelled.
    """
    found = [d for d in found if d.values.size]
    if not found:
        return 0.0
    times = np.unique(np.concatenate([d.times for d in found]))
    seen = float(np.abs(np.sum([d.at(times) for d in found], axis=0)).max(initial=0.0))
    return max(seen, TRUSTED * sum(d.size for d in found))
