"""Relative coordinates of two markers, many of one kind at a time: what springs, drives, gears and sensors act on.

With markers a, b, d = x_b - x_a, unit vectors n (fixed in space) and e, e_1, e_2 (right-handed, fixed in a), f_1, f_2 (fixed
in b):

==============  ==========================================================================  ===================
kind            s                                                                           s'
==============  ==========================================================================  ===================
``Separation``  the distance, sqrt(d . d)                                                   d . d' / s
``Reach``       n . d                                                                       n . d'
``Slide``       e . d                                                                       e . d' + w_a . (e x d)
``Turn``        atan2(e_2 . f_1 - e_1 . f_2, e_1 . f_1 + e_2 . f_2), the angle about e      (w_b - w_a) . e
==============  ==========================================================================  ===================

``Turn`` goes beyond a turn: of the values of atan2 it takes the one nearest to the counted angle of the configuration
(:mod:`.counted`). Its s' is written for parallel axes; the rows are those of the formula itself, also for axes that are not
parallel.
"""

from __future__ import annotations

import numpy as np

from ...rotations import Array, Motions
from ..frames import Kinematics


def nearest(angle: Array, wanted: Array) -> Array:
    """The angles (rad) that differ from the given ones by whole turns and are nearest to those wanted."""
    turns = np.round((wanted - angle) / (2 * np.pi))
    return np.asarray(angle + 2 * np.pi * turns)


def dot(a: Array, b: Array) -> Array:
    """Scalar products over the last axis."""
    return np.asarray((a * b).sum(-1))


class Relative:
    """Coordinates of one kind. ``e`` (m, d) or, for angles in the plane, anything of that shape; see the module."""

    def __init__(self, motions: Motions, a: np.ndarray, b: np.ndarray, e: Array) -> None:
        self.motions, self.a, self.b = motions, np.asarray(a), np.asarray(b)
        self.e = np.asarray(e, dtype=float).reshape(len(self.a), motions.dim)

    def repeated(self, k: int, markers: int) -> Relative:
        """These coordinates k times, copy c on the markers numbered ``c markers`` higher."""
        shift = markers * np.repeat(np.arange(k), len(self.a))
        return type(self)(self.motions, np.tile(self.a, k) + shift, np.tile(self.b, k) + shift, np.tile(self.e, (k, 1)))

    def values(self, kin: Kinematics) -> Array:
        """s, (m,): m or rad."""
        raise NotImplementedError

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """s' = rows_a . twist_a + rows_b . twist_b; each (m, d + n_rot)."""
        raise NotImplementedError

    def gamma(self, kin: Kinematics) -> Array:
        """s'' at zero marker accelerations (the markers' twist bias not included), (m,)."""
        raise NotImplementedError

    def rates(self, kin: Kinematics) -> Array:
        """s', (m,)."""
        assert kin.twist is not None
        ra, rb = self.rows(kin)
        return dot(ra, kin.twist[self.a]) + dot(rb, kin.twist[self.b])

    def share(self, mean: Kinematics, ends: tuple[Array, Array], linear: Array) -> Array:
        """Factor of the rows at the mean of two configurations with which s_1 - s_0 is their product with the motion between,
        ``linear`` without it; 1 for coordinates of second order.
        """
        return np.ones(len(linear))

    def _linear(self, row: Array) -> tuple[Array, Array]:
        row = np.concatenate((row, np.zeros((len(row), self.motions.n_rot))), axis=1)
        return -row, row

    def _twists(self, kin: Kinematics) -> tuple[Array, Array, Array, Array]:
        assert kin.twist is not None
        d = self.motions.dim
        ta, tb = kin.twist[self.a], kin.twist[self.b]
        return ta[:, :d], ta[:, d:], tb[:, :d], tb[:, d:]


class Separation(Relative):
    """Distance of the two points."""

    def values(self, kin: Kinematics) -> Array:
        """s = |d|, m."""
        d = kin.x[self.b] - kin.x[self.a]
        return np.sqrt(dot(d, d))

    def share(self, mean: Kinematics, ends: tuple[Array, Array], linear: Array) -> Array:
        """The distance of the mean points over the mean distance."""
        return np.asarray(2 * self.values(mean) / (ends[0] + ends[1]))

    def direction(self, kin: Kinematics) -> tuple[Array, Array]:
        """Unit vectors from a to b (zero where the points coincide) and distances."""
        d = kin.x[self.b] - kin.x[self.a]
        s = np.sqrt(dot(d, d))
        return d / np.where(s > 0, s, 1.0)[:, None], s

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """Rows of n . (v_b - v_a)."""
        return self._linear(self.direction(kin)[0])

    def gamma(self, kin: Kinematics) -> Array:
        """Centripetal term: velocity across n squared, over s."""
        n, s = self.direction(kin)
        va, _, vb, _ = self._twists(kin)
        return (dot(vb - va, vb - va) - dot(n, vb - va) ** 2) / s


class Reach(Relative):
    """Difference of the two points along directions fixed in space."""

    def values(self, kin: Kinematics) -> Array:
        """s = e . d, m."""
        return dot(self.e, kin.x[self.b] - kin.x[self.a])

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """Rows of e . (v_b - v_a)."""
        return self._linear(self.e)

    def gamma(self, kin: Kinematics) -> Array:
        """None: e is fixed in space."""
        return np.zeros(len(self.a))


class Slide(Relative):
    """Difference of the two points along directions fixed in a."""

    def _parts(self, kin: Kinematics) -> tuple[Array, Array]:
        return (kin.R[self.a] @ self.e[..., None])[..., 0], kin.x[self.b] - kin.x[self.a]

    def values(self, kin: Kinematics) -> Array:
        """s = e . d with e fixed in a, m."""
        return dot(*self._parts(kin))

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """Rows of e . (v_b - v_a) + (e x d) . w_a."""
        e, d = self._parts(kin)
        turn = self.motions.moment(e, d)
        return np.concatenate((-e, turn), 1), np.concatenate((e, np.zeros_like(turn)), 1)

    def gamma(self, kin: Kinematics) -> Array:
        """Centripetal and Coriolis terms of d'' along the turning axis e."""
        m = self.motions
        e, d = self._parts(kin)
        va, wa, vb, _ = self._twists(kin)
        spun = m.spin(wa, e)
        return 2 * dot(spun, vb - va) + dot(m.spin(wa, spun), d)


class Turn(Relative):
    """Rotation of b against a about directions fixed in a, beyond a turn; 0 where the marker axes agree."""

    def __init__(self, motions: Motions, a: np.ndarray, b: np.ndarray, e: Array) -> None:
        super().__init__(motions, a, b, e)
        if motions.dim == 3:
            helper = np.eye(3)[np.argmin(np.abs(self.e), axis=1)]
            e1 = np.cross(self.e, helper)
            self.e1 = e1 / np.linalg.norm(e1, axis=1)[:, None]
            self.e2 = np.cross(self.e, self.e1)
        else:
            self.e1, self.e2 = np.tile([1.0, 0.0], (len(self.a), 1)), np.tile([0.0, 1.0], (len(self.a), 1))

    def _axes(self, R: Array) -> tuple[Array, Array, Array, Array]:
        """e_1, e_2, f_1, f_2 in space for the rotations (..., markers, d, d) of all markers."""
        Ra, Rb = R[..., self.a, :, :], R[..., self.b, :, :]
        e1, e2 = self.e1[..., None], self.e2[..., None]
        return (Ra @ e1)[..., 0], (Ra @ e2)[..., 0], (Rb @ e1)[..., 0], (Rb @ e2)[..., 0]

    def attitude(self, R: Array) -> Array:
        """Angles in (-pi, pi], rad, (..., m), for the rotations (..., markers, d, d) of all markers."""
        e1, e2, f1, f2 = self._axes(R)
        return np.asarray(np.arctan2(dot(e2, f1) - dot(e1, f2), dot(e1, f1) + dot(e2, f2)))

    def values(self, kin: Kinematics) -> Array:
        """Angle from a to b about the axis, rad, followed beyond a full turn."""
        assert kin.turned is not None
        return nearest(self.attitude(kin.R), kin.turned[self.b] - kin.turned[self.a])

    def share(self, mean: Kinematics, ends: tuple[Array, Array], linear: Array) -> Array:
        """The angle turned over 2 tan of its half: w is that of the Cayley map."""
        far = np.abs(linear) > 1e-6
        return np.where(far, np.clip((ends[1] - ends[0]) / np.where(far, linear, 1.0), -10.0, 10.0), 1.0)

    def rows(self, kin: Kinematics) -> tuple[Array, Array]:
        """Rows of the angle on w_b - w_a."""
        e1, e2, f1, f2 = self._axes(kin.R)
        cross = self.motions.moment
        y, x = dot(e2, f1) - dot(e1, f2), dot(e1, f1) + dot(e2, f2)
        dy, dx = -(cross(e2, f1) - cross(e1, f2)), -(cross(e1, f1) + cross(e2, f2))  # on w_b - w_a
        turn = (x[:, None] * dy - y[:, None] * dx) / (x * x + y * y)[:, None]
        row = np.concatenate((np.zeros_like(e1), turn), 1)
        return -row, row

    def gamma(self, kin: Kinematics) -> Array:
        """Terms quadratic in the angular velocities."""
        m = self.motions
        e1, e2, f1, f2 = self._axes(kin.R)
        _, wa, _, wb = self._twists(kin)

        def derivatives(e: Array, f: Array) -> Array:
            ed, fd = m.spin(wa, e), m.spin(wb, f)
            second = dot(m.spin(wa, ed), f) + 2 * dot(ed, fd) + dot(e, m.spin(wb, fd))
            return np.array([dot(e, f), dot(ed, f) + dot(e, fd), second])

        y, yd, ydd = derivatives(e2, f1) - derivatives(e1, f2)
        x, xd, xdd = derivatives(e1, f1) + derivatives(e2, f2)
        r2 = x * x + y * y
        return (x * ydd - y * xdd) / r2 - 2 * (x * xd + y * yd) * (x * yd - y * xd) / r2**2
