"""Symbolic frames of the plane and of space: what a definition sees of the two markers it relates.

A frame is an array of numbers in world axes, in this order:

    space  x (3), R (9, row by row), v (3), w (3)             18 numbers
    plane  x (2), R (4, row by row), v (2), w (1), phi        10 numbers, phi the angle counted over revolutions

Derivatives are taken along the twists (v, w) of both frames,

    dx/dt = v,    du/dt = w x u for a direction u = R e fixed in the frame,    dphi/dt = w                          (1)

so lever arms need no code of their own. Every direction fixed in a frame is a symbol of its own with the rule (1): expressions
stay small.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from .expressions import ZERO, Expression, as_expression, gradient, symbol

FRAME = {2: 10, 3: 18}  # numbers of a frame
PLACES = {"p": 0, "q": 1}  # constants that are places of markers in the frames A and B


class Vector(tuple[Expression, ...]):
    """Components along axes; ``@`` is the scalar product."""

    __slots__ = ()

    def __new__(cls, components: Iterable[Any]) -> Vector:  # noqa: PYI034
        """A vector of expressions or numbers."""
        return super().__new__(cls, (as_expression(x) for x in components))

    def __add__(self, other: Sequence[Any]) -> Vector:  # type: ignore[override]
        return Vector(x + y for x, y in zip(self, other, strict=True))

    def __sub__(self, other: Sequence[Any]) -> Vector:
        return Vector(x - y for x, y in zip(self, other, strict=True))

    def __mul__(self, factor: Any) -> Vector:  # type: ignore[override]
        return Vector(x * factor for x in self)

    def __truediv__(self, divisor: Any) -> Vector:
        return Vector(x / divisor for x in self)

    def __neg__(self) -> Vector:
        return Vector(-x for x in self)

    def __matmul__(self, other: Sequence[Any]) -> Expression:
        out = ZERO
        for x, y in zip(self, other, strict=True):
            out = out + x * y
        return out

    __rmul__ = __mul__  # type: ignore[assignment]


def cross(a: Sequence[Any], b: Sequence[Any]) -> Vector:
    """a x b: three components in space, one in the plane."""
    if len(a) == 2:
        return Vector([a[0] * b[1] - a[1] * b[0]])
    return Vector(a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1)))


def spin(w: Sequence[Any], u: Sequence[Any]) -> Vector:
    """w x u, w one component in the plane."""
    return Vector([-(w[0] * u[1]), w[0] * u[0]]) if len(u) == 2 else cross(w, u)


class SymbolicFrame:
    """A frame of symbols that read entries of the C array ``name``; see the module."""

    def __init__(self, name: str, dim: int) -> None:
        self.name, self.dim = name, dim
        entries = [symbol(f"{name}[{i}]") for i in range(FRAME[dim])]
        turn = dim + dim * dim
        rotations = 2 * dim - 3

        self.x = Vector(entries[:dim])
        self.R = [Vector(entries[dim + dim * i : dim + dim * (i + 1)]) for i in range(dim)]
        self.v = Vector(entries[turn : turn + dim])
        self.w = Vector(entries[turn + dim : turn + dim + rotations])
        self.phi = entries[-1] if dim == 2 else None
        self.arms: list[tuple[Vector, Vector]] = []  # symbols of directions fixed in the frame, their values

    def axis(self, e: Sequence[Any]) -> Vector:
        """The direction with components ``e`` in the frame, in world axes."""
        values = self._turned(e)
        for known, found in self.arms:
            if found == values:
                return known
        arm = Vector(symbol(f"{self.name}{len(self.arms)}_{i}") for i in range(self.dim))
        self.arms.append((arm, values))
        return arm

    def _turned(self, e: Sequence[Any]) -> Vector:
        return Vector(row @ e for row in self.R)

    def holds(self, e: Sequence[Any]) -> bool:
        """Whether :meth:`axis` was asked for this direction."""
        return any(values == self._turned(e) for _, values in self.arms)

    def point(self, p: Sequence[Any]) -> Vector:
        """The place of the point with coordinates ``p`` in the frame."""
        return self.x + self.axis(p)

    def velocity(self, p: Sequence[Any]) -> Vector:
        """The velocity of that point."""
        return self.v + spin(self.w, self.axis(p))


def symbolic_frames(count: int, dim: int) -> tuple[SymbolicFrame, ...]:
    """So many frames, the first two of them A and B."""
    return tuple(SymbolicFrame("AB"[k] if k < 2 else f"F{k}", dim) for k in range(count))


class AskedConstants:
    """Names the constants of a definition as it asks for them, in this order."""

    def __init__(self, dim: int) -> None:
        self.dim = dim
        self.sizes: dict[str, int] = {}
        self.symbols: list[Expression] = []

    def scalar(self, name: str) -> Expression:
        """A number of each item."""
        return self._more(name, 1)[0]

    def vector(self, name: str, size: int | None = None) -> Vector:
        """A vector of each item, ``dim`` components by default."""
        return Vector(self._more(name, self.dim if size is None else size))

    def sides(self, frames: Sequence[SymbolicFrame]) -> dict[str, int]:
        """Numbers of the frames in whose axes constants are directions, or places; of those that are fixed in one."""
        vectors = [name for name, size in self.sizes.items() if size == self.dim]
        return {name: k for k, frame in enumerate(frames) for name in vectors if frame.holds(self.vector(name))}

    def _more(self, name: str, size: int) -> list[Expression]:
        found = [symbol(f"P_{name}_{i}") for i in range(size)]
        if name not in self.sizes:
            self.sizes[name] = size
            self.symbols += found
        return found


def twist_gradient(y: Expression, frames: Sequence[SymbolicFrame]) -> list[Expression]:
    """Derivatives of y by the twist components of some frames, equations (1)."""
    places = [
        z for f in frames for z in (*f.x, *(c for u, _ in f.arms for c in u), *([] if f.phi is None else [f.phi]))
    ]
    slopes = dict(zip(places, gradient(y, places), strict=True))
    out: list[Expression] = []

    for frame in frames:
        moment = Vector([ZERO] * len(frame.w))
        for u, _ in frame.arms:
            moment = moment + cross(u, [slopes[c] for c in u])
        if frame.phi is not None:
            moment = moment + [slopes[frame.phi]]
        out += [slopes[z] for z in frame.x] + list(moment)
    return out


def twist_of(frames: Sequence[SymbolicFrame]) -> list[Expression]:
    """The twist components of some frames, in the order of :func:`twist_gradient`."""
    return [z for f in frames for z in (*f.v, *f.w)]
