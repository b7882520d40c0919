"""Shapes by their signed distance: d(y) in metres, positive outside, and its unit gradient, in the shape's own axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, ClassVar

import numpy as np

from ..checks import check_fields, number, shown, vector
from ..errors import CallbackError, floats, named, require
from ..log import log
from ..rotations import Array, Vector, motions
from .body import ORIGIN


def _unit(v: Vector, what: str) -> Array:
    a = vector(what, v, zero=False)
    a = a / np.abs(a).max()
    return np.asarray(a / np.linalg.norm(a))


class Shape:
    """A signed distance in the shape's own axes. ``thickness`` (m) is the shortest way through it."""

    thickness: float = np.inf
    made_by: ClassVar[str] = "a shape: HalfSpace, Sphere, Cylinder, Box, SignedDistance"

    def check(self, what: str, dim: int) -> None:
        """Refuse vectors of another dimension than the scene's."""
        for name in ("point", "normal", "center", "size"):
            if name in vars(self):
                vector(f"{what}: {name}", vars(self)[name], size=None if vars(self)[name] is ORIGIN else dim)

    def evaluate(self, y: Array) -> tuple[Array, Array]:
        """Distances (n,) and unit gradients (n, d) at points y (n, d)."""
        return self.distance(y, self.numbers(y.shape[1]))

    def edged(self, y: Array, reach: float) -> Array:
        """Which of the points y (n, d) have an edge within ``reach`` (m), (n,) bool: normals beside them differ by 45 degrees."""
        n, d = y.shape
        beside = np.concatenate([y + sign * reach * e for e in np.eye(d) for sign in (1.0, -1.0)])
        here, there = self.evaluate(y)[1], self.evaluate(beside)[1].reshape(2 * d, n, d)
        return np.asarray((here * there).sum(2).min(axis=0) < np.cos(np.pi / 4) + 1e-6)

    def numbers(self, dim: int) -> tuple[Any, ...]:
        """What :meth:`distance` reads, in the order in which the compiled driver reads it."""
        raise NotImplementedError

    def held(self, dim: int) -> tuple[Array, float, float] | None:
        """A place, how far what turns about it is from it, and the radius of a sphere there that holds all; None: no end."""
        return None

    @staticmethod
    def distance(y: Array, numbers: tuple[Any, ...]) -> tuple[Array, Array]:
        """As :meth:`evaluate`, from the :meth:`numbers` of one shape, or of one for each point: arrays with n in front."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class HalfSpace(Shape):
    """Everything below a plane through ``point``; ``normal`` points out of the obstacle."""

    point: Vector
    normal: Vector

    def __post_init__(self) -> None:
        check_fields(self)
        _unit(self.normal, "HalfSpace: normal")
        vector("HalfSpace: point", self.point)
        require(
            len(self.point) == len(self.normal),
            f"HalfSpace: point {self.point} and normal {self.normal} must have the same number of components.",
        )

    def numbers(self, dim: int) -> tuple[Any, ...]:
        """Unit normal, and the level of the plane along it."""
        normal = _unit(self.normal, "HalfSpace: normal")[:dim]
        return normal, np.asarray(self.point, dtype=float)[:dim] @ normal

    @staticmethod
    def distance(y: Array, numbers: tuple[Any, ...]) -> tuple[Array, Array]:
        """Gap over the plane and its normal; see :class:`Shape`."""
        normal, level = numbers
        gap = (y[:, None, :] @ normal[..., None])[..., 0, 0] - level
        return gap, normal if normal.shape == y.shape else np.broadcast_to(normal, y.shape)


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball (in the plane: a disk) of ``radius`` m; ``inside`` makes it a hollow in which bodies lie."""

    radius: float
    center: Vector = ORIGIN
    inside: bool = False

    def __post_init__(self) -> None:
        number("Sphere: radius", self.radius, above=0.0, unit="m")
        check_fields(self)

    @property
    def thickness(self) -> float:  # type: ignore[override]
        """Diameter; a hollow has no other side."""
        return np.inf if self.inside else 2.0 * self.radius

    def numbers(self, dim: int) -> tuple[Any, ...]:
        """Centre, radius, 1 or -1 for a hollow."""
        return np.asarray(self.center, dtype=float)[:dim], self.radius, -1.0 if self.inside else 1.0

    def held(self, dim: int) -> tuple[Array, float, float] | None:
        """Itself, which turns in itself."""
        return None if self.inside else (self.numbers(dim)[0], 0.0, self.radius)

    @staticmethod
    def distance(y: Array, numbers: tuple[Any, ...]) -> tuple[Array, Array]:
        """Distance from the circle or sphere and its radial normal; see :class:`Shape`."""
        center, radius, sign = numbers
        r = y - center
        length = np.linalg.norm(r, axis=1)
        # at the centre any normal serves
        n = np.where(length[:, None] > 0, r / np.where(length > 0, length, 1.0)[:, None], np.eye(y.shape[1])[0])
        return sign * (length - radius), np.reshape(sign, (-1, 1)) * n


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A solid cylinder of ``radius`` about ``axis`` through ``center``, of ``length`` (m; infinite by
    default). 3D.
    """

    radius: float
    axis: Vector
    center: Vector = (0.0, 0.0, 0.0)
    length: float = np.inf

    def __post_init__(self) -> None:
        number("Cylinder: radius", self.radius, above=0.0, unit="m")
        check_fields(self)
        vector("Cylinder: axis", self.axis, size=3, zero=False)
        vector("Cylinder: center", self.center, size=3)
        require(self.length > 0, f"Cylinder: length {self.length} m must be positive.")

    @property
    def thickness(self) -> float:  # type: ignore[override]
        """The smaller of diameter and length."""
        return min(2.0 * self.radius, self.length)

    def numbers(self, dim: int) -> tuple[Any, ...]:
        """Unit vector along the axis, centre, radius, length."""
        require(dim == 3, "Cylinder is a shape of space; use Sphere for a disk in the plane.")
        return _unit(self.axis, "Cylinder: axis"), np.asarray(self.center, dtype=float), self.radius, self.length

    def held(self, dim: int) -> tuple[Array, float, float] | None:
        """About its middle, through its rims."""
        far = float(np.hypot(self.radius, 0.5 * self.length))
        return (np.asarray(self.center, dtype=float), far, far) if np.isfinite(far) else None

    @staticmethod
    def distance(y: Array, numbers: tuple[Any, ...]) -> tuple[Array, Array]:
        """Distance from the cylinder, rounded outside its rims, and its gradient; see :class:`Shape`."""
        e, center, radius, length = numbers
        r = y - center
        # along the axis, and across it
        z = (r * e).sum(1)
        across = r - z[:, None] * e
        rho = np.linalg.norm(across, axis=1)
        n_side = across / np.where(rho > 0, rho, 1.0)[:, None]

        n_cap = np.sign(z)[:, None] * e
        return _rounded(rho - radius, np.abs(z) - 0.5 * np.asarray(length), n_side, n_cap)


def _rounded(a: Array, b: Array, na: Array, nb: Array) -> tuple[Array, Array]:
    """Distance to the intersection of two orthogonal convex sets at distances a, b."""
    both = (a > 0) & (b > 0)
    d = np.where(both, np.hypot(a, b), np.maximum(a, b))
    # weights of the two normals: outside an edge the direction to it, else that of the nearer set
    w = np.where(both, a / np.where(both, d, 1.0), (a >= b).astype(float))
    u = np.where(both, b / np.where(both, d, 1.0), (a < b).astype(float))
    return d, w[:, None] * na + u[:, None] * nb


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box (in the plane: a rectangle) with edges ``size`` (m, (d,)) about ``center``, along the shape's axes or turned
    from them by ``rotation``: an angle (rad) in the plane; in space a matrix (3, 3), quaternion (scalar last) or SciPy's
    Rotation.
    """

    size: Vector
    center: Vector = ORIGIN
    rotation: Any = None

    def __post_init__(self) -> None:
        check_fields(self)
        size = vector("Box: size", self.size)
        require(
            bool((size > 0).all()) and len(size) in (2, 3), f"Box: size {self.size} must be 2 or 3 positive lengths."
        )
        self.axes  # noqa: B018, refuses what is no rotation

    @cached_property
    def axes(self) -> Array:
        """Directions of the edges, columns, (d, d)."""
        m = motions(len(self.size))
        return np.asarray(m.matrix(m.pose(np.zeros(m.dim), self.rotation)))

    @property
    def thickness(self) -> float:  # type: ignore[override]
        """The shortest edge."""
        return float(np.min(np.asarray(self.size, dtype=float)))

    def numbers(self, dim: int) -> tuple[Any, ...]:
        """Half edges, centre, directions of the edges, rows."""
        half = np.asarray(self.size, dtype=float)[:dim] / 2
        require(len(half) == dim and bool((half > 0).all()), f"Box: size {self.size!r} must be {dim} positive lengths.")
        return half, np.asarray(self.center, dtype=float)[:dim], self.axes.T

    def held(self, dim: int) -> tuple[Array, float, float] | None:
        """About its middle, through its corners."""
        half, middle, _ = self.numbers(dim)
        far = float(np.linalg.norm(half))
        return middle, far, far

    @staticmethod
    def distance(y: Array, numbers: tuple[Any, ...]) -> tuple[Array, Array]:
        """Distance from the box, rounded outside its edges, and its gradient; see :class:`Shape`."""
        half, center, edges = numbers
        r = (edges @ (y - center)[:, :, None])[:, :, 0]
        # outside: distance to the nearest point of the box; inside: to the nearest side
        over = np.abs(r) - half
        outside = np.maximum(over, 0.0)
        far = np.linalg.norm(outside, axis=1)
        inner = over.max(axis=1)
        d = np.where(far > 0, far, inner)

        side = np.where(r < 0, -1.0, 1.0)
        n_in = side * (np.arange(y.shape[1]) == over.argmax(axis=1)[:, None])
        n_out = side * outside / np.where(far > 0, far, 1.0)[:, None]
        local = np.where(far[:, None] > 0, n_out, n_in)
        return d, (local[:, None] @ edges)[:, 0]


KNOWN = (HalfSpace, Sphere, Cylinder, Box)  # given by numbers, in the order of the compiled driver


Distance = Callable[[Array], tuple[Array, Array]]


def distances(shapes: list[Shape], of: np.ndarray, dim: int) -> list[tuple[np.ndarray, Distance]]:
    """Which points see shapes of one kind, and what tells their distances and gradients in one call.

    ``of`` (m,): number of the shape that each point sees.
    """
    kinds: dict[Any, list[int]] = {}
    for i, shape in enumerate(shapes):
        kinds.setdefault(type(shape) if type(shape) in KNOWN else id(shape), []).append(i)

    found: list[tuple[np.ndarray, Distance]] = []
    for members in kinds.values():
        first = shapes[members[0]]
        place = np.full(len(shapes), -1)
        place[members] = np.arange(len(members))
        at = np.flatnonzero(place[of] >= 0)
        if type(first) not in KNOWN:
            found.append((at, first.evaluate))
            continue
        numbers = zip(*(shapes[i].numbers(dim) for i in members), strict=True)
        found.append((at, partial(first.distance, numbers=tuple(np.array(x)[place[of[at]]] for x in numbers))))
    return found


@dataclass(frozen=True, eq=False)
class SignedDistance(Shape):
    """A user's level function phi(x), negative inside: a NumPy function (d, n) -> (n,) or a UFL expression
    of a coordinate.

    Where |grad phi| is not one, phi / |grad phi| is used, the distance to first order, and a warning says so once.
    Gradients by central differences of fourth order with steps of 1e-4 ``scale`` (m).
    """

    function: Any
    scale: float = 1.0
    thickness: float = np.inf
    _warned: list[bool] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        require(
            callable(self.function),
            f"SignedDistance: function {shown(self.function)} must be a function of points (d, n), or a UFL expression.",
        )
        check_fields(self)
        number("SignedDistance: scale", self.scale, above=0.0, unit="m")
        require(self.thickness > 0, f"SignedDistance: thickness = {self.thickness} m must be positive.")

    def values(self, y: Array) -> Array:
        """phi at points (n, d)."""
        if hasattr(self.function, "ufl_shape"):
            return np.array([float(self.function(tuple(p))) for p in y])
        told = named("The function of", "SignedDistance", self.function, time=None)(y.T)
        try:
            found: Array = floats(told)
        except (TypeError, ValueError):
            raise CallbackError(
                f"SignedDistance: the function returned {shown(told)}, expected ({len(y)},) finite numbers."
            ) from None

        if found.shape != (len(y),) or not np.isfinite(found).all():
            raise CallbackError(
                f"SignedDistance: the function returned shape {found.shape}"
                f"{'' if np.isfinite(found).all() else ' with values that are not finite'}, expected "
                f"({len(y)},) finite numbers: of points (d, n), x[0] are their abscissae."
            )
        return found

    def evaluate(self, y: Array) -> tuple[Array, Array]:
        """The function over the length of its gradient, by central differences, and the normal; see :class:`Shape`."""
        phi = self.values(y)
        h = 1e-4 * self.scale

        grad = np.empty_like(y)
        for k in range(y.shape[1]):
            e = np.eye(y.shape[1])[k] * h
            plus, minus, plus2, minus2 = (self.values(y + c * e) for c in (1, -1, 2, -2))
            grad[:, k] = (8 * (plus - minus) - (plus2 - minus2)) / (12 * h)

        size = np.linalg.norm(grad, axis=1)
        if (size <= 0).any():
            raise CallbackError(
                "SignedDistance: the gradient vanishes at a contact point; a distance has a unit gradient."
            )
        if not self._warned and np.abs(size - 1).max(initial=0.0) > 1e-6:
            self._warned.append(True)
            log.warning(
                "SignedDistance: the gradient has size %.3g ... %.3g instead of 1; the function is divided by it.",
                size.min(),
                size.max(),
            )
        return phi / size, grad / size[:, None]
