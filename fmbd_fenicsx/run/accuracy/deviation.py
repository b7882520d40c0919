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


def between_ends(t: Array, x: Array, times: Array, y: Array, common: Deviation) -> Deviation:
    """What a series ``x`` (n, size) at ``t`` (s) has beyond ``y`` at ``times`` with larger steps: ``common`` where both are
    known, and more instants of ``y`` where few are common: a narrow peak lies between.

    There x is on the cubic through four values, and counts as known to what a parabola through three of them differs by: where
    that is more, as about kinks and jumps, nothing is told.
    """
    if len(t) < CUBIC * len(common.times):
        return common
    other = np.setdiff1d(np.arange(len(times)), np.searchsorted(times, common.times - 1e-9 * times[-1]))
    if not len(other):
        return common
    first = np.clip(np.searchsorted(t, times[other]) - 2, 0, len(t) - 4)
    s, at = t[first[:, None] + np.arange(4)], times[other]
    flat = x.reshape(len(t), -1)

    def on(points: int) -> Array:
        """Lagrange's polynomial through the first so many points."""
        values = flat[first[:, None] + np.arange(points)]
        return np.asarray(np.einsum("ij,ijk->ik", lagrange_values(s[:, :points], at), values))

    cubic = on(4)
    apart = cubic - y.reshape(len(times), -1)[other]
    told = np.sign(apart) * np.maximum(np.abs(apart) - np.abs(cubic - on(3)), 0.0)
    rows = np.argsort(np.concatenate((common.times, at)), kind="stable")
    values = np.concatenate((common.values, told.reshape(-1, *x.shape[1:])))
    return Deviation(np.concatenate((common.times, at))[rows], values[rows])
