"""Straight beams in a floating frame: Euler-Bernoulli or Timoshenko elements as reduced bodies, no mesh library needed.

A cross-section moves rigidly. In the beam's axes (x along it, y and z principal) the material points displace by

    u = U(x) + y V_y(x) + z V_z(x),   U = (u, v, w),  V_y = (-theta_z, 0, theta_x),  V_z = (theta_y, -theta_x, 0)       (1)

so a beam is a basis of fields like any other: with densities rho A, rho I_z, rho I_y of the sections the constants of
``mechanics.reduction.reduced`` are T_ab = int rho A U_a U_b^T + rho I_z V_y,a V_y,b^T + rho I_y V_z,a V_z,b^T dx, all
inertia couplings
included. Elements interpolate with the exact static solution (Hermite functions for GA = infinity, else with the shear
parameter 12 EI / (GA l^2)). The axial force of the inertia forces stiffens bending by int N (v'^2 + w'^2) dx.

Source: Przemieniecki, Theory of Matrix Structural Analysis, 1968, chapters 5 and 15.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...checks import check_fields, number, vector, whole
from ...errors import InputError, near, require
from ...rotations import Array
from ..reduction.reduced import Constants, SurfaceData
from .bodies import RigidBody, Surface
from .body import Body

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(4)  # exact for products of cubics


@dataclass(frozen=True)
class Section:
    """Stiffness and inertia of a cross-section, constant along the beam.

    ``EA`` N, ``EI`` N m^2 (about z; in space also ``EI_y`` about y and ``GJ``), ``rhoA`` kg/m, ``rhoI`` kg m (about z; in
    space also ``rhoI_y``), ``GA`` shear stiffness N, None for Euler-Bernoulli.
    """

    EA: float
    EI: float
    rhoA: float
    rhoI: float = 0.0
    GA: float | None = None
    EI_y: float | None = None
    GJ: float | None = None
    rhoI_y: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        stiff = {"EA": self.EA, "EI": self.EI, "rhoA": self.rhoA, "GA": self.GA, "EI_y": self.EI_y, "GJ": self.GJ}
        for name, value in stiff.items():
            if value is not None:
                number(f"Section: {name} =", value, above=0.0)
        number("Section: rhoI =", self.rhoI, least=0.0)
        number("Section: rhoI_y =", 0.0 if self.rhoI_y is None else self.rhoI_y, least=0.0)

    @property
    def thickness(self) -> float:
        """Height (m) of the rectangle with this ratio of stiffnesses; a drawing shows it."""
        return float(np.sqrt(12 * self.EI / self.EA))

    @classmethod
    def rectangle(
        cls, *, youngs_modulus: float, poisson_ratio: float, density: float, width: float, height: float
    ) -> Section:
        """A solid rectangle: ``height`` along y, ``width`` along z (m); shear factor 5/6, torsion constant to 0.1 %."""
        given = {"youngs_modulus": youngs_modulus, "density": density, "width": width, "height": height}
        for name, value in given.items():
            number(f"Section.rectangle: {name}", value, above=0.0)
        nu = number("Section.rectangle: poisson_ratio", poisson_ratio, above=-1.0)
        require(nu <= 0.5, f"Section.rectangle: poisson_ratio {nu} must lie in (-1, 0.5].")
        E, G = youngs_modulus, youngs_modulus / (2 * (1 + poisson_ratio))
        A, Iz, Iy = width * height, width * height**3 / 12, height * width**3 / 12
        a, b = max(width, height), min(width, height)
        n = np.arange(1, 40, 2)
        J = a * b**3 / 3 * (1 - 192 * b / (np.pi**5 * a) * float((np.tanh(n * np.pi * a / (2 * b)) / n**5).sum()))
        return cls(E * A, E * Iz, density * A, density * Iz, 5 / 6 * G * A, E * Iy, G * J, density * Iy)


@dataclass(frozen=True, eq=False)
class Beam(Body):
    """A straight elastic beam from ``start`` to ``end`` (world, m; two components in the plane, three in space).

    Args:
        name: what messages call it. Its surfaces are the end sections "start" and "end".
        section: stiffness and inertia.
        elements: number of elements.
        modes: vibration modes to keep; None keeps every degree of freedom.
        attached: True: the frame holds the start section; False: mean axes.
        stiffening: geometric stiffness of the axial force by inertia, held at the start section, in either frame.
        up: direction of the section's y axis in space; any direction across the beam when None.
        velocity, angular_velocity: rigid motion at the start (of the centre of mass; rad/s).
        mass_damping, stiffness_damping: Rayleigh coefficients alpha (1/s) and beta (s).
    """

    name: str
    start: Sequence[float]
    end: Sequence[float]
    section: Section
    elements: int = 10
    modes: int | None = None
    attached: bool = True
    stiffening: bool = False
    up: Sequence[float] | None = None
    velocity: Any = None
    angular_velocity: Any = None
    mass_damping: float = 0.0
    stiffness_damping: float = 0.0

    @property
    def keeps_energy(self) -> bool:
        """Without damping."""
        return not (self.mass_damping or self.stiffness_damping)

    def __post_init__(self) -> None:
        what = f'Beam "{self.name}"'
        check_fields(self, what)
        require(
            self.dim in (2, 3) and len(self.end) == self.dim,
            f"{what}: start {self.start} and end {self.end} must both have 2 or 3 numbers.",
        )

        require(self.length > 0, f"{what}: start and end coincide.")
        whole(f"{what}: elements", self.elements, least=1)
        if self.modes is not None:
            whole(f"{what}: modes", self.modes)
        if self.up is not None:
            vector(f"{what}: up", self.up, size=self.dim, zero=False)

        number(f"{what}: mass_damping", self.mass_damping, least=0.0)
        number(f"{what}: stiffness_damping", self.stiffness_damping, least=0.0)
        self.start_twist()
        if self.dim == 3:
            s = self.section
            require(
                s.EI_y is not None and s.GJ is not None and s.rhoI_y is not None,
                f'Beam "{self.name}" in space: the section needs EI_y, GJ and rhoI_y too.',
            )

    @property
    def dim(self) -> int:  # type: ignore[override]
        """Space dimension, from the end points."""
        return len(self.start)

    @property
    def length(self) -> float:
        """m."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    def surface(self, name: str) -> Surface:
        """An end section: "start" or "end"."""
        if name not in ("start", "end"):
            raise InputError(f'Beam "{self.name}": no surface "{name}". {near(name, ["start", "end"])}')
        return Surface(self, name)

    def start_twist(self) -> Array:
        """Rigid velocity at the start, (n_twist,)."""
        J = 1.0 if self.dim == 2 else (1.0, 1.0, 1.0)
        return RigidBody(
            self.name, 1.0, J, velocity=self.velocity, angular_velocity=self.angular_velocity
        ).start_twist()

    def start_local(self) -> tuple[Array, Array]:
        """The beam starts undeformed."""
        n = self.constants.n_modes
        return np.zeros(n), np.zeros(n)

    def finer(self, surfaces: tuple[str, ...]) -> Beam:
        """The same beam with all degrees of freedom of its elements."""
        return replace(self, modes=None)

    def with_finer_space(self, *, higher: bool) -> Beam:
        """The same beam with twice the elements: their degree is fixed. As many modes."""
        return replace(self, elements=2 * self.elements)

    @cached_property
    def constants(self) -> Constants:
        """What the time loop needs."""
        return _Assembly(self).constants()

    def centre_line(self, per_element: int = 4) -> Array:
        """Points of the centre line from the centre of mass, and their modes, (n, d, 1 + modes); world axes of the start, m."""
        return _Assembly(self).centre_line(per_element)


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


class _Assembly:
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
        return 0.0 if self.s.GA is None else 12 * EI / (self.s.GA * self.a**2)

    def fields(self, e: int, xi: float) -> tuple[Array, Array, Array]:
        """U (d, n + 1), section fields V (d - 1, d, n + 1) and slopes (d - 1, n) at a point; column 0 is the reference."""
        d, per = self.d, self.per
        U, V = np.zeros((d, self.n + 1)), np.zeros((d - 1, d, self.n + 1))
        slopes = np.zeros((d - 1, self.n))
        first, second = per * e, per * (e + 1)
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

    def inertia(self) -> tuple[Array, Array]:
        """S (d, n + 1) and T (n + 1, n + 1, d, d) in beam axes."""
        S = np.zeros((self.d, self.n + 1))
        T = np.zeros((self.n + 1, self.n + 1, self.d, self.d))
        second = [self.s.rhoI, self.s.rhoI_y or 0.0]
        for e in range(self.beam.elements):
            cols = np.concatenate(([0], 1 + self.per * e + np.arange(2 * self.per)))
            for x, w in zip(0.5 * (1 + GAUSS_X), 0.5 * self.a * GAUSS_W, strict=True):
                U, V, _ = self.fields(e, x)
                U, V = U[:, cols], V[:, :, cols]
                S[:, cols] += w * self.s.rhoA * U
                block = self.s.rhoA * np.einsum("ia,jb->abij", U, U)
                for k in range(self.d - 1):
                    block += second[k] * np.einsum("ia,jb->abij", V[k], V[k])
                T[np.ix_(cols, cols)] += w * block
        return S, T

    def stiffness(self) -> Array:
        """(n, n)."""
        K = np.zeros((self.n, self.n))
        bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / self.a
        for e in range(self.beam.elements):
            i, j = self.per * e, self.per * (e + 1)
            K[np.ix_([i, j], [i, j])] += self.s.EA * bar
            for _, (iv, it), sign, EI, _k in self.planes:
                cols = [i + iv, i + it, j + iv, j + it]
                signs = np.array([1.0, sign, 1.0, sign])
                K[np.ix_(cols, cols)] += signs[:, None] * _bending_stiffness(EI, self.a, self.shear(EI)) * signs
            if self.d == 3:
                K[np.ix_([i + 3, j + 3], [i + 3, j + 3])] += (self.s.GJ or 0.0) * bar
        return K

    def stiffening(self) -> Array:
        """Geometric stiffness for unit a_x, unit L_xx and a unit tension at the end, in beam axes, (3, n, n): the axial force
        is N(x) = F - int_x^l rhoA (a_x + L_xx s) ds.
        """
        G = np.zeros((3, self.n, self.n))
        top = self.beam.length - self.origin
        for e in range(self.beam.elements):
            for x, w in zip(0.5 * (1 + GAUSS_X), 0.5 * self.a * GAUSS_W, strict=True):
                s = (e + x) * self.a - self.origin
                _, _, slopes = self.fields(e, x)
                work = w * slopes.T @ slopes
                G[0] -= self.s.rhoA * (top - s) * work
                G[1] -= self.s.rhoA * 0.5 * (top**2 - s**2) * work
                G[2] += work
        return G

    def basis(self, K: Array, M: Array) -> Array:
        """Columns that span the motion in the frame: M-orthonormal modes, all or the first ``modes``."""
        import scipy.linalg as sl

        if self.beam.attached:
            V = np.eye(self.n)[:, self.per :]
        else:
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
        up = np.eye(3)[int(np.argmin(np.abs(e)))] if self.beam.up is None else np.asarray(self.beam.up, dtype=float)
        y = up - (up @ e) * e
        size = float(np.linalg.norm(y))
        require(size > 1e-9, f'Beam "{self.beam.name}": up = {self.beam.up} lies along the beam.')
        y = y / size
        return np.stack((e, y, np.cross(e, y)), axis=1)

    def constants(self) -> Constants:
        """Everything in world axes of the start."""
        beam, R = self.beam, self.axes()
        S, T = self.inertia()
        K = self.stiffness()
        M = np.trace(T[1:, 1:], axis1=2, axis2=3)
        V = self.basis(K, M)
        W = self._with_reference(V)

        # inertia, stiffness and damping of the modes
        S = R @ S @ W
        T = np.einsum("ap,abij,bq->pqij", W, np.einsum("xi,abij,yj->abxy", R, T, R), W, optimize=True)
        K = V.T @ K @ V
        D = beam.mass_damping * V.T @ M @ V + beam.stiffness_damping * K
        center = 0.5 * (np.asarray(beam.start, dtype=float) + np.asarray(beam.end, dtype=float))

        # what joints see
        ends = {"start": (0, 0.0, beam.start), "end": (beam.elements - 1, 1.0, beam.end)}
        surfaces = {k: self._section(e, x, R, W, np.asarray(at, dtype=float)) for k, (e, x, at) in ends.items()}

        # stress of unit inertia forces along the beam
        G = None
        if beam.stiffening:
            Gx = np.einsum("ap,kab,bq->kpq", V, self.stiffening(), V, optimize=True)
            G = np.concatenate(
                (np.multiply.outer(R[:, 0], Gx[0]), np.multiply.outer(np.outer(R[:, 0], R[:, 0]).ravel(), Gx[1]))
            )
            surfaces["end"] = replace(surfaces["end"], bend=np.multiply.outer(R[:, 0], Gx[2]))
        return Constants(self.s.rhoA * beam.length, S, T, K, D, surfaces, center, beam.length, G)

    def centre_line(self, per_element: int) -> Array:
        """Points along the beam, (n, d, 1 + modes)."""
        M = np.trace(self.inertia()[1][1:, 1:], axis1=2, axis2=3)
        V = self.basis(self.stiffness(), M)
        W = self._with_reference(V)
        R, last = self.axes(), self.beam.elements - 1
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
        bending = np.array([self.s.EI, self.s.EI_y or 0.0][: self.d - 1])
        share = bending / bending.sum()  # like int y_j^2 dA; the common factor does not matter for a rotation
        b = np.zeros((1 + self.d, self.d, W.shape[1]))
        b[0] = U
        for k in range(self.d - 1):
            b[1:] += np.multiply.outer(R[:, k + 1], share[k] * V[k])
        return SurfaceData(b[:, :, 0], b[:, :, 1:].reshape((1 + self.d) * self.d, -1), at)
