"""Inertia of the second-order displacements: the other half of the stress of the inertia forces.

A body that bends under the geometric stiffness of ``mechanics.elastic.stiffening`` is displaced to second order, too. Let K_c
and K_ij be K_g of a unit acceleration a_c and of a unit L_ij. The work of the inertia forces on the second-order displacements
u2 is that of their stress, which gives the moments

    m2_c = int rho u2_c = 1/2 u^T K_c u,        P2_ij = int rho u2_i X_j = 1/2 u^T K_ij u                    (1)

Points are X + u + u2. Of the velocities W = v + w~(X + u) + u' and W_2 = w~ u2 + u2' in body axes, (1) tells the moments that
belong to a rigid motion c = (c_v, c_w) of the body,

    g = int rho Z^T W,    h = int rho Z^T W_2,    Z c = c_v + c_w~ X,    J = int rho Z^T Z                   (2)

and u2 changes the energy of this mean motion, J^-1 g, alone. Beside int rho |W|^2 / 2 the kinetic energy has

    T_2 = 1/2 (g + h)^T J^-1 (g + h) - 1/2 g^T J^-1 g                                                        (3)

so that it is positive always. With e = J^-1 h, b = J^-1 (g + h), and a(c) = c_v' + w~ c_v, L(c) = c_w'~ + w~ c_w~ for both,
P = X + u, R^T g_0 weight, Lagrange's equations of (3) are

    field        int rho du . (a(e) + L(e) X) + sum_c (a(b) - R^T g_0)_c K_c u + sum_ij L(b)_ij K_ij u,
    translation  R int rho (a(e) + L(e) X),                                                                  (4)
    rotation     int rho P x (a(e) + L(e) X) + int rho u2 x (a(b) - R^T g_0 + L(b) X) + int rho (W x Z e + W_2 x Z b)

The stress is that of the mean accelerations of the body: those of a frame attached to a surface may be much larger. Rows of the
field alone would leave the mass matrix unsymmetric by K_c u and K_ij u: fast modes of a body that swings freely then grow
without bound.

Source: Lagrange's equations of (3). That motions need the shortening of a bent body, not only the stress: Kane, Ryan and
Banerjee, Dynamics of a cantilever beam attached to a moving base, J. Guidance 10 (1987) 139-151.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...rotations import Array, axial, hat, motions, spin_matrix


@dataclass(frozen=True, eq=False)
class DisplacementMoments:
    """Of displacements and their rates: ``s`` (count, d) int rho p, ``T`` (count, d, d) int rho X p^T of p = X + u, u', u'';
    ``m`` and ``P`` m2, P2 of (1) and their rates, in the same shapes.
    """

    s: Array
    T: Array
    m: Array
    P: Array

    @classmethod
    def of(cls, first: Array, z: Array, d: int) -> DisplacementMoments:
        """From the numbers of s and T, and of (1), one after the other, both (d + d^2, count)."""
        return cls(first[:d].T, first[d:].T.reshape(-1, d, d), z[:d].T, z[d:].T.reshape(-1, d, d))

    def body(self, S0: Array, mass: float, v: Array, turns: Sequence[Array]) -> tuple[Array, Array]:
        """int rho V and int rho X V^T of V = v + sum_r turns_r p^(r)."""
        total, matrix = np.asarray(mass * v), np.asarray(np.outer(S0, v))
        for w, s, T in zip(turns, self.s, self.T, strict=False):
            total, matrix = total + w @ s, matrix + T @ w.T
        return total, matrix

    def second(self, turns: Sequence[Array]) -> tuple[Array, Array]:
        """The same of sum_r turns_r u2^(r)."""
        total: Array = np.zeros(self.s.shape[1])
        matrix: Array = np.zeros(self.T.shape[1:])
        for w, m, P in zip(turns, self.m, self.P, strict=False):
            total, matrix = total + w @ m, matrix + P.T @ w.T
        return total, matrix


@dataclass(frozen=True, eq=False)
class Acting:
    """(4) at one motion: rows of the frame (n_twist,) in body axes; a(e), L(e) that act on the field; a(b) - R^T g_0 and L(b) as
    the coefficients (d + d^2,) of the stress.
    """

    frame: Array
    a: Array
    L: Array
    stress: Array


@dataclass(frozen=True, eq=False)
class SecondOrder:
    """(3) of one body: ``mass``, ``S0`` (d,) int rho X and ``X0`` (d, d) int rho X X^T."""

    mass: float
    S0: Array
    X0: Array
    inverse: Array = field(init=False)  # J^-1

    def __post_init__(self) -> None:
        J = rigid_masses(np.array([self.mass]), self.S0[None], self.X0[None])[0]
        object.__setattr__(self, "inverse", np.linalg.inv(J))

    def _vector(self, found: tuple[Array, Array]) -> Array:
        return np.concatenate((found[0], axial(found[1])))

    def _mean(self, found: tuple[Array, Array]) -> Array:
        """The rigid motion (n_twist,) with these momenta."""
        return self.inverse @ self._vector(found)

    def columns(self, z: DisplacementMoments) -> tuple[Array, Array]:
        """What (v, w) gives to g and to h, both (n_twist, n_twist)."""
        d = len(self.S0)
        n = motions(d).n_twist
        A, B = np.zeros((n, n)), np.zeros((n, n))
        units: Array = np.eye(n)
        for k in range(n):
            v, w = units[k, :d], spin_matrix(units[k, d:])
            A[:, k] = self._vector(z.body(self.S0, self.mass, v, (w,)))
            B[:, k] = self._vector(z.second((w,)))
        return A, B

    def acting(self, z: DisplacementMoments, twist: Array, accel: Array, gravity: Array) -> Acting:
        """(4); twist, accel (n_twist,) and gravity (d,) in body axes, moments with two rates."""
        d = len(self.S0)
        one = np.eye(d)
        v, w, wd = twist[:d], spin_matrix(twist[d:]), spin_matrix(accel[d:])
        vd = accel[:d] - w @ v

        # g and h of (2) with their rates, and the mean motions e and b of both
        g, g_rate = z.body(self.S0, self.mass, v, (w, one)), z.body(self.S0, self.mass, vd, (wd, w, one))
        h, h_rate = z.second((w, one)), z.second((wd, w, one))
        e, e_rate = self._mean(h), self._mean(h_rate)
        b, b_rate = self._mean(g) + e, self._mean(g_rate) + e_rate

        a, L = _acceleration(e, e_rate, w)
        pull, L_b = _acceleration(b, b_rate, w)
        pull = pull - gravity

        # the moment of (4), as a matrix: of inertia forces at P and at u2, then of W x Z e and W_2 x Z b
        N: Array = np.outer(z.s[0], a) + z.T[0].T @ L.T + np.outer(z.m[0], pull) + z.P[0] @ L_b.T
        N = N + np.outer(g[0], e[:d]) + g[1].T @ spin_matrix(e[d:]).T
        N = N + np.outer(h[0], b[:d]) + h[1].T @ spin_matrix(b[d:]).T
        frame = np.concatenate((self.mass * a + L @ self.S0, axial(N)))
        return Acting(frame, a, L, np.concatenate((pull, L_b.ravel())))

    def momentum(self, z: DisplacementMoments, twist: Array) -> tuple[Array, float]:
        """Derivatives of (3) by the twist (n_twist,) in body axes, and (3) itself; moments with one rate."""
        d = len(self.S0)
        turns = spin_matrix(twist[d:]), np.eye(d)
        g, h = self._vector(z.body(self.S0, self.mass, twist[:d], turns)), self._vector(z.second(turns))
        A, B = self.columns(z)
        e = self.inverse @ h
        return A.T @ e + B.T @ (self.inverse @ g + e), float(g @ e + 0.5 * h @ e)

    def mass_blocks(self, z: DisplacementMoments, A_u: Array, B_u: Array) -> tuple[Array, Array]:
        """What (3) adds to the mass: (frame, frame) and (field, frame), body axes; A_u, B_u (n_twist, n): g and h of u'."""
        A, B = self.columns(z)
        JA, JB = self.inverse @ A, self.inverse @ B
        return A.T @ JB + B.T @ JA + B.T @ JB, A_u.T @ JB + B_u.T @ (JA + JB)

    def own_mass(self, A_u: Array, B_u: Array) -> tuple[Array, Array]:
        """The same for (field, field), V C V^T: V (n, k) and C (k, k)."""
        return np.concatenate((A_u, B_u)).T, np.kron([[0.0, 1.0], [1.0, 1.0]], self.inverse)


def rigid_masses(mass: Array, S0: Array, X0: Array) -> Array:
    """J of (2), (b, n_twist, n_twist), of the masses (b,), S0 (b, d) and X0 (b, d, d) of several bodies."""
    d = S0.shape[1]
    n = motions(d).n_twist
    J = np.zeros((len(mass), n, n))
    J[:, range(d), range(d)] = mass[:, None]
    sums = np.trace(X0, axis1=1, axis2=2)[:, None, None]
    J[:, d:, d:] = sums * np.eye(3) - X0 if d == 3 else sums
    # what turning by a unit moves
    J[:, :d, d:] = -hat(S0) if d == 3 else np.stack((-S0[:, 1], S0[:, 0]), axis=1)[:, :, None]
    J[:, d:, :d] = J[:, :d, d:].swapaxes(1, 2)
    return J


def turning(columns: Array, d: int) -> Array:
    """h of u' (n_twist, n) from the columns K_c u, K_ij u (n, d + d^2)."""
    turned = columns[:, d:].T.reshape(d, d, -1)
    pairs = ((2, 1), (0, 2), (1, 0)) if d == 3 else ((1, 0),)
    return np.concatenate((columns[:, :d].T, np.stack([turned[i, j] - turned[j, i] for i, j in pairs])))


def load_moment(axes: Array, twice: Array) -> Array:
    """Moment (n_rot,) in body axes of a load on u2, from twice = u^T K_ij u (d, d) of its stress.

    Component i of the load along axis j of the body does the work -1/2 u^T K_ij u on u2; axes (d, d): factor times the axes.
    """
    return np.asarray(-0.5 * axial(twice.T @ axes))


def _acceleration(c: Array, rate: Array, w: Array) -> tuple[Array, Array]:
    """a(c) and L(c) of a mean motion c in a frame that turns with the matrix w."""
    d = len(w)
    return rate[:d] + w @ c[:d], spin_matrix(rate[d:]) + w @ spin_matrix(c[d:])
