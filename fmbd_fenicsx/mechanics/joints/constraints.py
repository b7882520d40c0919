"""Elementary constraints between two markers; every joint is a list of them, evaluated in batches of one kind.

With markers a, b, positions x, world axes R, angular velocities w, difference d = x_b - x_a, unit vectors n (fixed in space),
e (fixed in a), f (fixed in b) and a smooth offset s(t):

===============  ==========================  ==========================================================
kind             g                           dg/dt
===============  ==========================  ==========================================================
``Coincident``   n . d - s                   n . d' - s'
``Along``        e . d - s                   e . d' + w_a . (e x d) - s'
``Perpendicular``  e . f (e turned by s)     (w_a - w_b) . (e x f) - s' (axis x e) . f
``Distance``     (d . d / L - L) / 2         d . d' / L
===============  ==========================  ==========================================================

The second derivative g'' = G a + gamma uses the twist biases of the markers. A row's multiplier is the generalised force
on the first marker: a row of ``Coincident`` has force +lambda n on a, -lambda n on b.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ...rotations import Array, Motions
from ..frames import Kinematics

Motion = Callable[[float], tuple[float, float, float]]
"""A prescribed motion: t -> (s, s', s'')."""


Sides = Sequence[tuple[np.ndarray, np.ndarray, Array]]


def time_of(t: Any, i: int, n: int) -> float:
    """Time of item i of n: t itself, or that of its copy where t holds the times of equally large copies."""
    return t if np.ndim(t) == 0 else float(t[i * len(t) // n])


def standstill(t: float) -> tuple[float, float, float]:
    """The offset s = 0 of a constraint that nothing drives."""
    return 0.0, 0.0, 0.0


@dataclass(frozen=True)
class Pair:
    """One elementary constraint: kind, the two marker indices, direction in a (or space), direction in b, length, drive."""

    kind: type[Batch]
    a: int
    b: int
    direction: Array
    other: Array | None = None
    length: float = 1.0
    motion: Motion = standstill
    axis: Array | None = None  # in marker a: what a driven ``Perpendicular`` turns about
    constants: Mapping[str, Any] = MappingProxyType({})  # of a kind that has names for them


class Batch:
    """All constraints of one kind. Subclasses give g, the rows of dg/d(twist of a), dg/d(twist of b), and gamma.

    ``on_speeds``: the rows hold between velocities and are no rates of a g, which is then 0 everywhere (nonholonomic).
    """

    on_speeds: ClassVar[bool] = False

    def __init__(self, motions: Motions, pairs: list[Pair]) -> None:
        self.motions = motions
        self.a = np.array([p.a for p in pairs])
        self.b = np.array([p.b for p in pairs])
        self.e = np.array([p.direction for p in pairs], dtype=float)
        self.f = np.array([p.direction if p.other is None else p.other for p in pairs], dtype=float)
        self.length = np.array([p.length for p in pairs])
        self.driven = [(i, p.motion) for i, p in enumerate(pairs) if p.motion is not standstill]
        self.axis = np.array([p.direction if p.axis is None else p.axis for p in pairs], dtype=float)

    def lengths(self, length: float) -> Array:
        """What turns the values of the rows into lengths (m), for a model of a size (m): it, for rows that are angles."""
        return np.ones(len(self.a))

    def repeated(self, k: int, markers: int) -> Batch | None:
        """These constraints k times, copy c on the markers numbered ``c markers`` higher; None where only one copy at a time
        can be evaluated. Times of the result are then one for all copies, or (k,).
        """
        out, m = copy(self), len(self.a)
        shift = markers * np.repeat(np.arange(k), m)
        out.a, out.b = np.tile(self.a, k) + shift, np.tile(self.b, k) + shift
        out.e, out.f, out.axis = (np.tile(x, (k, 1)) for x in (self.e, self.f, self.axis))
        out.length = np.tile(self.length, k)
        out.driven = [(i + c * m, motion) for c in range(k) for i, motion in self.driven]
        return out

    def offsets(self, t: Any) -> Array:
        """(3, m) array of s, s', s''."""
        s = np.zeros((3, len(self.a)))
        for i, motion in self.driven:
            s[:, i] = motion(time_of(t, i, len(self.a)))
        return s

    def values(self, kin: Kinematics, t: float) -> Array:
        """g, shape (m,)."""
        raise NotImplementedError

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """dg/dt = rows_a . twist_a + rows_b . twist_b + rate; each (m, d + n_rot)."""
        raise NotImplementedError

    def rate(self, kin: Kinematics, t: float) -> Array:
        """The part of dg/dt that depends on time only, (m,)."""
        return -self.offsets(t)[1]

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """g'' at zero marker accelerations (the markers' twist bias not included), (m,)."""
        raise NotImplementedError

    def sides(self, kin: Kinematics, t: float) -> Sides:
        """The rows by marker: (numbers of the constraints, markers, rows (k, d + n_rot))."""
        ra, rb = self.rows(kin, t)
        every = np.arange(len(self.a))
        return ((every, self.a, ra), (every, self.b, rb))

    def _join(self, linear: Array, turning: Array) -> Array:
        return np.concatenate((linear, turning), axis=1)

    def _split(self, kin: Kinematics) -> tuple[Array, Array, Array, Array]:
        assert kin.twist is not None
        d = self.motions.dim
        ta, tb = kin.twist[self.a], kin.twist[self.b]
        return ta[:, :d], ta[:, d:], tb[:, :d], tb[:, d:]


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(-1)


class Coincident(Batch):
    """n . (x_b - x_a) = s, n fixed in space."""

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = e . (x_b - x_a) - s(t), m."""
        return _dot(self.e, kin.x[self.b] - kin.x[self.a]) - self.offsets(t)[0]

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Rows -e and e on the velocities of the markers."""
        zero = np.zeros((len(self.a), self.motions.n_rot))
        row = self._join(self.e, zero)
        return -row, row

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """The bias -s'' of a prescribed distance."""
        return -self.offsets(t)[2]


class Along(Batch):
    """e . (x_b - x_a) = s, e fixed in marker a."""

    def _parts(self, kin: Kinematics) -> tuple[Array, Array]:
        return (kin.R[self.a] @ self.e[..., None])[..., 0], kin.x[self.b] - kin.x[self.a]

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = e . (x_b - x_a) - s(t) with e fixed in a, m."""
        e, d = self._parts(kin)
        return _dot(e, d) - self.offsets(t)[0]

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Rows of e . (v_b - v_a) + (e x d) . w_a."""
        e, d = self._parts(kin)
        turn = self.motions.moment(e, d)
        return self._join(-e, turn), self._join(e, np.zeros_like(turn))

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """Centripetal and Coriolis terms of d'' along the turning axis e, less s''."""
        m = self.motions
        e, d = self._parts(kin)
        va, wa, vb, _ = self._split(kin)
        spun = m.spin(wa, e)
        return 2 * _dot(spun, vb - va) + _dot(m.spin(wa, spun), d) - self.offsets(t)[2]


class Perpendicular(Batch):
    """e . f = 0, e fixed in marker a (turned about ``axis`` by the drive), f fixed in marker b."""

    def lengths(self, length: float) -> Array:
        """Cosines: all of them by the length."""
        return np.full(len(self.a), length)

    def _parts(self, kin: Kinematics, t: float) -> tuple[Array, Array, Array]:
        """e, its derivative with respect to the drive angle, and f; world axes."""
        e = self.e
        if self.motions.dim == 3:
            e1 = np.cross(self.axis, self.e)
        else:
            e1 = np.stack((-self.e[:, 1], self.e[:, 0]), -1)
        if self.driven:
            s = self.offsets(t)[0][:, None]
            e, e1 = np.cos(s) * e + np.sin(s) * e1, np.cos(s) * e1 - np.sin(s) * e
        Ra, Rb = kin.R[self.a], kin.R[self.b]
        return (Ra @ e[..., None])[..., 0], (Ra @ e1[..., None])[..., 0], (Rb @ self.f[..., None])[..., 0]

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = e . f of the two axes."""
        e, _, f = self._parts(kin, t)
        return _dot(e, f)

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Rows of (e x f) . (w_a - w_b)."""
        e, _, f = self._parts(kin, t)
        turn = self.motions.moment(e, f)
        zero = np.zeros_like(e)
        return self._join(zero, turn), self._join(zero, -turn)

    def rate(self, kin: Kinematics, t: float) -> Array:
        """g_t of a prescribed angle, by the derivative of the axis e."""
        if not self.driven:
            return np.zeros(len(self.a))
        _, e1, f = self._parts(kin, t)
        return self.offsets(t)[1] * _dot(e1, f)

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """Terms quadratic in the angular velocities, and those of a prescribed angle."""
        m = self.motions
        e, e1, f = self._parts(kin, t)
        _, wa, _, wb = self._split(kin)
        s = self.offsets(t)
        ed, fd = m.spin(wa, e) + s[1][:, None] * e1, m.spin(wb, f)
        edd = m.spin(wa, m.spin(wa, e) + 2 * s[1][:, None] * e1) + s[2][:, None] * e1 - s[1][:, None] ** 2 * e
        return _dot(edd, f) + 2 * _dot(ed, fd) + _dot(e, m.spin(wb, fd))


class Distance(Batch):
    """|x_b - x_a| = L, as (d . d / L - L) / 2 = 0; the multiplier is the force in the rod (positive: tension)."""

    def values(self, kin: Kinematics, t: float) -> Array:
        """g = (d . d / l - l) / 2, m."""
        d = kin.x[self.b] - kin.x[self.a]
        return 0.5 * (_dot(d, d) / self.length - self.length)

    def rows(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """Rows of d . (v_b - v_a) / l."""
        d = (kin.x[self.b] - kin.x[self.a]) / self.length[:, None]
        row = self._join(d, np.zeros((len(d), self.motions.n_rot)))
        return -row, row

    def gamma(self, kin: Kinematics, t: float) -> Array:
        """(v_b - v_a)^2 / l."""
        va, _, vb, _ = self._split(kin)
        return _dot(vb - va, vb - va) / self.length
