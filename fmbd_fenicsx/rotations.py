"""Rigid motions of the plane and of space, many at a time.

A *pose* is a position r and a rotation; a *twist* is (dr/dt, omega): the velocity of the origin in space axes and the
angular velocity in body axes. All functions take arrays with leading axes (one entry a body) and return the same.

==========  ============================  =====================================
            plane (d = 2)                 space (d = 3)
==========  ============================  =====================================
pose        (x, y, phi)                   (x, y, z, quaternion scalar last)
twist       (x', y', phi')                (x', y', z', omega_1, omega_2, omega_3)
==========  ============================  =====================================

The rotation update is R exp(theta~) with theta in body axes; with theta' the rate of the local coordinates,
omega = T(theta) theta' where T is the right tangent operator of SO(3).

Source: Mueller, "Screw and Lie group theory in multibody dynamics", doi:10.1007/s11044-017-9583-6;
Iserles et al., "Lie-group methods", doi:10.1017/S0962492900002154.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import array
from .errors import InputError

Array = NDArray[np.floating[Any]]
Vector = Sequence[float] | Array  # of a user's

NO_ROTATION = 1e-6  # of R^T R - 1
_SMALL = 1e-2  # below this angle (rad) the tangent operators use their series (error < 1e-17)


def hat(a: Array) -> Array:
    """Skew matrices a~ with a~ b = a x b; (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*a.shape, 3), dtype=a.dtype)
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -a[..., 2], a[..., 1], -a[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = a[..., 2], -a[..., 1], a[..., 0]
    return out


def spin_matrix(w: Array) -> Array:
    """w~ with w~ x = w x x, (n_rot,) -> (d, d)."""
    return hat(w) if len(w) == 3 else np.array([[0.0, -w[0]], [w[0], 0.0]])


def axial(N: Array) -> Array:
    """sum P x F from N = sum P F^T, (d, d) -> (n_rot,)."""
    if len(N) == 2:
        return np.array([N[0, 1] - N[1, 0]])
    return np.array([N[1, 2] - N[2, 1], N[2, 0] - N[0, 2], N[0, 1] - N[1, 0]])


def cross3(a: Array, b: Array) -> Array:
    """a x b over the last axis; three times faster than numpy.cross on small arrays."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    first = a1 * b2 - a2 * b1
    out = np.empty((*first.shape, 3), dtype=first.dtype)
    out[..., 0], out[..., 1], out[..., 2] = first, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return out


def matvec(A: Array, x: Array) -> Array:
    """Matrices (.., k, n) times vectors (.., n)."""
    return np.asarray((A @ x[..., None])[..., 0])


def tangents_of(normal: Array) -> list[Array]:
    """d - 1 unit vectors orthogonal to each normal (m, d); of space right-handed with it."""
    if normal.shape[1] == 2:
        return [np.stack((-normal[:, 1], normal[:, 0]), axis=1)]
    # the axis most across the normal
    pick = _ONE[np.abs(normal).argmin(axis=1)]
    a = cross3(normal, pick)
    a = a / np.sqrt((a * a).sum(1))[:, None]
    return [a, cross3(normal, a)]


def quaternion_product(p: Array, q: Array) -> Array:
    """Hamilton product of scalar-last quaternions: the rotation q followed, in space axes, by p."""
    pv = p[..., :3]
    ps = p[..., 3:]
    qv = q[..., :3]
    qs = q[..., 3:]
    return np.concatenate((ps * qv + qs * pv + cross3(pv, qv), ps * qs - (pv * qv).sum(-1, keepdims=True)), axis=-1)


def quaternion_exp(theta: Array) -> Array:
    """Unit quaternion of the rotation vector theta (rad), (..., 3) -> (..., 4)."""
    half = 0.5 * np.sqrt((theta * theta).sum(-1, keepdims=True))
    return np.concatenate((0.5 * np.sinc(half / np.pi) * theta, np.cos(half)), axis=-1)


def quaternion_log(p: Array) -> Array:
    """Rotation vector (norm at most pi) of unit quaternions, (..., 4) -> (..., 3)."""
    # q and -q are one rotation: the smaller angle
    p = np.where(p[..., 3:] < 0, -p, p)
    s = np.sqrt((p[..., :3] ** 2).sum(-1, keepdims=True))
    angle = 2.0 * np.arctan2(s, p[..., 3:])
    # of small angles by the series
    return np.where(s > 1e-8, angle / np.maximum(s, 1e-300), 2.0 + s * s / 3.0) * p[..., :3]


def nearest_rotation(theta: Array, near: Array) -> Array:
    """The rotation vectors (..., 3) that turn as theta does, by whole turns more or less, and lie nearest to ``near``."""
    angle = np.sqrt((theta * theta).sum(-1, keepdims=True))
    guess = np.sqrt((near * near).sum(-1, keepdims=True))
    # where nothing turns the axis is that of ``near``
    axis = np.where(angle > 1e-8, theta / np.maximum(angle, 1e-300), near / np.maximum(guess, 1e-300))
    turns = np.round(((near * axis).sum(-1, keepdims=True) - angle) / (2 * np.pi))
    return np.asarray(theta + 2 * np.pi * turns * axis)


def quaternion_matrix(p: Array) -> Array:
    """Rotation matrices of unit quaternions (scalar last), (..., 4) -> (..., 3, 3): 1 + (its products) times constants."""
    products = (p[..., :, None] * p[..., None, :]).reshape(*p.shape[:-1], 16)
    return (products @ _PRODUCTS).reshape(*p.shape[:-1], 3, 3) + _ONE


def _product_constants() -> Array:
    """Constants (16, 9) that turn products of a quaternion's components into R - 1."""
    C = np.zeros((4, 4, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        C[j, j, i, i] = C[k, k, i, i] = -2.0
        C[i, j, i, j] = C[i, j, j, i] = 2.0
        C[k, 3, i, j], C[k, 3, j, i] = -2.0, 2.0
    return C.reshape(16, 9)


_PRODUCTS, _ONE = _product_constants(), np.eye(3)


def tangent(theta: Array) -> Array:
    """Right tangent operator T of SO(3): omega (body axes) = T(theta) d(theta)/dt; (..., 3) -> (..., 3, 3)."""
    t2 = (theta * theta).sum(-1)[..., None, None]
    t = np.sqrt(t2)
    small = t < _SMALL
    safe = np.where(small, 1.0, t)
    # (1 - cos t) / t^2 and (t - sin t) / t^3, by their series near zero
    a = np.where(small, 0.5 - t2 / 24 + t2 * t2 / 720, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - t2 / 120 + t2 * t2 / 5040, (safe - np.sin(safe)) / safe**3)

    H = hat(theta)
    return np.eye(3) - a * H + b * (H @ H)


def tangent_inverse(theta: Array) -> Array:
    """Inverse of :func:`tangent`; regular for rotation angles below 2 pi; also of the complex theta of a complex step."""
    t2 = (theta * theta).sum(-1)[..., None, None]
    small = t2.real < _SMALL**2
    safe = np.sqrt(np.where(small, 1.0, t2))
    # (1 - t / 2 cot(t / 2)) / t^2, by its series near zero
    c = np.where(small, 1 / 12 + t2 / 720 + t2 * t2 / 30240, (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2)

    H = hat(theta)
    return np.eye(3) + 0.5 * H + c * (H @ H)


def _together(*parts: Array) -> Array:
    """Arrays of one shape along a new last axis; of small arrays four times faster than numpy.stack."""
    out = np.empty((*parts[0].shape, len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out


@dataclass(frozen=True)
class Motions:
    """The group of rigid motions in d dimensions: sizes and operations on arrays of poses and twists."""

    dim: int  # d
    n_rot: int  # components of an angular velocity
    n_pose: int  # numbers that store a pose
    n_twist: int  # numbers of a twist

    @property
    def identity(self) -> Array:
        """The pose r = 0, R = 1; shape (n_pose,)."""
        q = np.zeros(self.n_pose)
        if self.dim == 3:
            q[6] = 1.0
        return q

    def matrix(self, q: Array) -> Array:
        """Rotation matrices of poses, (..., n_pose) -> (..., d, d)."""
        if self.dim == 3:
            return quaternion_matrix(q[..., 3:])
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        if q.ndim == 1:
            return np.array([[c, -s], [s, c]])
        return _together(c, -s, s, c).reshape(*c.shape, 2, 2)

    def compose(self, q: Array, xi: Array) -> Array:
        """Pose after the increment xi: (r + xi_r, R exp(xi_theta))."""
        if self.dim == 2:
            return q + xi
        p = quaternion_product(q[..., 3:], quaternion_exp(xi[..., 3:]))
        # products of unit quaternions drift by roundoff
        p = p / np.sqrt((p * p).sum(-1, keepdims=True))
        return np.concatenate((q[..., :3] + xi[..., :3], p), axis=-1)

    def difference(self, q0: Array, q1: Array, near: Array | None = None) -> Array:
        """The increment xi with compose(q0, xi) = q1: the smallest rotation, or the one nearest to that of ``near``."""
        if self.dim == 2:
            return q1 - q0
        inverse = q0[..., 3:] * np.array([-1.0, -1.0, -1.0, 1.0])
        rotation = quaternion_log(quaternion_product(inverse, q1[..., 3:]))
        if near is not None:
            rotation = nearest_rotation(rotation, near[..., 3:])
        return np.concatenate((q1[..., :3] - q0[..., :3], rotation), axis=-1)

    def rate(self, xi: Array, v: Array) -> Array:
        """d(xi)/dt of the local coordinates for the twist v: (v_r, T(xi_theta)^-1 omega)."""
        if self.dim == 2:
            return v
        w = (tangent_inverse(xi[..., 3:]) @ v[..., 3:, None])[..., 0]
        return np.concatenate((v[..., :3], w), axis=-1)

    def spin(self, w: Array, x: Array) -> Array:
        """omega x x; (..., n_rot), (..., d) -> (..., d)."""
        if self.dim == 3:
            return cross3(w, x)
        return _together(-x[..., 1], x[..., 0]) * w[..., 0:1]

    def moment(self, x: Array, f: Array) -> Array:
        """x x f; (..., d), (..., d) -> (..., n_rot)."""
        if self.dim == 3:
            return cross3(x, f)
        return (x[..., 0] * f[..., 1] - x[..., 1] * f[..., 0])[..., None]

    def lever(self, x: Array) -> Array:
        """Matrix A with A w = w x x, (..., d) -> (..., d, n_rot)."""
        if self.dim == 3:
            return -hat(x)
        return _together(-x[..., 1], x[..., 0])[..., None]

    def rigid(self, x: Array) -> Array:
        """Displacements (n, d, n_twist) of points x (n, d) by unit translations and unit rotations about the origin."""
        d = self.dim
        out = np.zeros((len(x), d, self.n_twist))
        out[:, range(d), range(d)] = 1.0
        out[:, :, d:] = self.lever(x)
        return out

    def turn(self, R: Array, w: Array) -> Array:
        """Angular velocity from body to space axes."""
        return (R @ w[..., None])[..., 0] if self.dim == 3 else w

    def pose(self, position: Array, rotation: Any = None) -> Array:
        """Pose from a position (d,) and a rotation: None, an angle (plane), a matrix, quaternion or SciPy's Rotation (space)."""
        q = self.identity
        q[: self.dim] = position
        if rotation is None:
            return q
        if hasattr(rotation, "as_quat"):
            rotation = rotation.as_quat()
        given = array("rotation", rotation, shape="numbers: an angle, a matrix or a quaternion")
        shapes = ((), (2, 2)) if self.dim == 2 else ((4,), (3, 3))
        if given.shape not in shapes or not (given.ndim == 0 or given.any()):
            wanted = "an angle (rad)" if self.dim == 2 else "a matrix (3, 3) or a quaternion (4,), scalar last"
            raise InputError(f"A rotation is {wanted}, finite; found {rotation!r}.")
        if given.ndim == 2:
            refuse_no_rotation(given)

        if self.dim == 2:
            q[2] = float(given) if given.ndim == 0 else np.arctan2(given[1, 0], given[0, 0])
            return q
        if given.shape == (3, 3):
            from scipy.spatial.transform import Rotation

            given = Rotation.from_matrix(given).as_quat()
        q[3:] = given / np.linalg.norm(given)
        return q


def refuse_no_rotation(R: Array) -> None:
    """Refuse a matrix with R^T R other than 1, or that mirrors: it is not made orthogonal, as nobody knows what was meant."""
    off = float(np.abs(R.T @ R - np.eye(len(R))).max())
    if not off < NO_ROTATION:
        raise InputError(
            f"rotation {R.tolist()} is no rotation matrix: R^T R differs from 1 by {off:.2g}. "
            "Make one of angles with scipy.spatial.transform.Rotation."
        )
    if not np.linalg.det(R) > 0:
        raise InputError(f"rotation {R.tolist()} mirrors: its determinant is -1. Change the sign of one column.")


PLANE = Motions(dim=2, n_rot=1, n_pose=3, n_twist=3)
SPACE = Motions(dim=3, n_rot=3, n_pose=7, n_twist=6)


def motions(dim: int) -> Motions:
    """The rigid motions of the plane (2) or of space (3)."""
    return {2: PLANE, 3: SPACE}[dim]


def rotate_nodal(x: Array, R: Array | None, back: bool = False) -> Array:
    """Nodal vectors x (n d,), or columns (n d, k), turned by R (d, d), or back by R^T; x itself without a rotation."""
    if R is None:
        return x
    if x.ndim > 1:
        return np.asarray(((R.T if back else R) @ x.reshape(-1, len(R), x.shape[1])).reshape(x.shape))
    return np.asarray((x.reshape(-1, len(R)) @ (R if back else R.T)).ravel())
