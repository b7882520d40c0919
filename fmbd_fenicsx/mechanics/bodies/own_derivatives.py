"""Derivatives of a user's functions of coordinates: by complex steps where these tell the truth, else as those of time.

A complex step is exact to roundoff and cheap. A function that drops the imaginary part on its way (``np.linalg.norm``, ``abs``)
answers without complaint and has lost its derivative. So :func:`slopes_of` looks once, at the start, which way suits a function:
the slope along a line is compared with that by jets or by differences, which are free of units
(:mod:`..kinds.time_derivatives`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...rotations import Array
from ..kinds.jets import COMPLEX_STEP, Jet, jet
from ..kinds.time_derivatives import AGREES, OUTSIDE, STEPS, Best, search

SAME = 1e-4  # of a slope: what two ways to find it may differ by
NOTHING = 1e-20  # of the largest slope: what a complex step leaves where there is none
GOOD = 1e-10  # of a slope: an error of differences that need not be looked into
ROUGH = 2.0**-10  # of a coordinate: over which its part of a value is seen
LOOSE = 1e4  # times the error of the best step: what a shorter one may have
UNUSABLE = (TypeError, ValueError, np.exceptions.ComplexWarning)  # answers to complex numbers that do not pass

ALL = range(len(STEPS))

Function = Callable[[Any], Any]


def derivative(function: Function, x: Array) -> Array:
    """d function / d x, (m, n), by complex steps; by :func:`differences` when complex numbers do not pass."""
    n = len(x)
    try:
        return _complex_slopes(function, x, np.eye(n)).T if n else np.zeros((np.size(function(x)), 0))
    except UNUSABLE:
        pass
    return differences(function, x)


def derivative_many(function: Callable[[Any, Any], Any], x: Array, t: Array) -> Array:
    """d function(x, t) / d x of a vectorized function, (k, m, n), at x (k, n), t (k,): all complex steps in one call.

    Raises TypeError or ValueError where complex numbers do not pass.
    """
    k, n = x.shape
    z = np.repeat(x.T.astype(complex)[:, None], n, axis=1)  # (n, directions, k)
    # direction j moves coordinate j
    z[range(n), range(n)] += 1j * COMPLEX_STEP
    # a function that drops the imaginary part would give zeros: an error instead
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        found = np.asarray(function(z.reshape(n, n * k), np.tile(t, (n, *(1,) * (t.ndim - 1)))), dtype=complex)
    return np.imag(found.reshape(-1, n, k)).transpose(2, 0, 1) / COMPLEX_STEP


def differences(function: Function, x: Array) -> Array:
    """d function / d x, (m, n), without complex numbers: by jets, else by differences."""
    axes = _axes(function, x)
    if not axes:
        return np.zeros((np.size(function(x)), 0))
    exact = [line.exact() for line in axes]
    if all(both is not None for both in exact):
        return np.stack([both[0] for both in exact if both is not None], axis=-1)
    return _values(_searched(axes))


def line_rates(function: Function, x: Array, v: Array) -> tuple[Array, Array]:
    """First and second derivative, (m,) each, of s -> function(x + s v) at s = 0: exact where the function is made of
    arithmetic and NumPy's functions, else by differences whose step suits the function.
    """
    line = ValuesOnLine(function, x, v)
    exact = line.exact()
    if exact is not None:
        return exact
    found = line.search(_sizes(_axes(function, x)))
    return np.array([first.value for first, _ in found]), np.array([second.value for _, second in found])


@dataclass(frozen=True, eq=False)
class Slopes:
    """x -> d function / d x, (m, n), of a user's function, by the way that suits it.

    ``by_complex``: complex steps tell the truth. ``steps``, ``errors``: of differences along each coordinate, which steps of
    theirs counted at the start, and how good they were, (n, m); none where jets pass.
    """

    function: Function
    by_complex: bool
    steps: tuple[Sequence[int], ...] = ()
    errors: tuple[Sequence[float], ...] = ()

    def __call__(self, x: Array) -> Array:
        """The derivative at x."""
        if self.by_complex:
            return derivative(self.function, x)
        if not self.errors:
            return differences(self.function, x)
        axes = _axes(self.function, x)
        few = _searched(axes, self.steps)
        good = all(
            not best.contradicted and best.error <= AGREES * max(error, GOOD * abs(best.value))
            for column, kept in zip(few, self.errors, strict=True)
            for best, error in zip(column, kept, strict=True)
        )
        return _values(few if good else _searched(axes))


def slopes_of(function: Function, start: Array) -> Slopes:
    """The derivative of a user's function, looked at where a run starts; whoever asks for it there is told what fails."""
    along = 1.0 + 0.1 * np.arange(len(start))
    line = ValuesOnLine(function, start, along)
    axes = _axes(function, start)
    try:
        exact = line.exact()
        found = [] if exact is not None else [first for first, _ in line.search(_sizes(axes))]
    except OUTSIDE:
        return Slopes(function, True)

    told = exact[0] if exact is not None else np.array([x.value for x in found])
    error = np.array([x.error for x in found]) if found else np.zeros(len(told))
    if _complex_steps_tell(function, start, along, told, error):
        return Slopes(function, True)
    if exact is not None:
        return Slopes(function, False)
    return Slopes(function, False, *_short_steps(axes))


def _complex_steps_tell(function: Function, x: Array, v: Array, told: Array, error: Array) -> bool:
    """Whether the slope along v by a complex step is that which was ``told``, with its ``error``, (m,)."""
    try:
        (slope,) = _complex_slopes(function, x, v[None])
        allowed = SAME * np.maximum(np.abs(slope), np.abs(told)) + AGREES * error
        allowed += NOTHING * np.abs(told).max(initial=0.0)
        return bool((np.abs(slope - told) <= allowed).all())
    except UNUSABLE:
        return False


def _short_steps(axes: list[ValuesOnLine]) -> tuple[tuple[Sequence[int], ...], tuple[Sequence[float], ...]]:
    """Steps and errors of :class:`Slopes`, of each axis: what is a polynomial at the start is none elsewhere, so these are not
    the best steps but the shortest ones that are good enough.
    """
    sizes = _sizes(axes)
    steps, errors = [], []
    for line, column in zip(axes, _searched(axes), strict=True):
        at_most = [max(GOOD * abs(best.value), LOOSE * best.error) for best in column]
        for n in ALL:
            tried = [first.error for first, _ in line.search(sizes, [n])]
            if all(e <= most for e, most in zip(tried, at_most, strict=True)):
                break
        steps.append(range(n, min(n + 2, len(STEPS))))
        errors.append(at_most)
    return tuple(steps), tuple(errors)


def _complex_slopes(function: Function, x: Array, ways: Array) -> Array:
    """d function(x + s v) / ds at s = 0 for each v of some ways, (k, m), by complex steps."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)  # an imaginary part dropped on the way
        found = [np.asarray(function(z), dtype=complex).reshape(-1).imag for z in x + 1j * COMPLEX_STEP * ways]
    return np.array(found) / COMPLEX_STEP


class ValuesOnLine:
    """The values of a function on a line x + s v; each place is asked once."""

    def __init__(self, function: Function, x: Array, v: Array) -> None:
        self.function, self.x, self.v = function, x, v
        self.asked: dict[float, Array] = {}

    def exact(self) -> tuple[Array, Array] | None:
        """Both derivatives at s = 0 by jets; None where these do not pass."""
        place = np.array([Jet(float(a), float(b)) for a, b in zip(self.x, self.v, strict=True)], dtype=object)
        try:
            found = [jet(y) for y in np.ravel(np.asarray(self.function(place), dtype=object))]
        except OUTSIDE:
            return None
        rates = np.array([(y.first, y.second) for y in found], dtype=float).reshape(-1, 2)
        return (rates[:, 0], rates[:, 1]) if np.isfinite(rates).all() else None

    def at(self, s: float) -> Array:
        """The values at s, (m,)."""
        if s not in self.asked:
            with np.errstate(all="ignore"):  # a long step may lead out of where it is defined
                self.asked[s] = np.ravel(np.asarray(self.function(self.x + s * self.v), dtype=float))
        return self.asked[s]

    def search(self, sizes: Array, steps: Sequence[int] = ALL) -> list[tuple[Best, Best]]:
        """Both derivatives of each value by differences; ``sizes`` of the terms that may cancel in it, (m,)."""
        return [search(lambda s, i=i: self.at(s)[i], 0.0, sizes[i], steps=steps) for i in range(len(sizes))]  # type: ignore[misc]


def _axes(function: Function, x: Array) -> list[ValuesOnLine]:
    """The lines through x along each coordinate."""
    return [ValuesOnLine(function, x, e) for e in np.eye(len(x))]


def _searched(axes: list[ValuesOnLine], steps: Sequence[Sequence[int]] = ()) -> list[list[Best]]:
    """The derivative along each of the axes, of each value."""
    each = steps or [ALL] * len(axes)
    sizes = _sizes(axes)
    return [[first for first, _ in line.search(sizes, some)] for line, some in zip(axes, each, strict=True)]


def _sizes(axes: list[ValuesOnLine]) -> Array:
    """Of the terms that may cancel in each value, (m,): sum_k |dg/dx_k| |x_k|, roughly; not small where a constraint holds."""
    here = axes[0].at(0.0)
    reaches = [ROUGH * abs(float(x)) for x in axes[0].x]
    changes = [np.abs(line.at(s) - here) for line, s in zip(axes, reaches, strict=True)]
    return np.asarray(np.abs(here) + np.nan_to_num(changes).sum(axis=0) / ROUGH)


def _values(found: list[list[Best]]) -> Array:
    """Of one list for each coordinate, (m, n)."""
    return np.array([[best.value for best in column] for column in found]).T
