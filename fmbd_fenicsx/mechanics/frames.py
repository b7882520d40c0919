"""Markers: frames fixed on bodies and on elastic surfaces, all of them at once.

Joints, forces and sensors see the system only through markers. A marker has a position x, a rotation R_m and a world
twist (x', w_m); on an elastic surface both come from the *ports* of the surface, the moments of its material points,

    b_0 = mean(P),   b_k = mean(P (X_k - c_k)) / l,   F = sum_k b_k e_k^T,   F = R_s S  (polar decomposition)     (1)

with P the points in body axes, c the centroid and l a length. R_s is the rotation that satisfies the resultant
conditions mean((R_s (X - c)) x P) = 0 of a surface that moves with a frame on average, so the rotation of the surface is
the unknown that these three conditions define; solved for here, it costs neither an unknown nor a multiplier, and it
leaves the system without massless coordinates. With S' = F R_s^T its rate in body axes is

    w_s = (tr S' 1 - S')^-1 sum_k (R_s e_k) x b_k'.                                                           (2)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from ..answers import answered_by
from ..rotations import Array, Motions


@dataclass
class Kinematics:
    """Markers in one configuration; world axes. ``jac_frame`` (n, d + n_rot, n_twist), ``jac_port`` (n_s, d + n_rot, n_port).

    Their velocities and biases are computed at first use: most steps need neither.
    """

    x: Array  # (n, d) m
    R: Array  # (n, d, d)
    jac_frame: Array
    jac_port: Array
    moving: Moving | None = None
    turned: Array | None = None  # (n,) rad: differences of two markers are their counted angle, see joints.counted
    counts: Callable[[], Array] | None = None  # who tells :attr:`angle`
    evaluated: dict[Any, Array] = field(default_factory=dict, repr=False)  # by kinds of items, see kinds.evaluation

    @cached_property
    def frames(self) -> Array:
        """Each marker as the kernels of the kinds read it, (n, FRAME): x, R, twist, in the plane the angle of R."""
        n, d = self.x.shape
        twist = np.zeros((n, 3 * (d - 1))) if self.twist is None else self.twist
        columns = [self.x, self.R.reshape(n, -1), twist]
        if d == 2:
            columns.append(np.arctan2(self.R[:, 1, 0], self.R[:, 0, 0])[:, None])
        return np.concatenate(columns, axis=1)

    @cached_property
    def twist(self) -> Array | None:
        """x' and angular velocity, (n, d + n_rot); None for a configuration without velocities."""
        return None if self.moving is None else self.moving.twist(self)

    @cached_property
    def angle(self) -> Array | None:
        """Angles of R as :meth:`Markers.angles` counts them, (n,) rad; None in space."""
        return None if self.counts is None else self.counts()

    @cached_property
    def bias(self) -> Array | None:
        """d/dt of the twist at zero accelerations, (n, d + n_rot); None without velocities."""
        return None if self.moving is None else self.moving.bias()


@answered_by("_rest", "jac_frame jac_port moving turned angle")
class SeenKinematics(Kinematics):
    """Markers whose motion is known: x (n, d), R (n, d, d) and twist (n, d + n_rot); all else follows from ``whole`` when someone
    asks for it.
    """

    def __init__(self, x: Array, R: Array, twist: Array, whole: Callable[[], Kinematics]) -> None:
        self.x, self.R, self.evaluated = x, R, {}
        self.twist, self._whole = twist, whole

    @cached_property
    def _rest(self) -> Kinematics:
        return self._whole()


@dataclass(frozen=True)
class _Surfaces:
    """Markers on surfaces in one configuration, axes of their frames; symbols as in the module."""

    b: Array  # (n_s, 1 + d, d)
    arms: Array  # (n_s, d, d): arms[:, k] = R_s e_k
    lever: Array  # (n_s, d)
    Z: Array  # (n_s, n_rot, n_rot)
    jac: Array  # (n_s, d + n_rot, n_port) on the ports


@dataclass(frozen=True)
class Moving:
    """What velocities and biases of markers follow from."""

    markers: Markers
    frame_twist: Array  # (n, n_twist), of each marker's frame
    rate: Array  # (n_s, n_port), of each surface's ports
    Rf: Array  # (n, d, d)
    local: Array  # (n, d)
    surfaces: _Surfaces | None

    def twist(self, kin: Kinematics) -> Array:
        """x' and angular velocity of all markers, (n, d + n_rot)."""
        out: Array = (kin.jac_frame @ self.frame_twist[..., None])[..., 0]
        if self.surfaces is not None:
            out[self.markers.surface] += (kin.jac_port @ self.rate[..., None])[..., 0]
        return out

    def bias(self) -> Array:
        """d/dt of the twists at zero accelerations, (n, d + n_rot)."""
        m = self.markers.motions
        d = m.dim
        s = self.markers.surface
        w = self.frame_twist[:, d:]

        out: Array = np.zeros((len(w), d + m.n_rot))
        out[:, :d] = (self.Rf @ m.spin(w, m.spin(w, self.local))[..., None])[..., 0]
        if self.surfaces is None:
            return out

        # markers on surfaces move in their frames: 2 w x v of the relative velocity
        extra = self._surface_bias(self.surfaces)
        local_rate = (self.surfaces.jac @ self.rate[..., None])[..., 0]
        extra[:, :d] += 2.0 * m.spin(w[s], local_rate[:, :d])
        if d == 3:
            extra[:, d:] += m.spin(w[s], local_rate[:, d:])

        out[s] += (self.markers.lift(self.Rf[s]) @ extra[..., None])[..., 0]
        return out

    def _surface_bias(self, f: _Surfaces) -> Array:
        """d/dt of (2) and of the velocity of the lever at zero port accelerations, (n_s, d + n_rot)."""
        m = self.markers.motions
        d = m.dim
        bd = self.rate.reshape(-1, 1 + d, d)
        w = (f.jac[:, d:] @ self.rate[..., None])[..., 0]
        arms_rate = m.spin(w[:, None], f.arms)
        torque = m.moment(arms_rate, bd[:, 1:]).sum(1)

        Sd = np.einsum("nka,nkc->nac", bd[:, 1:], f.arms) + np.einsum("nka,nkc->nac", f.b[:, 1:], arms_rate)
        Dd = np.trace(Sd, axis1=1, axis2=2)[:, None, None] * np.eye(m.n_rot)
        if d == 3:
            Dd = Dd - 0.5 * (Sd + np.swapaxes(Sd, 1, 2))

        wd = (f.Z @ (torque[..., None] - Dd @ w[..., None]))[..., 0]
        if self.markers.section is not None:
            wd[self.markers.section] = 0.0
        return np.concatenate((m.spin(w, m.spin(w, f.lever)) + m.spin(wd, f.lever), wd), axis=-1)


@cache
def _nothing(d: int, n_rot: int, n_twist: int, n_port: int) -> Kinematics:
    """Kinematics of no markers."""
    n = d + n_rot
    empty = np.zeros((0, n))
    place = np.zeros((0, d))
    turn = np.zeros((0, d, d))
    kin = Kinematics(place, turn, np.zeros((0, n, n_twist)), np.zeros((0, n, n_port)))
    kin.twist = kin.bias = empty
    return kin


@dataclass(frozen=True)
class Markers:
    """All markers of a system. Marker i sits on frame ``frame[i]`` (the last one is the ground)."""

    motions: Motions
    frame: np.ndarray  # (n,) int
    position: Array  # (n, d) in the frame's axes; for surfaces the lever from the centroid
    rotation: Array  # (n, d, d) in the frame's axes
    surface: np.ndarray  # (n_s,) int: which markers sit on elastic surfaces, ascending
    port: np.ndarray  # (n_s, n_port) int: columns of the system's ports
    section: np.ndarray | None = None  # (n_s,) bool: sections with an angle, ports (x, y, angle, 0, 0, 0)

    @property
    def n_port(self) -> int:
        """Numbers that describe one surface: b_0 ... b_d."""
        return self.motions.dim * (1 + self.motions.dim)

    def evaluate(
        self, pose: Array, rotation: Array, port: Array, rates: tuple[Array, Array] | None = None
    ) -> Kinematics:
        """Markers for frame poses (n_frame + 1, n_pose), their rotation matrices, and ports; ``rates``: twists of the frames
        and rates of the ports, where velocities are wanted.
        """
        m, d = self.motions, self.motions.dim
        if not len(self.frame):  # a scene of coordinates only
            return _nothing(d, m.n_rot, m.n_twist, self.n_port)

        Rf = rotation[self.frame]
        # markers on surfaces move in their frames, by ports
        local, turn, found = self.position, self.rotation, None

        J = np.zeros((len(self.frame), d + m.n_rot, m.n_twist))
        jac_port: Array = np.zeros((0, d + m.n_rot, self.n_port))

        if self.surface.size:
            local, turn, found = self._surfaces(port)
            jac_port = self.lift(Rf[self.surface]) @ found.jac

        # velocities of a marker by the twist of its frame: v + w x lever in world axes, w in body axes in space
        lever = (Rf @ local[..., None])[..., 0]
        arm = m.lever(lever)
        J[:, range(d), range(d)] = 1.0
        J[:, :d, d:] = arm @ Rf if d == 3 else arm
        J[:, d:, d:] = Rf if d == 3 else 1.0

        moving = None
        if rates is not None:
            moving = Moving(self, rates[0][self.frame], rates[1][self.port], Rf, local, found)
        counts = partial(self.angles, pose, port) if d == 2 else None
        return Kinematics(pose[self.frame, :d] + lever, Rf @ turn, J, jac_port, moving, counts=counts)

    def angles(self, pose: Array, port: Array) -> Array:
        """Angles (rad) in the plane as frames and sections of lines count them, (n,); surfaces turn little beside them."""
        out = np.array(pose[self.frame, 2])
        if self.section is not None:
            out[self.surface[self.section]] += port[self.port[self.section, 2]]
        return out

    def rotations(self, rotation: Array, port: Array) -> Array:
        """Rotations R_m of all markers alone, (n, d, d), as :meth:`evaluate`."""
        turn = self.rotation
        if self.surface.size:
            turn = turn.copy()
            turn[self.surface] = polar(self._deformations(port)[1])[0] @ turn[self.surface]
        return np.asarray(rotation[self.frame] @ turn)

    def lift(self, R: Array) -> Array:
        """blockdiag(R, R) (space) or blockdiag(R, 1) (plane) acting on (displacement, rotation)."""
        d = self.motions.dim
        n = self.motions.dim + self.motions.n_rot
        big = np.zeros((len(R), n, n))
        big[:, :d, :d] = R
        big[:, d:, d:] = R if d == 3 else 1.0
        return big

    def _deformations(self, port: Array) -> tuple[Array, Array]:
        """b and F of (1) of all surfaces, (n_s, 1 + d, d) and (n_s, d, d)."""
        m, d = self.motions, self.motions.dim
        b = port[self.port].reshape(-1, 1 + d, d)
        F = np.swapaxes(b[:, 1:], 1, 2)
        if self.section is not None:
            F[self.section] = m.matrix(np.insert(np.zeros((self.section.sum(), 2)), 2, b[self.section, 1, 0], axis=1))
        return b, F

    def _surfaces(self, port: Array) -> tuple[Array, Array, _Surfaces]:
        """Position and rotation of all markers in frame axes, and those on surfaces; (1), (2)."""
        m, d = self.motions, self.motions.dim
        s = self.surface
        b, F = self._deformations(port)
        Rs, Z = polar(F)
        arms = np.swapaxes(Rs, 1, 2)  # arms[:, k] = R_s e_k
        lever = (Rs @ self.position[s][..., None])[..., 0]
        jac: Array = np.zeros((len(s), d + m.n_rot, 1 + d, d))
        # (R_s e_k) x b' as a matrix on b': m.lever(x)^T b' = x x b'
        per_arm = np.swapaxes(m.lever(arms), 2, 3)  # (n, k, n_rot, d)
        turn = np.swapaxes(Z[:, None] @ per_arm, 1, 2)  # (n, n_rot, k, d)
        jac[:, d:, 1:] = turn
        jac[:, range(d), 0, range(d)] = 1.0
        jac = jac.reshape(len(s), d + m.n_rot, self.n_port)
        jac[:, :d] += m.lever(lever) @ jac[:, d:]
        if self.section is not None:
            jac[self.section] = 0.0
            jac[self.section, :, :3] = np.eye(3)
            jac[self.section, :2, 2] = m.lever(lever[self.section])[..., 0]
        local, rotation = self.position.copy(), self.rotation.copy()
        local[s] = b[:, 0] + lever
        rotation[s] = Rs @ self.rotation[s]
        return local, rotation, _Surfaces(b, arms, lever, Z, jac)


def polar_rotation(F: Array) -> Array:
    """The rotation R that maximises tr(R^T F), for (n, d, d) matrices of rank d - 1 at least."""
    return polar(F)[0]


def polar(F: Array) -> tuple[Array, Array]:
    """R as in :func:`polar_rotation` and (tr S 1 - S)^-1 of F = S R, (n, n_rot, n_rot); in the plane 1 / tr S."""
    if F.shape[-1] == 2:
        s = F[:, 1, 0] - F[:, 0, 1]
        c = F[:, 0, 0] + F[:, 1, 1]
        trace = np.hypot(s, c)
        s, c = s / trace, c / trace
        return np.stack((np.stack((c, -s), -1), np.stack((s, c), -1)), -2), 1.0 / trace[:, None, None]

    U, stretch, Vt = np.linalg.svd(F)  # S = U stretch U^T
    R: Array = U @ Vt
    improper = np.linalg.det(R) < 0
    if improper.any():
        R -= 2.0 * np.where(improper[:, None, None], U[:, :, 2:] * Vt[:, 2:], 0.0)
        stretch[improper, 2] *= -1.0
    rest = stretch.sum(1, keepdims=True) - stretch
    return R, (U / rest[:, None]) @ np.swapaxes(U, 1, 2)
