"""Beam elements: mass, stiffness and stress of straight beams by their nodal degrees of freedom, reduced to their modes.

A plane of bending has the unknowns (v_1, theta_1, v_2, theta_2) of its two nodes. The element interpolates with the exact
static solution, of which shear = 12 EI / (GA l^2) is the share of shear; the theory is that of :mod:`.beams`. Beams of one form,
with as many elements and modes, are made together: all arrays have them in front, (b, ..).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...errors import require
from ...rotations import Array
from ..reduction.reduced import ReducedConstants, SurfaceData

if TYPE_CHECKING:
    from .beams import Beam

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(4)  # exact for products of cubics
TOGETHER = 32  # beams that are made at once: of more the arrays are large


def constants_of(beams: Sequence[Beam]) -> list[ReducedConstants]:
    """What the time loop needs of beams, those of one form together."""
    forms: dict[tuple[object, ...], list[int]] = {}
    for i, beam in enumerate(beams):
        form = (beam.dim, beam.elements, beam.modes, beam.attached, beam.stiffening, beam.section.GA is None)
        forms.setdefault(form, []).append(i)

    found: dict[int, ReducedConstants] = {}
    for alike in forms.values():
        for first in range(0, len(alike), TOGETHER):
            which = alike[first : first + TOGETHER]
            found |= zip(which, BeamElements([beams[i] for i in which]).constants(), strict=True)
    return [found[i] for i in range(len(beams))]


def _bending(xi: Array, length: Array, shear: Array) -> tuple[Array, Array, Array]:
    """v, its slope v' and the section's rotation for unit (v_1, theta_1, v_2, theta_2), (b, q, 4); xi (q,) in [0, 1], with
    shear = 12 EI / (GA l^2), (b, 1) as the length.
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

    c = c[..., None]
    return c * np.stack(v, -1), c / length[..., None] * np.stack(slope, -1), c * np.stack(rotation, -1)


def _bending_stiffness(EI: Array, length: Array, shear: Array) -> Array:
    """(b, 4, 4) stiffness for (v_1, theta_1, v_2, theta_2)."""
    a, p, one = length, shear, np.ones_like(length)
    K = [
        [12 * one, 6 * a, -12 * one, 6 * a],
        [6 * a, (4 + p) * a * a, -6 * a, (2 - p) * a * a],
        [-12 * one, -6 * a, 12 * one, -6 * a],
        [6 * a, (2 - p) * a * a, -6 * a, (4 + p) * a * a],
    ]
    return (EI / (a**3 * (1 + p)))[:, None, None] * np.moveaxis(np.array(K), -1, 0)


class BeamElements:
    """Sums over Gauss points and elements of beams of one form. Degrees of freedom of a node: (u, v, theta) or (u, v, w, theta_x,
    theta_y, theta_z).
    """

    def __init__(self, beams: Sequence[Beam]) -> None:
        self.beams, self.beam = beams, beams[0]
        self.d, self.elements = self.beam.dim, self.beam.elements
        self.per = 3 if self.d == 2 else 6
        self.n, self.of_element = self.per * (self.elements + 1), 2 * self.per

        sections = [beam.section for beam in beams]
        self.length = np.array([beam.length for beam in beams])
        self.a = self.length / self.elements
        self.origin = 0.5 * self.length  # of the frame: the centre of mass
        self.EA, self.rhoA = (np.array([getattr(s, name) for s in sections]) for name in ("EA", "rhoA"))
        self.GJ = np.array([s.GJ or 0.0 for s in sections])

        # of each plane of bending: EI and 12 EI / (GA l^2) of an element, rho I of the section direction, (b, d - 1)
        self.EI = np.array([(s.EI, s.EI_y or 0.0) for s in sections])[:, : self.d - 1]
        self.rhoI = np.array([(s.rhoI, s.rhoI_y or 0.0) for s in sections])[:, : self.d - 1]
        GA = np.array([s.GA or np.inf for s in sections])
        self.shear = 12 * self.EI / (GA * self.a**2)[:, None]

        # axis of the displacement, columns of (v, theta) at both nodes, their signs: theta_y = -w'
        bends = [(1, (1, 2 if self.d == 2 else 5), 1.0), (2, (2, 4), -1.0)][: self.d - 1]
        self.planes = [
            (axis, np.array([iv, it, self.per + iv, self.per + it]), np.array([1.0, sign, 1.0, sign]))
            for axis, (iv, it), sign in bends
        ]

    def fields(self, xi: Array) -> tuple[Array, Array, Array]:
        """U (b, q, d, k + 1), section fields V (b, q, d - 1, d, k + 1) and slopes (b, q, d - 1, k) of the k degrees of freedom of
        the first element at the points xi (q,); column 0 is the reference.
        """
        d, per, (b, q) = self.d, self.per, (len(self.a), len(xi))
        U = np.zeros((b, q, d, self.of_element + 1))
        V = np.zeros((b, q, d - 1, d, self.of_element + 1))
        slopes = np.zeros((b, q, d - 1, self.of_element))

        # column 0: the undeformed beam
        U[:, :, 0, 0] = xi * self.a[:, None] - self.origin[:, None]
        for k in range(d - 1):
            V[:, :, k, k + 1, 0] = 1.0

        # stretch, then bending in each plane
        U[:, :, 0, 1], U[:, :, 0, 1 + per] = 1 - xi, xi
        for k, (axis, cols, signs) in enumerate(self.planes):
            v, slope, turn = _bending(xi, self.a[:, None], self.shear[:, k, None])
            U[:, :, axis, 1 + cols] = signs * v
            V[:, :, k, 0, 1 + cols] = -signs * turn  # sections tilt by -v' along x
            slopes[:, :, k, cols] = signs * slope

        # torsion turns the sections
        if d == 3:
            for at, N in ((4, 1 - xi), (per + 4, xi)):
                V[:, :, 0, 2, at], V[:, :, 1, 1, at] = N, -N

        return U, V, slopes

    def _spans(self) -> Iterator[tuple[int, slice]]:
        """The elements, and their degrees of freedom."""
        return ((e, slice(self.per * e, self.per * e + self.of_element)) for e in range(self.elements))

    def inertia(self) -> tuple[Array, Array]:
        """S (b, d, n + 1) and T (b, n + 1, n + 1, d, d) in beam axes."""
        b, d, n, k = len(self.a), self.d, self.n + 1, self.of_element + 1
        S, T = np.zeros((b, d, n)), np.zeros((b, n, n, d, d))

        # of the first element; sections turn: their second moments go with V of (1)
        weight = 0.5 * self.a[:, None] * GAUSS_W  # m
        U, V, _ = self.fields(0.5 * (1 + GAUSS_X))
        moment = np.einsum("bq,bqik->bik", weight * self.rhoA[:, None], U)
        fields = np.concatenate((U[:, :, None], V), axis=2).reshape(b, -1, d * k)
        of_fields = np.concatenate((self.rhoA[:, None], self.rhoI), axis=1)
        weighted = (weight[:, :, None] * of_fields[:, None]).reshape(b, -1, 1) * fields
        block = (weighted.swapaxes(1, 2) @ fields).reshape(b, d, k, d, k).transpose(0, 2, 4, 1, 3).copy()

        # the others are the first one moved along the beam
        mass = self.rhoA * self.a
        for _, span in self._spans():
            later = slice(span.start + 1, span.stop + 1)
            S[:, :, 0] += moment[:, :, 0]
            S[:, :, later] += moment[:, :, 1:]
            T[:, 0, 0] += block[:, 0, 0]
            T[:, 0, later] += block[:, 0, 1:]
            T[:, later, 0] += block[:, 1:, 0]
            T[:, later, later] += block[:, 1:, 1:]
            # to the next one
            moved = self.a[:, None, None]
            block[:, 0, :, 0] += moved * moment.swapaxes(1, 2)
            moment[:, 0, 0] += mass * self.a
            block[:, :, 0, :, 0] += moved * moment.swapaxes(1, 2)

        return S, T

    def stiffness(self) -> Array:
        """(b, n, n)."""
        b, per = len(self.a), self.per
        one, bar = np.zeros((b, self.of_element, self.of_element)), np.array([[1.0, -1.0], [-1.0, 1.0]])
        stretched = np.array([0, per])
        one[:, stretched[:, None], stretched] = (self.EA / self.a)[:, None, None] * bar
        for k, (_, cols, signs) in enumerate(self.planes):
            bent = _bending_stiffness(self.EI[:, k], self.a, self.shear[:, k])
            one[:, cols[:, None], cols] = signs[:, None] * bent * signs
        if self.d == 3:
            twisted = stretched + 3
            one[:, twisted[:, None], twisted] = (self.GJ / self.a)[:, None, None] * bar

        K = np.zeros((b, self.n, self.n))
        for _, at in self._spans():
            K[:, at, at] += one
        return K

    def stiffening(self) -> Array:
        """Geometric stiffness for unit a_x, unit L_xx and a unit tension at the end, in beam axes, (b, 3, n, n): the axial force
        is N(x) = F - int_x^l rhoA (a_x + L_xx s) ds.
        """
        G = np.zeros((len(self.a), 3, self.n, self.n))
        xi = 0.5 * (1 + GAUSS_X)
        slopes = self.fields(xi)[2]
        # work of a unit axial force, int w (v'^2 + w'^2) dx
        work = (0.5 * self.a[:, None] * GAUSS_W)[..., None, None] * (slopes.swapaxes(2, 3) @ slopes)
        a, rhoA, origin = self.a[:, None], self.rhoA[:, None], self.origin[:, None]
        top = self.length[:, None] - origin
        for e, at in self._spans():
            s = (e + xi) * a - origin
            by = np.stack((-rhoA * (top - s), -rhoA * 0.5 * (top**2 - s**2), np.ones_like(s)), axis=1)
            G[:, :, at, at] += np.einsum("bcq,bqij->bcij", by, work)
        return G

    def basis(self, K: Array, M: Array) -> Array:
        """Columns that span the motion in the frame, (b, n, modes): M-orthonormal modes, all or the first ``modes``."""
        if self.beam.attached:
            # the frame holds the first section
            V = np.broadcast_to(np.eye(self.n)[:, self.per :], (len(K), self.n, self.n - self.per))
        else:
            # mean axes: no momentum, M-orthogonal to rigid motions
            Z = M @ self._rigid()
            held = (Z / np.abs(Z).max(axis=1, keepdims=True)).swapaxes(1, 2)
            V = np.linalg.svd(held)[2][:, held.shape[1] :].swapaxes(1, 2)

        T = V.swapaxes(1, 2)
        count = V.shape[2]
        keep = count if self.beam.modes is None else self.beam.modes
        require(
            keep <= count,
            f'Beam "{self.beam.name}": {keep} modes asked for, its {self.elements} elements have {count}.',
        )
        # K y = omega^2 M y by the factor of M
        L = np.linalg.cholesky(T @ M @ V)
        scaled = np.linalg.solve(L, np.linalg.solve(L, T @ K @ V).swapaxes(1, 2))
        modes = np.linalg.eigh(0.5 * (scaled + scaled.swapaxes(1, 2)))[1][:, :, :keep]
        return np.asarray(V @ np.linalg.solve(L.swapaxes(1, 2), modes))

    def _rigid(self) -> Array:
        """Rigid displacements, (b, n, n_twist)."""
        nodes = np.arange(self.elements + 1)
        x = nodes * self.a[:, None] - self.origin[:, None]
        Z = np.zeros((*x.shape, self.per, 3 if self.d == 2 else 6))

        for i in range(self.per):
            Z[:, :, i, i] = 1.0
        # rotations move the nodes too: z -> y, and y -> -z in space
        if self.d == 2:
            Z[:, :, 1, 2] = x
        else:
            Z[:, :, 1, 5], Z[:, :, 2, 4] = x, -x
        return Z.reshape(len(x), self.n, Z.shape[-1])

    def axes(self) -> Array:
        """Columns: each beam's x, y (and z) in world axes, (b, d, d)."""
        e = np.array([np.subtract(beam.end, beam.start) for beam in self.beams]) / self.length[:, None]
        if self.d == 2:
            return np.stack((e, np.stack((-e[:, 1], e[:, 0]), axis=1)), axis=2)
        # y is the part of `up` across the beam; where none is given the world axis most across it
        most = np.eye(3)[np.abs(e).argmin(axis=1)]
        up = np.array([x if b.up is None else b.up for x, b in zip(most, self.beams, strict=True)], dtype=float)
        y = up - (up * e).sum(axis=1, keepdims=True) * e
        size = np.linalg.norm(y, axis=1)
        for beam, across in zip(self.beams, size, strict=True):
            require(across > 1e-9, f'Beam "{beam.name}": up = {beam.up} lies along the beam.')

        y = y / size[:, None]
        return np.stack((e, y, np.cross(e, y)), axis=2)

    def constants(self) -> list[ReducedConstants]:
        """Everything in world axes of the start."""
        R = self.axes()
        S, T = self.inertia()
        K = self.stiffness()
        M = np.trace(T[:, 1:, 1:], axis1=3, axis2=4)
        V = self.basis(K, M)
        W = self._with_reference(V)
        along, back = V.swapaxes(1, 2), W.swapaxes(1, 2)[:, None, None]

        # inertia, stiffness and damping of the modes
        S = R @ S @ W
        T = back @ T.transpose(0, 3, 4, 1, 2) @ W[:, None, None]
        b, d, _, k, _ = T.shape
        for _ in range(2):  # both indices of places turn, first the second one
            T = (R @ T.swapaxes(1, 2).reshape(b, d, d * k * k)).reshape(b, d, d, k, k)
        T = T.transpose(0, 3, 4, 1, 2)
        K = along @ K @ V
        alpha, beta = np.array([(b.mass_damping, b.stiffness_damping) for b in self.beams]).T[:, :, None, None]
        D = alpha * (along @ M @ V) + beta * K
        center = np.mean([(b.start, b.end) for b in self.beams], axis=1, dtype=float)

        # what joints see
        reference, modes = self._sections(R, W)
        # stress of unit inertia forces along the beam
        G = along[:, None] @ self.stiffening() @ V[:, None] if self.beam.stiffening else None

        made = []
        for i, beam in enumerate(self.beams):
            ends = {"start": (0, beam.start), "end": (1, beam.end)}
            surfaces = {
                name: SurfaceData(reference[i, k], modes[i, k], np.asarray(at, dtype=float))
                for name, (k, at) in ends.items()
            }
            strained = None
            if G is not None:
                # only their components along the beam strain it
                x, (by_accel, by_spin, by_tension) = R[i, :, 0], G[i]
                of_accel, of_spin = np.multiply.outer(x, by_accel), np.multiply.outer(np.outer(x, x).ravel(), by_spin)
                strained = np.concatenate((of_accel, of_spin))
                surfaces["end"] = replace(surfaces["end"], bend=np.multiply.outer(x, by_tension))
            size, mass = float(self.length[i]), float(self.rhoA[i] * self.length[i])
            made.append(ReducedConstants(mass, S[i], T[i], K[i], D[i], surfaces, center[i], size, strained))
        return made

    def centre_line(self, per_element: int) -> Array:
        """Points along the first beam, (q, d, 1 + modes)."""
        M = np.trace(self.inertia()[1][:, 1:, 1:], axis1=3, axis2=4)
        W = self._with_reference(self.basis(self.stiffness(), M))[0]
        R = self.axes()[0]

        U, points = self.fields(np.linspace(0.0, 1.0, per_element + 1))[0][0], []
        for e, span in self._spans():
            mine = W[np.r_[0, 1 + span.start : 1 + span.stop]]
            here = U if e == self.elements - 1 else U[:-1]
            points.append(R @ here @ mine + np.multiply.outer(e * self.a[0] * R[:, 0], W[0]))
        return np.concatenate(points)

    def _with_reference(self, V: Array) -> Array:
        """Columns (b, 1 + n, 1 + modes): the undeformed beam, then the modes."""
        W = np.zeros((len(V), self.n + 1, V.shape[2] + 1))
        W[:, 0, 0] = 1.0
        W[:, 1:, 1:] = V
        return W

    def _sections(self, R: Array, W: Array) -> tuple[Array, Array]:
        """Moments of both end sections: b_0 its centre, b_k of the section directions, weighted like an area; of the reference
        (b, 2, 1 + d, d) and of the modes (b, 2, (1 + d) d, modes).
        """
        U, V, _ = self.fields(np.array([0.0, 1.0]))
        U[:, 1, 0, 0] += (self.elements - 1) * self.a
        first, last = np.r_[0 : self.of_element + 1], np.r_[0, self.n + 1 - self.of_element : self.n + 1]
        mine = np.stack((W[:, first], W[:, last]), axis=1)  # (b, 2, 1 + k, 1 + m)
        U = R[:, None] @ U @ mine
        V = R[:, None, None] @ V @ mine[:, :, None]  # (b, 2, d - 1, d, 1 + m)

        # weights like int y_j^2 dA; the common factor does not matter for a rotation
        share = self.EI / self.EI.sum(axis=1, keepdims=True)
        turned = np.einsum("bjk,bk,bskim->bsjim", R[:, :, 1:], share, V)
        moments = np.concatenate((U[:, :, None], turned), axis=2)  # (b, 2, 1 + d, d, 1 + m)
        modes = moments[..., 1:].reshape(*moments.shape[:2], (1 + self.d) * self.d, moments.shape[-1] - 1)
        return np.ascontiguousarray(moments[..., 0]), modes
