"""Constraints on joint coordinates and constraints of the user's own: gears, screws, drives, any g(poses, t) = 0.

    coupling     sum_k c_k s_k(q) - motion(t) = 0            s_k: relative coordinates of markers                 (1)
    own joint    g(x_a, R_a, x_b, R_b, t) = 0                a function of two marker poses                       (2)

The rows of (2) are derivatives of g under x -> x + delta and R -> (1 + delta~) R, by complex steps (exact to roundoff) when g
accepts complex arrays, else by central differences; its g'' is the change of the row products along the motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ...checks import function as checked_function
from ...errors import ROUNDINGS, CallbackError, FmbdError, named, require
from ...log import log
from ...rotations import Array, Motions, hat
from ..bodies.coordinates import derivative, differences
from ..frames import Kinematics
from .constraints import Batch, Motion, Sides
from .relative import Relative
from .time_derivatives import rates


@dataclass(frozen=True, eq=False)
class SmoothMotion:
    """A prescribed motion t -> (s, s', s'') by a function of the user's own. ``of``: what is moved, in messages.

    ``function`` gives these three where ``complete``, else s alone; the derivatives are then computed
    (:mod:`.time_derivatives`), to roundoff where the function is made of NumPy's functions.
    """

    name: str
    function: Callable[[Any], Any]
    of: str
    complete: bool
    differenced: Callable[[Any], Any]  # the function up to its very end

    def __call__(self, t: float) -> tuple[float, float, float]:
        """s, s', s'' at a time."""
        if self.complete:
            s = self._checked(self.function(t), t)
            self._require(len(s) == 3, s, t)
            return float(s[0]), float(s[1]), float(s[2])
        s = self._checked((self.place(t), *self.rates(t)), t)
        return float(s[0]), float(s[1]), float(s[2])

    def moving(self, t: float) -> tuple[float, float]:
        """s and s' at a time."""
        if self.complete:
            return self(t)[:2]
        return self.place(t), self.rates(t)[0]

    def rates(self, t: float) -> tuple[float, float]:
        """s' and s'' of a function that gives s alone; a few roundings behind its end those at its end."""
        inside = t * (1.0 - ROUNDINGS)
        try:
            found = rates(self.differenced, t)
        except FmbdError:
            return rates(self.differenced, inside)
        return found if isfinite(found[0]) and isfinite(found[1]) else rates(self.differenced, inside)

    def place(self, t: float) -> float:
        """s alone."""
        value = self.function(t)
        if isinstance(value, float) and not self.complete and isfinite(value):
            return value
        s = self._checked(value, t)
        self._require(len(s) == (3 if self.complete else 1), s, t)
        return float(s[0])

    def _checked(self, value: Any, t: float) -> Array:
        """The numbers that the function returned, (1,) or (3,)."""
        try:
            found: Array = np.asarray(value, dtype=float).ravel()
        except (TypeError, ValueError, OverflowError):
            found = np.array(np.nan)
        self._require(found.shape in ((1,), (3,)) and bool(np.isfinite(found).all()), value, t)
        return found

    def _require(self, usable: bool, value: Any, t: float) -> None:
        if not usable:
            raise CallbackError(
                f"Joint \"{self.name}\": the motion returned {value!r} at t = {t:g} s, expected s or (s, s', s''), finite and "
                "the same at all times."
            )


def _with_its_derivatives(function: Callable[[float], Any]) -> Callable[[float], Any]:
    """An interpolation that knows its derivatives, by ``derivative(order)`` as SciPy's do, as t -> (s, s', s'') by these;
    any other function as it is.
    """
    try:
        first, second = (function.derivative(order) for order in (1, 2))  # type: ignore[attr-defined]
        known = all(np.size(one(0.0)) == 1 for one in (function, first, second))
    except Exception:
        return function  # what it has by this name is no derivative
    return (lambda t: np.array([function(t), first(t), second(t)], dtype=float)) if known else function


def smooth_motion(name: str, function: Callable[[float], Any], *, of: str = "drive") -> SmoothMotion:
    """A prescribed motion from a function that returns (s, s', s'') or s alone; it must be smooth.

    Whether it is, and whether its rates are those of its motion, is looked at along the run
    (:mod:`fmbd_fenicsx.run.judges.prescribed_motions`). ``of``: what is moved, in messages.
    """
    checked_function(f'{of.capitalize()} "{name}": motion', function, "t", named="t")
    function = _with_its_derivatives(function)
    asked = named(f"The motion of {of}", name, function, to_end=True)
    differenced = named(f"The motion of {of}", name, function)
    first = SmoothMotion(name, asked, of, False, differenced)._checked(asked(0.0), 0.0)
    return SmoothMotion(name, asked, of, len(first) == 3, differenced)


class CouplingBatch(Batch):
    """Rows (1). ``terms``: (relative coordinates of one kind, constraint numbers, coefficients)."""

    def __init__(self, terms: list[tuple[Relative, np.ndarray, Array]], motions: list[Motion | None]) -> None:
        self.terms, self.size = terms, len(motions)
        self.driven = [(i, m) for i, m in enumerate(motions) if m is not None]

    def lengths(self, length: float) -> Array:
        """Sums of angles alone are angles; a coefficient turns those beside a distance into one."""
        linear = np.zeros(self.size, dtype=bool)
        for relative, rows, _ in self.terms:
            linear[rows] |= not relative.angular

        return np.where(linear, 1.0, length)

    def offsets(self, t: float) -> Array:
        """(3, m) array of s, s', s''."""
        s = np.zeros((3, self.size))
        # couplings without a motion stand still
        for i, motion in self.driven:
            s[:, i] = motion(t)
        return s

    def _sum(self, parts: list[Array]) -> Array:
        out = np.zeros(self.size)
        for (_, rows, c), value in zip(self.terms, parts, strict=True):
            out += np.bincount(rows, c * value, self.size)
        return out

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = sum c_k s_k - s(t)."""
        return self._sum([r.values(kin) for r, _, _ in self.terms]) - self.offsets(t)[0]

    def rate(self, kin: Kinematics, t: float) -> Array:
        """g_t = -s'(t)."""
        return -self.offsets(t)[1]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """sum c_k gamma_k - s''(t)."""
        return self._sum([r.gamma(kin) for r, _, _ in self.terms]) - self.offsets(t)[2]

    def sides(self, kin: Kinematics, t: float) -> Sides:
        """Rows of every joint coordinate times its factor c_k."""
        out = []
        for relative, rows, c in self.terms:
            ra, rb = relative.rows(kin)
            out += [(rows, relative.a, c[:, None] * ra), (rows, relative.b, c[:, None] * rb)]
        return out


class OwnBatch(Batch):
    """Rows (2) of one joint of the user's own, between markers a and b."""

    def __init__(self, motions: Motions, name: str, function: Callable[..., Any], markers: tuple[int, int]) -> None:
        self.motions, self.name, self.function = motions, name, named("The constraint of joint", name, function)
        self.markers = np.array(markers)
        self.driven: list[tuple[int, Motion]] = []
        self.by_differences: bool | None = None  # decided at the first derivative
        self._count: int | None = None  # rows: as many as the first call gives

    def lengths(self, length: float) -> Array:
        """In units of the user's own: taken as they are."""
        return np.ones(1)

    def _checked(self, value: Any, t: float) -> Any:
        found = np.atleast_1d(np.asarray(value))
        if found.ndim != 1 or found.dtype.kind not in "iufc" or not np.isfinite(found).all():
            raise CallbackError(
                f'Joint "{self.name}": its function returned {value!r} at t = {t:g} s, expected finite numbers.'
            )
        self._count = len(found) if self._count is None else self._count
        if len(found) != self._count:
            raise CallbackError(
                f'Joint "{self.name}": its function returned {len(found)} numbers at t = {t:g} s and {self._count} before; '
                "a joint has the same rows at all times."
            )
        return found

    def _at(self, x: Array, R: Array, t: float) -> Any:
        return self._checked(self.function(x[0], R[0], x[1], R[1], t), t)

    def _poses(self, kin: Kinematics) -> tuple[Array, Array]:
        return kin.x[self.markers], kin.R[self.markers]

    def _moved(self, x: Array, R: Array, twist: Any, s: float = 1.0) -> tuple[Any, Any]:
        """Poses after the small displacement s twist, (2, d + n_rot), to first order in the rotation."""
        d = self.motions.dim
        turn = s * twist[:, d:]
        W = hat(turn) if d == 3 else turn[:, :, None] * np.array([[0.0, -1.0], [1.0, 0.0]])
        return x + s * twist[:, :d], R + W @ R

    def _derivative(self, x: Array, R: Array, t: float) -> Array:
        """dg / d(displacements of both markers), (m, 2 (d + n_rot))."""
        n = self.motions.dim + self.motions.n_rot

        def g(z: Any) -> Any:
            return self._at(*self._moved(x, R, z.reshape(2, n)), t)

        if self.by_differences is None:  # abs() and the like drop the imaginary part without a word
            exact = derivative(g, np.zeros(2 * n))
            rough = differences(g, np.zeros(2 * n))
            self.by_differences = bool(np.abs(exact - rough).max() > 1e-5 * max(1.0, np.abs(rough).max()))
            if self.by_differences:
                log.warning(
                    'joint "%s": complex steps fail in its function (abs, float?); using differences',
                    self.name,
                )
            self._refuse_still_rows(rough if self.by_differences else exact)
        return differences(g, np.zeros(2 * n)) if self.by_differences else derivative(g, np.zeros(2 * n))

    def _refuse_still_rows(self, rows: Array) -> None:
        """Refuse numbers that no motion of the markers changes where they start."""
        still = np.flatnonzero(~rows.any(axis=1))
        which = ", ".join(str(k) for k in still)
        require(
            not still.size,
            f'Joint "{self.name}": number {which} of those that its function returns does not change with the places and '
            "rotations of the two markers where they start, so it holds nothing. Return what is zero where the joint is closed "
            "and only there; point_a and point_b say where the markers sit.",
        )

    def _time(self, x: Array, R: Array, t: float) -> Array:
        return derivative(lambda s: self._at(x, R, s[0]), np.array([t]))[:, 0]

    def values(self, kin: Kinematics, t: float) -> Array:
        """The given function of the poses of its markers and of time."""
        return np.asarray(np.real(self._at(*self._poses(kin), t)), dtype=float)

    def rate(self, kin: Kinematics, t: float) -> Array:
        """g_t by a complex step in time."""
        return self._time(*self._poses(kin), t)

    def sides(self, kin: Kinematics, t: float) -> Sides:
        """Rows by complex steps in the twists of the markers."""
        n = self.motions.dim + self.motions.n_rot
        J = self._derivative(*self._poses(kin), t)
        rows = np.arange(len(J))
        return [(rows, np.full(len(J), marker), J[:, i * n : (i + 1) * n]) for i, marker in enumerate(self.markers)]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """Second derivative along the motion with frozen twists, by differences."""
        assert kin.twist is not None
        x, R, twist = *self._poses(kin), kin.twist[self.markers]
        d = self.motions.dim
        fast = max(1.0, float(np.abs(twist).max()))

        def level(s: float) -> Array:
            turn = s * twist[:, d:]
            if d == 3:
                from scipy.spatial.transform import Rotation

                Rs = Rotation.from_rotvec(turn).as_matrix() @ R
            else:
                c, w = np.cos(turn[:, 0]), np.sin(turn[:, 0])
                Rs = np.array([[[ci, -wi], [wi, ci]] for ci, wi in zip(c, w, strict=True)]) @ R
            xs = x + s * twist[:, :d]
            return self._derivative(xs, Rs, t + s) @ twist.ravel() + self._time(xs, Rs, t + s)

        h = 1e-3 / fast
        steps = [level(k * h) - level(-k * h) for k in (1, 2, 3)]
        return np.asarray((45 * steps[0] - 9 * steps[1] + steps[2]) / (60 * h))


def lead_ratio(lead: float) -> float:
    """Displacement per angle of a screw that advances ``lead`` (m) in one turn, m/rad."""
    return lead / (2 * math.pi)
