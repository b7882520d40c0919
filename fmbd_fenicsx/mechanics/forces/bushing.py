"""Bushings: a linear stiffness and damping for all relative displacements and rotations of two markers.

With the markers' rotations since the start R_a, R_b, the position d of b against a and axes E fixed in a,

    s = (E R_a^T d, E log(R_a^T R_b)),     s' = B (twist_a, twist_b),     wrenches = -B^T (K s + C s').        (1)

s are the displacements along and the rotation vector about the axes; in the plane the rotation is one angle. B is the exact
derivative of s, so the wrenches of K come from the potential s . K s / 2, at rotations up to half a turn. The stiffness of
(1) at fixed twists, with its geometric part, is taken by complex steps of (1) itself: exact to roundoff.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...checks import array, typed
from ...errors import InputError, require
from ...rotations import Array, Motions, hat, spin_matrix, tangent_inverse
from ..frames import Kinematics
from ..joints.joints import dimension
from ..kinds.jets import COMPLEX_STEP
from .force_elements import Loads, MarkerTangent
from .forces import Force

_SMALL = 1e-4  # squared sine below which the rotation vector comes from its series


def rotation_vector(R: Array) -> Array:
    """log R as a vector, (..., 3); also of the complex R of a complex step. Angles below a half turn."""
    axis = 0.5 * np.stack(
        (R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]), axis=-1
    )
    sine2 = (axis * axis).sum(-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    small = (sine2.real < _SMALL) & (cosine.real > 0)
    sine = np.sqrt(np.where(small, 1.0, sine2))
    series = 1 + sine2 / 6 + 3 * sine2**2 / 40 + 15 * sine2**3 / 336 + 105 * sine2**4 / 3456
    angle_over_sine = np.where(small, series, 2 * np.arctan(sine / (1 + cosine)) / sine)
    return np.asarray(angle_over_sine[..., None] * axis)


def rotation_rate(theta: Array) -> Array:
    """Matrix J with theta' = J w for the rotation vector theta and an angular velocity w in the same axes, (..., 3, 3)."""
    return tangent_inverse(-theta)


@dataclass(frozen=True)
class _Pose:
    """Positions (..., m, d) and rotations (..., m, d, d) of markers a and b; complex in a complex step."""

    xa: Array
    Ra: Array
    xb: Array
    Rb: Array


class BushingLoads(Loads):
    """Bushings (1)."""

    def __init__(self, motions: Motions, forces: list[Any], markers: list[tuple[int, int]]) -> None:
        super().__init__(motions, forces, markers)
        d, n = motions.dim, motions.n_twist
        self.K, self.C = np.zeros((2, len(forces), n, n))
        for i, f in enumerate(forces):
            T = np.eye(n)
            T[:d, :d] = f.axes
            T[d:, d:] = f.axes if d == 3 else 1.0
            self.K[i], self.C[i] = T.T @ f.stiffness @ T, T.T @ f.damping @ T

    @staticmethod
    def law_of(f: Any) -> Any:
        """None: a matrix."""
        return None

    def mounts(self) -> tuple[Array, Array]:
        """K and C in the axes of markers a."""
        return self.K, self.C

    def turns(self, kin: Kinematics) -> Array:
        """Angles (m,), rad, by which b is turned against a; 0 where rotations are not resisted."""
        d = self.motions.dim
        resisted = np.abs(self.K[:, d:, d:]).max(axis=(1, 2)) > 0.0
        return resisted * np.linalg.norm(self._relative(self._pose(kin))[0][:, d:], axis=1)

    def _pose(self, kin: Kinematics) -> _Pose:
        return _Pose(kin.x[self.a], kin.R[self.a], kin.x[self.b], kin.R[self.b])

    def _relative(self, p: _Pose) -> tuple[Array, Array]:
        """s (..., m, n) in the axes of a, and B (..., m, n, 2 n)."""
        m, d = self.motions, self.motions.dim
        n = d + m.n_rot

        back = np.swapaxes(p.Ra, -1, -2)
        arm = p.xb - p.xa
        R = back @ p.Rb

        # the rotation from a to b, and how it answers to the difference of angular velocities
        if d == 3:
            theta = rotation_vector(R)
            turn = rotation_rate(theta) @ back
        else:
            theta = 2 * np.arctan(R[..., 1, 0] / (1 + R[..., 0, 0]))[..., None]
            turn = np.ones((*theta.shape, 1))

        s = np.concatenate(((back @ arm[..., None])[..., 0], theta), axis=-1)

        # displacements: those of b less those of a, and less what the rotation of a makes of the arm
        B = np.zeros((*s.shape, 2 * n), dtype=s.dtype)
        B[..., :d, :d], B[..., :d, n : n + d] = -back, back
        lever = -hat(arm) if d == 3 else np.stack((-arm[..., 1], arm[..., 0]), -1)[..., None]
        B[..., :d, d:n] = -back @ lever

        B[..., d:, d:n], B[..., d:, n + d :] = -turn, turn
        return s, B

    def _forces(self, p: _Pose, twist: Array) -> Array:
        """The wrenches (1) on a and b, (..., m, 2 n), at fixed twists (m, 2 n)."""
        s, B = self._relative(p)
        N = self.K @ s[..., None] + self.C @ (B @ twist[..., None])
        return np.asarray(-(np.swapaxes(B, -1, -2) @ N)[..., 0])

    def _twist(self, kin: Kinematics) -> Array:
        assert kin.twist is not None
        return np.concatenate((kin.twist[self.a], kin.twist[self.b]), axis=1)

    def wrenches(self, kin: Kinematics, t: float) -> tuple[Array, Array]:
        """(1) on markers a and b."""
        n = self.motions.n_twist
        both = self._forces(self._pose(kin), self._twist(kin))
        return both[:, :n], both[:, n:]

    def energy(self, kin: Kinematics, t: float) -> float:
        """s . K s / 2 with the symmetric part of K, J."""
        s = self._relative(self._pose(kin))[0]
        return 0.5 * float((s * (self.K @ s[..., None])[..., 0]).sum())

    def tangent(self, kin: Kinematics, t: float) -> MarkerTangent:
        """B^T C B, and the derivative of (1) by displacements and rotations of both markers."""
        m = self.motions
        d = m.dim
        n = m.n_twist
        p, twist = self._pose(kin), self._twist(kin)
        B = self._relative(p)[1]

        # derivatives by complex steps: both markers moved and turned about each axis
        h = 1j * COMPLEX_STEP
        xa, xb, Ra, Rb = (np.repeat(x[None].astype(complex), 2 * n, axis=0) for x in (p.xa, p.xb, p.Ra, p.Rb))
        for k in range(n):
            for x, R, at in ((xa, Ra, k), (xb, Rb, n + k)):
                if k < d:
                    x[at, :, k] += h
                else:
                    spin = spin_matrix(np.eye(m.n_rot)[k - d])
                    R[at] += h * spin @ R[at].real

        K = -self._forces(_Pose(xa, Ra, xb, Rb), twist).imag / COMPLEX_STEP
        return MarkerTangent(self.markers, np.moveaxis(K, 0, -1), np.swapaxes(B, 1, 2) @ self.C @ B)


@dataclass(frozen=True, eq=False)
class Bushing(Force):
    """See :func:`bushing`; ``axes`` (d, d) rows, ``stiffness`` and ``damping`` (n, n) in these axes."""

    stiffness: Array = None  # type: ignore[assignment]
    damping: Array = None  # type: ignore[assignment]
    axes: Array = None  # type: ignore[assignment]
    law: None = None

    batch: ClassVar[type[Loads]] = BushingLoads
    kind: ClassVar[str] = "bushing"
    joined: ClassVar[bool] = True


@typed
def bushing(
    name: str,
    a: Any,
    b: Any,
    *,
    stiffness: Sequence[float] | Array,
    damping: Sequence[float] | Array | None = None,
    center: Sequence[float] | None = None,
    axes: Array | None = None,
) -> Bushing:
    """An elastic mount between two attachments: wrench -(K s + C s') on b for the displacement and rotation s of b against a.

    Args:
        stiffness: K, (6, 6) or its diagonal (6,), for (x, y, z, rotations about x, y, z): N/m, N m/rad; in the plane (3, 3) or
            (3,) for (x, y, rotation). It may be unsymmetric, as that of an oil film; its energy is that of the symmetric part.
        damping: C of the same form, N s/m, N m s/rad; none by default.
        center: point where both sides meet unstressed, world axes at the start, m; by default the centroid of a surface that
            takes part, else the centre of mass of b.
        axes: (d, d), rows are the directions of K and C in world axes at the start; they go with a. World axes by default.
    """
    d = dimension(a, b, name)
    n = 6 if d == 3 else 3

    E = np.eye(d) if axes is None else array(f'Bushing "{name}": axes', axes)
    require(
        E.shape == (d, d) and bool(np.isfinite(E).all()) and bool(np.abs(E @ E.T - np.eye(d)).max() < 1e-9)
        and bool(np.linalg.det(E) > 0),
        f'Bushing "{name}": axes must be {d} orthonormal right-handed rows, found {axes!r}.',
    )  # fmt: skip

    K = _matrix(name, "stiffness", stiffness, n)
    C = np.zeros((n, n)) if damping is None else _matrix(name, "damping", damping, n)
    require(
        bool(np.linalg.eigvalsh(C + C.T)[0] >= -1e-12 * np.abs(C).max(initial=1.0)),
        f'Bushing "{name}": the damping gives energy: its symmetric part has a negative eigenvalue.',
    )

    return Bushing(name, a, b, center, center, K, C, E)


def _matrix(name: str, what: str, given: Any, n: int) -> Array:
    """(n, n) from a matrix or its diagonal."""
    M = array(f'Bushing "{name}": {what}', given)
    if M.shape == (n,):
        M = np.diag(M)
    if M.shape != (n, n):
        raise InputError(
            f'Bushing "{name}": {what} must be {n} numbers or ({n}, {n}), found shape {M.shape}. '
            + ("Order: x, y, z, rotations about x, y, z." if n == 6 else "Order: x, y, rotation.")
        )
    return M
