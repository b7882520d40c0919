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

from dataclasses import dataclass
from functools import cache

import numpy as np

from ..rotations import Array, Motions


@dataclass
class Kinematics:
    """Markers in one configuration; world axes. ``jac_frame`` (n, d + n_rot, n_twist), ``jac_port`` (n_s, d + n_rot, n_port)."""

    x: Array  # (n, d) m
    R: Array  # (n, d, d)
    jac_frame: Array
    jac_port: Array
    twist: Array | None = None  # (n, d + n_rot): x' and angular velocity
    bias: Array | None = None  # (n, d + n_rot): d/dt of the twist at zero accelerations


@cache
def _nothing(d: int, n_rot: int, n_twist: int, n_port: int) -> Kinematics:
    """Kinematics of no markers."""
    n = d + n_rot
    empty = np.zeros((0, n))
    place, turn = np.zeros((0, d)), np.zeros((0, d, d))
    return Kinematics(place, turn, np.zeros((0, n, n_twist)), np.zeros((0, n, n_port)), empty, empty)


@dataclass(frozen=True)
class Markers:
    """All markers of a system. Marker i sits on frame ``frame[i]`` (the last one is the ground)."""

    motions: Motions
    frame: np.ndarray  # (n,) int
    position: Array  # (n, d) in the frame's axes; for surfaces the lever from the centroid
    rotation: Array  # (n, d, d) in the frame's axes
    surface: np.ndarray  # (n_s,) int: which markers sit on elastic surfaces, ascending
    port: np.ndarray  # (n_s, n_port) int: columns of the system's ports

    @property
    def n_port(self) -> int:
        """Numbers that describe one surface: b_0 ... b_d."""
        return self.motions.dim * (1 + self.motions.dim)

    def evaluate(self, pose: Array, twist: Array | None, port: Array, port_rate: Array | None) -> Kinematics:
        """Markers for frame poses (n_frame + 1, n_pose), twists, ports and their rates (the rates may be None)."""
        m, d = self.motions, self.motions.dim
        if not len(self.frame):  # a scene of coordinates only
            return _nothing(d, m.n_rot, m.n_twist, self.n_port)
        Rf = m.matrix(pose)[self.frame]
        if self.surface.size:
            local, turn, port_jac, extra = self._surfaces(port, port_rate)
        else:
            local, turn = self.position, self.rotation
            port_jac = np.zeros((0, d + m.n_rot, self.n_port))
        lever = (Rf @ local[..., None])[..., 0]
        kin = Kinematics(
            x=pose[self.frame, :d] + lever,
            R=Rf @ turn,
            jac_frame=np.zeros((len(self.frame), d + m.n_rot, m.n_twist)),
            jac_port=port_jac,
        )
        arm = m.lever(lever)
        J = kin.jac_frame
        J[:, range(d), range(d)] = 1.0
        J[:, :d, d:] = arm @ Rf if d == 3 else arm
        J[:, d:, d:] = Rf if d == 3 else 1.0
        big = self._lift(Rf[self.surface])
        kin.jac_port = big @ port_jac
        if twist is None:
            return kin
        v = twist[self.frame]
        kin.twist = motion = np.asarray((J @ v[..., None])[..., 0])
        w = v[:, d:]
        bias = np.zeros_like(motion)
        bias[:, :d] = (Rf @ m.spin(w, m.spin(w, local))[..., None])[..., 0]
        if self.surface.size:
            assert port_rate is not None and extra is not None
            s = self.surface
            rate = port_rate[self.port]
            local_rate = (port_jac @ rate[..., None])[..., 0]
            motion[s] += (big @ local_rate[..., None])[..., 0]
            extra[:, :d] += 2.0 * m.spin(w[s], local_rate[:, :d])
            if d == 3:
                extra[:, d:] += m.spin(w[s], local_rate[:, d:])
            bias[s] += (big @ extra[..., None])[..., 0]
        kin.bias = bias
        return kin

    def _lift(self, R: Array) -> Array:
        """blockdiag(R, R) (space) or blockdiag(R, 1) (plane) acting on (displacement, rotation)."""
        d, n = self.motions.dim, self.motions.dim + self.motions.n_rot
        big = np.zeros((len(R), n, n))
        big[:, :d, :d] = R
        big[:, d:, d:] = R if d == 3 else 1.0
        return big

    def _surfaces(self, port: Array, rate: Array | None) -> tuple[Array, Array, Array, Array | None]:
        """Position and rotation of all markers in frame axes, port Jacobians and bias of those on surfaces; (1), (2)."""
        m, d = self.motions, self.motions.dim
        s = self.surface
        b = port[self.port].reshape(-1, 1 + d, d)
        F = np.swapaxes(b[:, 1:], 1, 2)
        Rs = polar_rotation(F)
        stretch = F @ np.swapaxes(Rs, 1, 2)
        if d == 3:
            D = np.trace(stretch, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 0.5 * (
                stretch + np.swapaxes(stretch, 1, 2)
            )
        else:
            D = np.trace(stretch, axis1=1, axis2=2)[:, None, None]
        Z = np.linalg.inv(D)
        arms = np.swapaxes(Rs, 1, 2)  # arms[:, k] = R_s e_k
        lever = (Rs @ self.position[s][..., None])[..., 0]
        jac: Array = np.zeros((len(s), d + m.n_rot, 1 + d, d))
        # (R_s e_k) x b' as a matrix on b': row vectors of moment(arm, .)
        eye = np.eye(d)
        per_arm = m.moment(arms[:, :, None, :], eye[None, None]).swapaxes(2, 3)  # (n, k, n_rot, d)
        turn = np.einsum("nab,nkbc->nakc", Z, per_arm)  # (n, n_rot, k, d)
        jac[:, d:, 1:] = turn
        jac[:, range(d), 0, range(d)] = 1.0
        jac[:, :d, 1:] += np.einsum("nab,nbkc->nakc", m.lever(lever), turn)
        local, rotation = self.position.copy(), self.rotation.copy()
        local[s] = b[:, 0] + lever
        rotation[s] = Rs @ self.rotation[s]
        jac = jac.reshape(len(s), d + m.n_rot, self.n_port)
        if rate is None:
            return local, rotation, jac, None
        bd = rate[self.port].reshape(-1, 1 + d, d)
        w = (jac[:, d:] @ rate[self.port][..., None])[..., 0]
        arms_rate = m.spin(w[:, None], arms)
        torque = m.moment(arms_rate, bd[:, 1:]).sum(1)
        Sd = np.einsum("nka,nkc->nac", bd[:, 1:], arms) + np.einsum("nka,nkc->nac", b[:, 1:], arms_rate)
        Dd = np.trace(Sd, axis1=1, axis2=2)[:, None, None] * np.eye(m.n_rot)
        if d == 3:
            Dd = Dd - 0.5 * (Sd + np.swapaxes(Sd, 1, 2))
        wd = (Z @ (torque[..., None] - Dd @ w[..., None]))[..., 0]
        bias = np.concatenate((m.spin(w, m.spin(w, lever)) + m.spin(wd, lever), wd), axis=-1)
        return local, rotation, jac, bias


def polar_rotation(F: Array) -> Array:
    """The rotation R that maximises tr(R^T F), for (n, d, d) matrices of rank d - 1 at least."""
    if F.shape[-1] == 2:
        angle = np.arctan2(F[:, 1, 0] - F[:, 0, 1], F[:, 0, 0] + F[:, 1, 1])
        c, s = np.cos(angle), np.sin(angle)
        return np.stack((np.stack((c, -s), -1), np.stack((s, c), -1)), -2)
    U, _, Vt = np.linalg.svd(F)
    sign = np.linalg.det(U) * np.linalg.det(Vt)
    U[:, :, 2] *= np.sign(sign)[:, None]
    return U @ Vt
