"""Estimated errors of a sensor over time, with their signs: errors of several kinds add up, or cancel, instant by instant."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ...polynomials import lagrange_values
from ...rotations import Array

CUBIC = 4  # times as many values as common ones, from which on values between them count
FAST = 4  # differences that tell vibrations within few steps from slow motion
MISSED = 0.1  # of fast motion from which on it is not followed
LOST = 0.5  # of vibrations over many steps, from which on runs are out of phase
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


def unresolved(found: Deviation, series: Deviation) -> bool:
    """Whether a deviation of a series is mostly a vibration that larger steps left out, or lost the phase of.

    It changes more from one end to the next, or to the second, fourth .. one, than it is large, as vibrations of less than six of
    these in a period do. There, in its fourth differences, in which slow motion is small, it is more than a share of those of the
    series: :data:`MISSED` from one end to the next, :data:`LOST` where steps are small enough to follow it but for its phase.
    """

    def size(values: Array, differences: int) -> float:
        return float(np.sqrt(np.square(np.diff(values, differences, axis=0)).mean()))

    known, lag = series.at(found.times), 1
    while len(found.times) > FAST * lag:
        values, share = found.values[::lag], MISSED if lag == 1 else LOST
        if size(values, 1) > size(values, 0) and size(values, FAST) > share * size(known[::lag], FAST):
            return True
        lag *= 2
    return False


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


class BeyondLarger:
    """What series (n, size) at ``t`` (s) have beyond those at ``times`` with larger steps: where both are known, and at more of
    the ``times`` where few are common: a narrow peak lies between.

    There the finer one is on the cubic through four values, and counts as known to what a parabola through three of them differs
    by: where that is more, as about kinks and jumps, nothing is told. When and by which weights is the same for all series.
    """

    def __init__(self, t: Array, times: Array, t_end: float) -> None:
        rounding = 1e-9 * t_end
        rows = np.searchsorted(times, t - rounding).clip(max=len(times) - 1)
        (self._common,) = np.nonzero(np.abs(times[rows] - t) <= rounding)
        self._rows, common = rows[self._common], t[self._common]
        told = np.zeros(len(times), dtype=bool)
        told[self._rows] = True
        (self._other,) = np.nonzero(~told & (len(t) >= CUBIC * len(common)))
        at = times[self._other]
        self._first = np.clip(np.searchsorted(t, at) - 2, 0, max(len(t) - 4, 0))
        s = t[self._first[:, None] + np.arange(4)] if len(at) else np.zeros((0, 4))
        self._weights = [lagrange_values(s[:, :points], at) for points in (4, 3)]
        every = np.concatenate((common, at))
        self._order = np.argsort(every, kind="stable")
        self._times = every[self._order]

    def of(self, x: Array, y: Array) -> Deviation:
        """Of a series, and the same with larger steps."""
        apart = x[self._common] - y[self._rows]
        if not len(self._other):
            return Deviation(self._times, apart)
        flat = x.reshape(len(x), -1)
        cubic, parabola = (
            np.einsum("ij,ijk->ik", w, flat[self._first[:, None] + np.arange(w.shape[1])]) for w in self._weights
        )
        between = cubic - y.reshape(len(y), -1)[self._other]
        told = np.sign(between) * np.maximum(np.abs(between) - np.abs(cubic - parabola), 0.0)
        return Deviation(self._times, np.concatenate((apart, told.reshape(-1, *x.shape[1:])))[self._order])
