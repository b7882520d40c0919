"""Beam elements: mass, stiffness and stress of a straight beam by its nodal degrees of freedom, reduced to its modes.

A plane of bending has the unknowns (v_1, theta_1, v_2, theta_2) of its two nodes. The element interpolates with the exact
static solution, of which shear = 12 EI / (GA l^2) is the share of shear; the theory is that of :mod:`.beams`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...errors import require
from ...rotations import Array
from ..reduction.reduced import ReducedConstants, SurfaceData

if TYPE_CHECKING:
    from .beams import Beam

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(4)  # exact for products of cubics


def _bending(xi: float, length: float, shear: float) -> tuple[Array, Array, Array]:
    """v, its slope v' and the section's rotation for unit (v_1, theta_1, v_2, theta_2); xi in [0, 1], with
    shear = 12 EI / (GA l^2).
    """
    x, p, c = xi, shear, 1.0 / (1.0 + shear)

    v = [
        1 - 3 * x**2 + 2 * x**3 + p * (1 - x),
        length * (x - 2 * x**2 + x**3 + p / 2 * (x - x**2)),
        3 * x**2 - 2 * x**3 + p * x,
        length * (-(x**2) + x**3 - p / 2 * (x - x**2)),
    ]

    slope = [  # of the centre line, times the length
        -6 * x + 6 * x**2 - p,
        length * (1 - 4 * x + 3 * x**2 + p / 2 * (1 - 2 * x)),
        6 * x - 6 * x**2 + p,
        length * (-2 * x + 3 * x**2 - p / 2 * (1 - 2 * x)),
    ]

    rotation = [  # of the section: without shear the slope itself
        (-6 * x + 6 * x**2) / length,
        1 - 4 * x + 3 * x**2 + p * (1 - x),
        (6 * x - 6 * x**2) / length,
        -2 * x + 3 * x**2 + p * x,
    ]

    return c * np.array(v), c / length * np.array(slope), c * np.array(rotation)


def _bending_stiffness(EI: float, length: float, shear: float) -> Array:
    """(4, 4) stiffness for (v_1, theta_1, v_2, theta_2)."""
    a, p = length, shear
    K = np.array(
        [
            [12, 6 * a, -12, 6 * a],
            [6 * a, (4 + p) * a * a, -6 * a, (2 - p) * a * a],
            [-12, -6 * a, 12, -6 * a],
            [6 * a, (2 - p) * a * a, -6 * a, (4 + p) * a * a],
        ]
    )
    return EI / (a**3 * (1 + p)) * K


def _products(a: Array, b: Array) -> Array:
    """a_ip b_jq of columns p, q, (p, q, i, j)."""
    return np.einsum("ip,jq->pqij", a, b)


class BeamElements:
    """Sums over Gauss points and elements. Degrees of freedom of a node: (u, v, theta) or (u, v, w, theta_x, theta_y,
    theta_z).
    """

    def __init__(self, beam: Beam) -> None:
        self.beam, self.s = beam, beam.section
        self.d = beam.dim
        self.per = 3 if self.d == 2 else 6
        self.n = self.per * (beam.elements + 1)
        self.a = beam.length / beam.elements

        self.origin = 0.5 * beam.length  # of the frame: the centre of mass
        # (axis of the displacement, columns of (v, theta) at a node, sign of the rotation, EI, index of the section direction)
        planes = [(1, (1, 2 if self.d == 2 else 5), 1.0, self.s.EI, 0)]

        if self.d == 3:
            assert self.s.EI_y is not None
            planes.append((2, (2, 4), -1.0, self.s.EI_y, 1))
        self.planes = planes

    def shear(self, EI: float) -> float:
        """12 EI / (GA l^2) of an element, 0 without shear."""
        return 0.0 if self.s.GA is None else 12 * EI / (self.s.GA * self.a**2)

    def fields(self, e: int, xi: float) -> tuple[Array, Array, Array]:
        """U (d, n + 1), section fields V (d - 1, d, n + 1) and slopes (d - 1, n) at a point; column 0 is the reference."""
        d, per = self.d, self.per
        U = np.zeros((d, self.n + 1))
        V = np.zeros((d - 1, d, self.n + 1))
        slopes = np.zeros((d - 1, self.n))
        first, second = per * e, per * (e + 1)

        # column 0: the undeformed beam
        U[0, 0] = (e + xi) * self.a - self.origin
        for k in range(d - 1):
            V[k, k + 1, 0] = 1.0

        # stretch, then bending in each plane
        U[0, 1 + first], U[0, 1 + second] = 1 - xi, xi
        for axis, (iv, it), sign, EI, k in self.planes:
            v, slope, turn = _bending(xi, self.a, self.shear(EI))
            cols = np.array([first + iv, first + it, second + iv, second + it])
            signs = np.array([1.0, sign, 1.0, sign])  # theta_y = -w'
            U[axis, 1 + cols] = signs * v
            V[k, 0, 1 + cols] = -signs * turn  # sections tilt by -v' along x
            slopes[k, cols] = signs * slope

        # torsion turns the sections
        if d == 3:
            for at, N in ((first + 3, 1 - xi), (second + 3, xi)):
                V[0, 2, 1 + at], V[1, 1, 1 + at] = N, -N

        return U, V, slopes

    def _points(self) -> Iterator[tuple[float, float]]:
        """Gauss points of an element, in 0 ... 1, with their weights (m)."""
        return zip(0.5 * (1 + GAUSS_X), 0.5 * self.a * GAUSS_W, strict=True)

    def inertia(self) -> tuple[Array, Array]:
        """S (d, n + 1) and T (n + 1, n + 1, d, d) in beam axes."""
        S = np.zeros((self.d, self.n + 1))
        T = np.zeros((self.n + 1, self.n + 1, self.d, self.d))
        # sections turn: their second moments go with V of (1)
        second = [self.s.rhoI, self.s.rhoI_y or 0.0]
        first = np.concatenate(([0], 1 + np.arange(2 * self.per)))
        moment, block = np.zeros((self.d, len(first))), np.zeros((len(first), len(first), self.d, self.d))
        for x, w in self._points():
            U, V, _ = self.fields(0, x)
            U, V = U[:, first], V[:, :, first]
            moment += w * self.s.rhoA * U
            block += w * self.s.rhoA * _products(U, U)
            for k in range(self.d - 1):
                block += w * second[k] * _products(V[k], V[k])

        # the others are the first one moved along the beam
        mass, moved = self.s.rhoA * self.a, np.zeros_like(moment)
        for e in range(self.beam.elements):
            cols = np.concatenate(([0], first[1:] + self.per * e))
            moved[0, 0] = e * self.a
            S[:, cols] += moment + mass * moved
            T[np.ix_(cols, cols)] += block + _products(moved, moment) + _products(moment + mass * moved, moved)

        return S, T

    def stiffness(self) -> Array:
        """(n, n)."""
        K = np.zeros((self.n, self.n))
        bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / self.a
        for e in range(self.beam.elements):
            i = self.per * e
            j = self.per * (e + 1)
            K[np.ix_([i, j], [i, j])] += self.s.EA * bar

            for _, (iv, it), sign, EI, _k in self.planes:
                cols = [i + iv, i + it, j + iv, j + it]
                signs = np.array([1.0, sign, 1.0, sign])
                K[np.ix_(cols, cols)] += signs[:, None] * _bending_stiffness(EI, self.a, self.shear(EI)) * signs

            # torsion
            if self.d == 3:
                K[np.ix_([i + 3, j + 3], [i + 3, j + 3])] += (self.s.GJ or 0.0) * bar
        return K

    def stiffening(self) -> Array:
        """Geometric stiffness for unit a_x, unit L_xx and a unit tension at the end, in beam axes, (3, n, n): the axial force
        is N(x) = F - int_x^l rhoA (a_x + L_xx s) ds.
        """
        G = np.zeros((3, self.n, self.n))
        top = self.beam.length - self.origin
        for x, w in self._points():
            _, _, slopes = self.fields(0, x)
            # work of a unit axial force, int w (v'^2 + w'^2) dx
            slopes = slopes[:, : 2 * self.per]
            work = w * slopes.T @ slopes
            for e in range(self.beam.elements):
                at = slice(self.per * e, self.per * (e + 2))
                s = (e + x) * self.a - self.origin
                G[0, at, at] -= self.s.rhoA * (top - s) * work
                G[1, at, at] -= self.s.rhoA * 0.5 * (top**2 - s**2) * work
                G[2, at, at] += work
        return G

    def basis(self, K: Array, M: Array) -> Array:
        """Columns that span the motion in the frame: M-orthonormal modes, all or the first ``modes``."""
        import scipy.linalg as sl

        if self.beam.attached:
            # the frame holds the first section
            V = np.eye(self.n)[:, self.per :]
        else:
            # mean axes: no momentum, M-orthogonal to rigid motions
            Z = self._rigid()
            V = sl.null_space((M @ Z / np.abs(M @ Z).max(0)).T)

        values, modes = sl.eigh(V.T @ K @ V, V.T @ M @ V)

        keep = len(values) if self.beam.modes is None else self.beam.modes
        require(
            keep <= len(values),
            f'Beam "{self.beam.name}": {keep} modes asked for, its {self.beam.elements} elements have {len(values)}.',
        )

        return np.asarray(V @ modes[:, :keep])

    def _rigid(self) -> Array:
        """Rigid displacements, (n, n_twist)."""
        nodes = np.arange(self.beam.elements + 1)
        x = nodes * self.a - self.origin
        Z = np.zeros((len(nodes), self.per, 3 if self.d == 2 else 6))

        for i in range(self.per):
            Z[:, i, i] = 1.0
        # rotations move the nodes too: z -> y, and y -> -z in space
        if self.d == 2:
            Z[:, 1, 2] = x
        else:
            Z[:, 1, 5], Z[:, 2, 4] = x, -x
        return Z.reshape(self.n, -1)

    def axes(self) -> Array:
        """Columns: the beam's x, y (and z) in world axes."""
        e = np.subtract(self.beam.end, self.beam.start) / self.beam.length
        if self.d == 2:
            return np.array([[e[0], -e[1]], [e[1], e[0]]])
        # y is the part of `up` across the beam; where none is given the world axis most across it
        up = np.eye(3)[int(np.argmin(np.abs(e)))] if self.beam.up is None else np.asarray(self.beam.up, dtype=float)
        y = up - (up @ e) * e
        size = float(np.linalg.norm(y))
        require(size > 1e-9, f'Beam "{self.beam.name}": up = {self.beam.up} lies along the beam.')

        y = y / size
        return np.stack((e, y, np.cross(e, y)), axis=1)

    def constants(self) -> ReducedConstants:
        """Everything in world axes of the start."""
        beam, R = self.beam, self.axes()
        S, T = self.inertia()
        K = self.stiffness()
        M = np.trace(T[1:, 1:], axis1=2, axis2=3)
        V = self.basis(K, M)
        W = self._with_reference(V)

        # inertia, stiffness and damping of the modes
        S = R @ S @ W
        T = (W.T @ (R @ T @ R.T).transpose(2, 3, 0, 1) @ W).transpose(2, 3, 0, 1)
        K = V.T @ K @ V
        D = beam.mass_damping * V.T @ M @ V + beam.stiffness_damping * K
        center = np.mean([beam.start, beam.end], axis=0, dtype=float)

        # what joints see
        ends = {"start": (0, 0.0, beam.start), "end": (beam.elements - 1, 1.0, beam.end)}
        surfaces = {k: self._section(e, x, R, W, np.asarray(at, dtype=float)) for k, (e, x, at) in ends.items()}

        # stress of unit inertia forces along the beam
        G = None
        if beam.stiffening:
            along = R[:, 0]
            by_accel, by_spin, by_tension = V.T @ self.stiffening() @ V

            # only their components along the beam strain it
            of_accel = np.multiply.outer(along, by_accel)
            of_spin = np.multiply.outer(np.outer(along, along).ravel(), by_spin)
            G = np.concatenate((of_accel, of_spin))
            surfaces["end"] = replace(surfaces["end"], bend=np.multiply.outer(along, by_tension))
        return ReducedConstants(self.s.rhoA * beam.length, S, T, K, D, surfaces, center, beam.length, G)

    def centre_line(self, per_element: int) -> Array:
        """Points along the beam, (n, d, 1 + modes)."""
        M = np.trace(self.inertia()[1][1:, 1:], axis1=2, axis2=3)
        V = self.basis(self.stiffness(), M)
        W = self._with_reference(V)

        R = self.axes()
        last = self.beam.elements - 1
        places = [(e, k / per_element) for e in range(last + 1) for k in range(per_element)]

        return np.stack([R @ self.fields(e, x)[0] @ W for e, x in (*places, (last, 1.0))])

    def _with_reference(self, V: Array) -> Array:
        """Columns (1 + n, 1 + modes): the undeformed beam, then the modes."""
        W = np.zeros((self.n + 1, V.shape[1] + 1))
        W[0, 0] = 1.0
        W[1:, 1:] = V
        return W

    def _section(self, e: int, x: float, R: Array, W: Array, at: Array) -> SurfaceData:
        """Moments of an end section: b_0 its centre, b_k of the section directions, weighted like an area."""
        U, V, _ = self.fields(e, x)
        U, V = R @ U @ W, R @ V @ W  # V: (d - 1, d, m + 1)

        # weights like int y_j^2 dA; the common factor does not matter for a rotation
        bending = np.array([self.s.EI, self.s.EI_y or 0.0][: self.d - 1])
        share = bending / bending.sum()

        b = np.zeros((1 + self.d, self.d, W.shape[1]))
        b[0] = U
        for k in range(self.d - 1):
            b[1:] += np.multiply.outer(R[:, k + 1], share[k] * V[k])
        return SurfaceData(b[:, :, 0], b[:, :, 1:].reshape((1 + self.d) * self.d, -1), at)
