"""Laws of controllers: the PID law, and the numbers that a law of the user's own returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgesv

from ...errors import CallbackError, floats
from ...rotations import Array


def numbers_of(name: str, what: str, value: Any, wanted: tuple[int, float]) -> Array:
    """Numbers that a law returned, or an error that says what was found."""
    size, t = wanted
    if size == 1 and isinstance(value, tuple | list) and len(value) == 1:
        value = value[0]
    if size == 1 and isinstance(value, float) and isfinite(value):
        return np.array([value])  # the usual answer: laws are asked many times a step

    try:
        found: Array = floats(value)
    except (TypeError, ValueError, OverflowError):
        raise CallbackError(f'Controller "{name}" returned {value!r} at t = {t:g} s, expected {size} {what}.') from None

    found = found if found.ndim else found.reshape(1)
    if found.shape != (size,) or not (isfinite(found.dot(found)) or np.isfinite(found).all()):
        raise CallbackError(
            f'Controller "{name}" returned {found} of shape {found.shape} at t = {t:g} s, expected {size} finite {what}.'
        )
    return found


Answers = tuple[Array, Array]
FAR = 0.5  # share of what a law changes by: it is not linear any more


def differences(
    x: Array, size: Array, asked: Callable[[Array], Answers], known: Answers | None = None
) -> tuple[Array, Array]:
    """Derivatives (.., n) of two answers of the law by the numbers x (n,); ``size`` (n,): what they may be.

    With the answers that are ``known`` at x each takes one call, and is exact to 1e-6 of the law's curvature; else two.
    """
    by_first, by_second = [], []
    for k, number in enumerate(x):
        step = np.zeros(len(x))
        step[k] = 1e-6 * (max(float(size[k]), abs(float(number))) or 1.0)
        ahead, behind = asked(x + step), known or asked(x - step)
        apart = step[k] if known else 2 * step[k]
        by_first.append((ahead[0] - behind[0]) / apart)
        by_second.append((ahead[1] - behind[1]) / apart)
    return np.array(by_first).T, np.array(by_second).T


def solved(matrix: Array, right: Array) -> Array:
    """What solves equations of few numbers, without the checks of :func:`numpy.linalg.solve`, which cost more than that."""
    _, _, found, singular = dgesv(matrix, right)
    if singular:
        raise np.linalg.LinAlgError("Singular matrix")
    return found  # type: ignore[no-any-return]


def unfelt(ask: Callable[[Array, Array], Answers], y: Array, z: Array, places: Array) -> Array:
    """By what errors of a memory z (m,) are measured at least, (m,), from readings y that may change by ``places`` (size,):

        |du/dy| places / |du/dz|,     what changes the efforts as much;     |dg/dy| places / |dg/dz|,     what z would follow to

    the larger of both, and 0 where the law, (y, z) -> (u, g), is far from linear up to there, or has no value.
    """
    m, answers = len(z), np.concatenate(ask(y, z))
    changes = np.abs(np.concatenate(differences(y, places, lambda y: ask(y, z)))) @ places
    slopes = np.concatenate(differences(z, np.zeros(m), lambda z: ask(y, z)))
    found = np.zeros(m)

    for k in range(m):
        felt = np.abs(slopes[:, k])
        efforts, own = np.flatnonzero(felt[:-m]), len(felt) - m + k
        sizes = [*(changes[own : own + 1] / felt[own] if felt[own] else ()), 0.0]
        sizes += [np.min(changes[efforts] / felt[efforts])] if len(efforts) else []
        step = max(sizes) * (np.arange(m) == k)
        try:
            ahead, behind = (np.concatenate(ask(y, z + way * step)) - answers for way in (1, -1))
        except CallbackError:
            continue
        off = np.maximum(np.abs(ahead - slopes @ step), np.abs(behind + slopes @ step))
        found[k] = step[k] if np.all(off <= FAR * (changes + np.abs(slopes) @ step)) else 0.0
    return found


@dataclass(frozen=True)
class PidLaw:
    """See :func:`pid`; ``target`` gives (s, s', s'')."""

    gains: tuple[float, float, float]
    target: Callable[[float], tuple[float, float, float]]
    limit: float
    every: float | None

    def unfelt(self, places: Array) -> Array:
        """As :func:`unfelt`, (1,): the integral with the effort of an error that is ``places[0]`` (m or rad)."""
        kp, ki, _ = self.gains
        return np.array([kp * places[0] / ki if ki else 0.0])

    def __call__(self, t: float, y: Mapping[str, Array], z: Array) -> tuple[float, float]:
        """The effort, and how the integral grows or its next value."""
        kp, ki, kd = self.gains
        wanted, speed, _ = self.target(t)
        error = wanted - y["s"][0]
        free = kp * error + ki * z[0] + kd * (speed - y["rate"][0])
        u = float(np.clip(free, -self.limit, self.limit))
        growth = error if u == free else error + (u - free) / kp
        return u, growth if self.every is None else z[0] + self.every * growth
