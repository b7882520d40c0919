"""Placements: how the points of a body move, and the inertia that follows from it.

A flexible body in a moving frame has x = r + R P, P = X + U. Its nodal accelerations and inertia forces in body axes are

    a = R^T (r'' - g) + w' x P + w x (w x P) + 2 w x U' + U'',     F = M a                                   (1)

    translation:  R sum_n F_n        rotation:  sum_n P_n x F_n      field:  F + K U + D U'                  (2)

and nothing else: no inertia shape integrals, no gyroscopic terms by hand, because constants and linear functions lie
in V_h and M commutes with node-wise rotations (Galerkin mass, unlumped). A rigid body is the same with U = 0 and the
sums taken once: m (r'' - g) and J w' + w x J w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .fields import Field
from .rotations import Array, Motions, motions


@dataclass(frozen=True)
class FrameMotion:
    """What a part needs of its frame: time (s), rotation (d, d), twist and its rate (n_twist,), gravity (d,), world axes."""

    t: float
    R: Array
    twist: Array
    accel: Array | None
    gravity: Array


class Part(Protocol):
    """A block of local coordinates u of one body, beside the twist of its frame (the ground for absolute placements).

    ``ports`` are linear functions of u that joints, forces and sensors see. ``distributed`` parts hold this rank's share of
    a field; others are replicated and give their matrices to the core.
    """

    name: str
    frame: int
    n: int
    n_port: int
    n_frame_rows: int
    distributed: bool
    reference: Array
    comm: Any
    port_matrix: Array  # (n_port, n), replicated parts only

    def ports_of(self, w: Array) -> Array:
        """Ports of local coordinates, without the reference part; collective."""

    def port_force(self, f: Array) -> Array:
        """Transpose of ``ports_of``."""

    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of the frame (n_twist,) and of the local coordinates (n,) of M a + h; collective."""

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J; collective."""

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin; collective."""

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass blocks (frame, frame), (local, frame), (local, local); the last two for replicated parts only."""

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Stiffness and damping of the local coordinates, (n, n) each; replicated parts only."""


@dataclass(frozen=True)
class RigidBlock:
    """All rigid bodies at once: frames (n,), mass (n,) kg, inertia about the centre of mass (n, n_rot, n_rot) kg m^2."""

    motions: Motions
    frame: np.ndarray
    mass: Array
    inertia: Array

    def force(self, twist: Array, accel: Array, gravity: Array) -> Array:
        """Inertia minus weight, rows (n, n_twist): m (r'' - g), J w' + w x J w."""
        m, d = self.motions, self.motions.dim
        v, a = twist[self.frame], accel[self.frame]
        out = np.empty((len(self.frame), m.n_twist))
        out[:, :d] = self.mass[:, None] * (a[:, :d] - gravity)
        if d == 2:
            out[:, 2] = self.inertia[:, 0, 0] * a[:, 2]
            return out
        Jw = (self.inertia @ v[:, d:, None])[..., 0]
        out[:, d:] = (self.inertia @ a[:, d:, None])[..., 0] + m.moment(v[:, d:], Jw)
        return out

    def matrices(self) -> Array:
        """Mass matrices blockdiag(m 1, J), (n, n_twist, n_twist)."""
        d, n = self.motions.dim, self.motions.n_twist
        M = np.zeros((len(self.frame), n, n))
        M[:, range(d), range(d)] = self.mass[:, None]
        M[:, d:, d:] = self.inertia
        return M

    def energies(self, pose: Array, twist: Array, gravity: Array) -> tuple[float, float]:
        """Kinetic energy and potential energy of weight, J."""
        d = self.motions.dim
        v = twist[self.frame]
        kinetic = 0.5 * float((self.mass[:, None] * v[:, :d] ** 2).sum())
        kinetic += 0.5 * float(np.einsum("na,nab,nb->", v[:, d:], self.inertia, v[:, d:]))
        return kinetic, -float((self.mass[:, None] * pose[self.frame, :d] * gravity).sum())

    def momenta(self, pose: Array, twist: Array) -> tuple[Array, Array]:
        """Linear and angular momentum about the origin, world axes."""
        m, d = self.motions, self.motions.dim
        q, v = pose[self.frame], twist[self.frame]
        p = self.mass[:, None] * v[:, :d]
        spin = m.turn(m.matrix(q), (self.inertia @ v[:, d:, None])[..., 0])
        return p.sum(0), (m.moment(q[:, :d], p) + spin).sum(0)


class FloatingField:
    """A displacement field in a floating frame; equations (1), (2). One per body.

    ``frame`` is the index of its frame. Local coordinates are the owned nodal displacements. Its ports are the frame
    conditions (n_twist numbers C^T U, zero by constraint) followed by the moments of each surface in use.
    """

    distributed = True
    port_matrix = np.zeros((0, 0))

    def __init__(self, field: Field, frame: int, surfaces: list[str], attached: str | None) -> None:
        self.field, self.frame, self.name, self.comm = field, frame, field.name, field.comm
        self.motions = motions(field.dim)
        self.n = field.n * field.dim
        self.surfaces = [field.moments(s) for s in surfaces]
        self.n_frame_rows = self.motions.n_twist
        self.conditions = field.Q if attached is None else self._attachment(field.moments(attached))
        self.mean_axis = attached is None
        per = field.dim * (1 + field.dim)
        self.n_port = self.n_frame_rows + per * len(self.surfaces)
        self.reference = np.concatenate([np.zeros(self.n_frame_rows), *(s.reference.ravel() for s in self.surfaces)])

    def _attachment(self, moments: object) -> Array:
        """Columns of the linear conditions "the surface does not move in the frame, on average"."""
        from .surfaces import Moments

        assert isinstance(moments, Moments)
        m, d = self.motions, self.field.dim
        b = moments.reference[1:]  # (k, d)
        C = np.zeros((self.field.n, d, m.n_twist))
        C[moments.nodes[:, None], range(d), range(d)] = moments.weights[:, :1]
        for c in range(d):
            unit = np.eye(d)[c]
            turn = m.moment(b, unit)  # (k, n_rot): b_k x e_c
            C[moments.nodes, c, d:] = moments.weights[:, 1:] @ turn
        return C.reshape(self.n, m.n_twist) * self.field.mass_total

    # -- ports --------------------------------------------------------------------------------------------------
    def ports_of(self, w: Array) -> Array:
        """Port values of a nodal vector without its reference part, (n d,) -> (n_port,); collective."""
        d = self.field.dim
        W = w.reshape(-1, d)
        parts = [self.conditions.T @ w] + [(s.weights.T @ W[s.nodes]).ravel() for s in self.surfaces]
        return self.field.total(np.concatenate(parts))

    def port_force(self, f: Array) -> Array:
        """Nodal forces of port forces, the transpose of :meth:`ports_of`; (n_port,) -> (n d,)."""
        d, k = self.field.dim, self.n_frame_rows
        out = (self.conditions @ f[:k]).reshape(-1, d)
        for s in self.surfaces:
            block = f[k : k + d * (1 + d)].reshape(1 + d, d)
            out[s.nodes] += s.weights @ block
            k += d * (1 + d)
        return out.ravel()

    def port_columns(self, used: np.ndarray) -> Array:
        """Dense columns (n d, count) of :meth:`port_force` for the port numbers ``used``."""
        out = np.empty((self.n, len(used)))
        for i, p in enumerate(used):
            e = np.zeros(self.n_port)
            e[p] = 1.0
            out[:, i] = self.port_force(e)
        return out

    # -- mechanics ----------------------------------------------------------------------------------------------
    def force(self, motion: FrameMotion, local: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        """Rows of (2): the frame's (n_twist,), world translation and body rotation, and the field's (n d,); collective."""
        m, d, R, accel = self.motions, self.field.dim, motion.R, motion.accel
        assert accel is not None
        U, Ud, Udd = (x.reshape(-1, d) for x in local)
        P = self.field.X + U
        w = motion.twist[None, d:]
        a = R.T @ (accel[:d] - motion.gravity)
        A = Udd + a + m.spin(accel[None, d:], P) + m.spin(w, m.spin(w, P) + 2.0 * Ud)
        F = self.field.mass(A)
        sums = self.field.total(np.concatenate((F.sum(0), m.moment(P, F).sum(0))))
        sums[:d] = R @ sums[:d]
        rows = F.ravel() + self.internal(local[0], local[1])
        if self.field.forms.mass_damping:
            rows += self.field.forms.mass_damping * self.field.mass(Ud).ravel()
        return sums, rows

    def internal(self, U: Array, Ud: Array) -> Array:
        """K (U + beta U'), (n d,)."""
        beta = self.field.forms.stiffness_damping
        return self.field.stiffness(U + beta * Ud if beta else U)

    def mass_blocks(self, motion: FrameMotion, u: Array) -> tuple[Array, Array, Array]:
        """Mass block of the frame at U = 0, blockdiag(m 1, J); the field's own blocks stay with its factor."""
        d, n = self.field.dim, self.motions.n_twist
        M = np.zeros((n, n))
        M[range(d), range(d)] = self.field.mass_total
        M[d:, d:] = self.field.inertia
        return M, np.zeros((0, n)), np.zeros((0, 0))

    def stiffness_blocks(self, motion: FrameMotion, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """None in the core."""
        return np.zeros((0, 0)), np.zeros((0, 0))

    def _velocity(self, motion: FrameMotion, local: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Points P, nodal velocities W in body axes and M W."""
        d = self.field.dim
        P = self.field.points(local[0])
        W = motion.R.T @ motion.twist[:d] + self.motions.spin(motion.twist[None, d:], P) + local[1].reshape(-1, d)
        return P, W, self.field.mass(W)

    def energies(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[float, float, float]:
        """Kinetic, elastic and weight energy, J; collective."""
        d, U = self.field.dim, local[0]
        P, W, MW = self._velocity(motion, local)
        kinetic, elastic = 0.5 * float((W * MW).sum()), 0.5 * float(U @ self.field.stiffness(U))
        sums = self.field.total(np.concatenate(([kinetic, elastic], self.field.mass(P).sum(0))))
        weight = -float(motion.gravity @ (self.field.mass_total * pose[:d] + motion.R @ sums[2:]))
        return float(sums[0]), float(sums[1]), weight

    def momenta(self, motion: FrameMotion, pose: Array, local: tuple[Array, Array]) -> tuple[Array, Array]:
        """Linear and angular momentum about the world origin, world axes; collective."""
        m, d = self.motions, self.field.dim
        P, _, MW = self._velocity(motion, local)
        sums = self.field.total(np.concatenate((MW.sum(0), m.moment(P, MW).sum(0))))
        p = motion.R @ sums[:d]
        return p, m.moment(pose[:d], p) + m.turn(motion.R, sums[d:])
