"""Kinds by an expression of a user's own: a function of two markers and of time, called once, becomes formulas.

    def bowl(a, b, t):                    # a bead of b on a paraboloid
        x, y, z = b.x - a.x
        return z - 0.5 * (x * x + y * y)

The markers hand out arrays of symbols, so that the function writes its formula down with the operations of NumPy. Rows, rates,
second derivatives and tangents follow from it (:mod:`.derivation`), and so do kernels in C and NumPy. Numbers in the formula
become constants of the item: functions that differ in their numbers alone are one kind, and share its kernels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ...errors import FmbdError, InputError
from ...rotations import Array
from .derivation import DRIVE, Kind, derive
from .expressions import Expression, as_expression, constant, gradient, rebuilt, symbol, symbols_of
from .frames import FRAME, AskedConstants, SymbolicFrame, Vector, spin, symbolic_frames, twist_of

PLAIN = 10  # whole numbers up to this size stay in the formula

Function = Callable[..., Any]


@dataclass(frozen=True)
class MarkerSymbols:
    """A marker in an expression: arrays of symbols that take part in NumPy's operations like arrays of numbers.

    ``x`` (d,): position, m, world axes. ``R`` (d, d): rotation since the start; its columns are the axes that the body carries.
    ``v`` (d,): velocity, m/s. ``w`` (3,), in the plane (1,): angular velocity, rad/s, world axes.
    """

    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray


@dataclass(frozen=True)
class OwnTerm:
    """One formula as a kind, with its numbers: the constants of an item by name."""

    kind: Kind
    constants: dict[str, Array]

    @property
    def in_time(self) -> bool:
        """Whether it depends on time."""
        return self.kind.driven

    def at(self, frames: tuple[Array, Array], t: float) -> Array:
        """Value and row of the formula at two frames (numbers in the order of :mod:`.frames`) and a time."""
        from .derivation import numpy_kernel

        kind = self.kind
        table = np.zeros(kind.width)
        eye = np.eye(kind.dim).ravel()
        given: dict[str, Any] = {"turn_a": eye, "turn_b": eye, "drive": t, "drive1": 1.0} | self.constants
        for name, value in given.items():
            if name in kind.constants:
                table[kind.place(name)] = value
        with np.errstate(all="ignore"):
            made: Array = numpy_kernel(kind, "value")(*frames, table)
        return made


def markers_of(frames: Sequence[SymbolicFrame], constants: AskedConstants) -> list[MarkerSymbols]:
    """The two markers: points p and q, turned by turn_a and turn_b, of two frames."""
    out = []
    for frame, place, turn in zip(frames, "pq", ("turn_a", "turn_b"), strict=True):
        d = frame.dim
        point = constants.vector(place)
        entries = constants.vector(turn, d * d)
        arm = frame.axis(point)
        axes = [frame.axis(entries[j::d]) for j in range(d)]
        velocity = frame.v + spin(frame.w, arm)
        out.append(MarkerSymbols(_array(frame.x + arm), _array(axes).T, _array(velocity), _array(frame.w)))
    return out


def _array(values: Any) -> np.ndarray:
    """Symbols, or rows of them, as an array."""
    return np.array([list(x) if isinstance(x, Vector) else x for x in values], dtype=object)


def traced(what: str, function: Function, dim: int) -> list[Expression]:
    """The formulas of a function of two markers and of time; ``what`` begins the messages.

    Raises:
        InputError: it fails for symbols, or does not return formulas.
    """
    a, b = markers_of([SymbolicFrame(name, dim) for name in "AB"], AskedConstants(dim))
    try:
        found = function(a, b, DRIVE)
    except FmbdError:
        raise
    except Exception as error:
        raise InputError(
            f"{what}: its expression(a, b, t) failed: {type(error).__name__}: {error}. It is called once with symbols and has to "
            "write one smooth formula with +, -, *, /, ** and NumPy's sqrt, sin, cos, tan, exp, log, tanh, arccos, arctan2."
        ) from error

    results = np.asarray(found, dtype=object)
    if results.ndim > 1 or results.size == 0:
        raise InputError(
            f"{what}: its expression(a, b, t) returned shape {results.shape}; expected one formula or several, (m,)."
        )
    out = []
    for i, y in enumerate(results.ravel()):
        if not isinstance(y, Expression):
            raise InputError(
                f"{what}: its expression(a, b, t) returned {y!r} as number {i + 1} of {results.size}, which does not "
                "depend on the markers; expected a formula of a.x, a.R, b.x, b.R (and t)."
            )
        out.append(y)
    return out


def own_term(what: str, y: Expression, dim: int) -> OwnTerm:
    """A formula as a kind; one that holds velocities is a flow.

    Raises:
        InputError: it depends on no marker, has no finite numbers, or is not linear in the velocities.
    """
    z, numbers = _apart(what, y)
    frames = symbolic_frames(2, dim)
    speeds = twist_of(frames)
    flow = bool(symbols_of([y]) & set(speeds))
    if flow:
        _require_linear(what, y, speeds)
    kind = _kind(dim, z, len(numbers), flow)
    if not kind.entries:
        raise InputError(f"{what}: its formula does not depend on the motion of the markers a and b.")
    return OwnTerm(kind, {"own": np.array(numbers)} if numbers else {})


def term_of_points(what: str, y: Expression, dim: int, count: int) -> tuple[OwnTerm, list[int]]:
    """A formula of the places of so many points, the origins of :func:`~.frames.symbolic_frames`, as a kind without a tangent
    between those that are in it, and which these are: formulas of other points are the same kind.

    Raises:
        InputError: it has no finite numbers.
    """
    frames, there = symbolic_frames(count, dim), symbols_of([y])
    points = [k for k, frame in enumerate(frames) if there & set(frame.x)]
    first = symbolic_frames(len(points), dim)
    to = {x: z for k, frame in zip(points, first, strict=True) for x, z in zip(frames[k].x, frame.x, strict=True)}
    z, numbers = _apart(what, rebuilt([y], symbols=to)[0])
    return OwnTerm(
        _kind_of_points(dim, z, len(numbers), len(points)), {"own": np.array(numbers)} if numbers else {}
    ), points


def _apart(what: str, y: Expression) -> tuple[Expression, list[float]]:
    """A formula with symbols for its numbers, and these."""
    numbers: list[float] = []

    def lifted(x: float) -> Expression:
        """Numbers in the order in which they occur, as constants of the item."""
        if abs(x) <= PLAIN and x == int(x):
            return constant(x)
        if x not in numbers:
            numbers.append(x)
        return symbol(f"P_own_{numbers.index(x)}")

    (z,) = rebuilt([y], lifted)
    if not np.isfinite(numbers).all():
        raise InputError(
            f"{what}: its formula holds {[x for x in numbers if not np.isfinite(x)]}, which are no finite numbers."
        )
    return z, numbers


def _require_linear(what: str, y: Expression, speeds: list[Expression]) -> None:
    """Refuse a formula that is not linear in its velocities: the rows of such a constraint would not be its force."""
    if any(symbols_of([r]) & set(speeds) for r in gradient(y, speeds)):
        raise InputError(
            f"{what}: its formula depends on velocities and is not linear in them; expected a sum of velocities times "
            "functions of places, rotations and time, and such functions alone."
        )


@cache
def _kind(dim: int, y: Expression, numbers: int, flow: bool) -> Kind:
    """The kind of a formula whose numbers are constants of the item; the same formula is the same object."""

    def definition(a: SymbolicFrame, b: SymbolicFrame, c: AskedConstants) -> Expression:
        markers_of((a, b), c)
        return _of_numbers(y, numbers, c)

    return derive("own", dim, definition, flow=flow)


@cache
def _kind_of_points(dim: int, y: Expression, numbers: int, count: int) -> Kind:
    """The same of a formula of the places of so many points."""
    return derive("own", dim, lambda *given: _of_numbers(y, numbers, given[-1]), between=count, tangent=False)


def _of_numbers(y: Expression, numbers: int, c: AskedConstants) -> Expression:
    """A formula that names its numbers, and the time where it is in it, as constants of the item."""
    if numbers:
        c.vector("own", numbers)
    if DRIVE in symbols_of([y]):
        c.scalar("drive")
    return as_expression(y)


def _frame_numbers(dim: int, x: Array) -> Array:
    """A frame at rest at a place, world axes, (FRAME,)."""
    out = np.zeros(FRAME[dim])
    out[:dim] = x
    out[dim : dim + dim * dim] = np.eye(dim).ravel()
    return out


def finite_at(what: str, terms: list[OwnTerm], places: list[Any], dim: int) -> None:
    """Refuse formulas without finite values and derivatives at the start, the markers at two places, world axes."""
    a, b = (_frame_numbers(dim, x) for x in places)
    for i, term in enumerate(terms):
        found = term.at((a, b), 0.0)
        if np.isfinite(found).all():
            continue
        which = "" if len(terms) == 1 else f" {i + 1} of {len(terms)}"
        lacking = "value" if not np.isfinite(found[0]) else "derivative"
        raise InputError(
            f"{what}: its formula{which} has no finite {lacking} at the start, with a at {tuple(map(float, places[0]))} and b at "
            f"{tuple(map(float, places[1]))}. Move the points, or write it another way: d @ d - L * L instead of sqrt(d @ d) - L."
        )
