"""Strains of a rod from interpolated places and interpolated quaternions of its sections; with first and second derivatives.

Between nodes the place x and the quaternion P (not of unit length there) are polynomials of the element's coordinate. With
R(P) the rotation of P / |P| and ' = d/ds along the reference curve,

    Gamma = R(P)^T x',        K = 2 vec(conj(P) P') / |P|^2,        e = (Gamma, K),  six numbers in the section's axes   (1)

A rigid motion superposed on the rod multiplies P from the left by one constant unit quaternion, which (1) does not see: strains
are objective to roundoff, for any rotation. They depend on the nodal values of the moment only, so they are independent of
the path, and contain no angle that could be singular. Two neighbouring nodes must differ by less than half a revolution.

All functions take arrays with leading axes: y = x' (..., 3), P and its derivative dP (..., 4) scalar last; z = (y, P, dP)
stands for the eleven numbers that strains depend on.

Sources: Simo, doi:10.1016/0045-7825(85)90050-7; Crisfield and Jelenic, doi:10.1098/rspa.1999.0352 (objectivity); Eugster and
Harsch, doi:10.1002/gamm.202300008 (interpolated quaternions).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ... import kernel_cache
from ...polynomials import lagrange
from ...rotations import Array
from ..kinds.expressions import Expression, Program, c_lines, gradient, symbol
from ..kinds.frames import Vector, cross


@dataclass(frozen=True)
class LobattoShape:
    """Lagrange interpolation on -1 <= xi <= 1 through Gauss-Lobatto nodes, and the Gauss points of the elastic energy.

    ``nodes`` (k,) with their Lobatto weights, which lump the mass; ``points`` (q,) with weights; ``N`` and ``dN`` (q, k): values
    and derivatives by xi of the k = degree + 1 polynomials at the q = degree points.
    """

    degree: int
    nodes: Array
    node_weights: Array
    points: Array
    weights: Array
    N: Array
    dN: Array


@cache
def shape_of(degree: int) -> LobattoShape:
    """The interpolation of one degree.

    As many Gauss points as the degree: the strains of a rigid or an inextensible rod are zero there without stiffening its
    bending (no locking), and the error of the energy falls as fast as that of the interpolation.
    """
    legendre = np.polynomial.legendre.Legendre.basis(degree)
    # Gauss-Lobatto: both ends, and the extrema of Legendre's polynomial
    nodes = np.concatenate(([-1.0], np.sort(np.real(legendre.deriv().roots())), [1.0]))
    node_weights = 2.0 / (degree * (degree + 1) * legendre(nodes) ** 2)
    points, weights = np.polynomial.legendre.leggauss(degree)

    N = np.empty((degree, degree + 1))
    dN = np.empty((degree, degree + 1))
    for i in range(degree + 1):
        others = np.polynomial.Polynomial.fromroots(np.delete(nodes, i))
        basis = others / others(nodes[i])
        N[:, i], dN[:, i] = basis(points), basis.deriv()(points)
    return LobattoShape(degree, nodes, node_weights, points, weights, N, dN)


def values_at(shape: LobattoShape, xi: float) -> Array:
    """Weights (q,) that continue numbers at the Gauss points, as a polynomial, to the place xi."""
    return np.array(lagrange(shape.points, xi))


# -- the definition, and what follows from it -----------------------------------------------------------------------------
PLACE_RATE, QUATERNION, QUATERNION_RATE = (
    Vector(symbol(f"z[{i}]") for i in part) for part in (range(3), range(3, 7), range(7, 11))
)
Z = (*PLACE_RATE, *QUATERNION, *QUATERNION_RATE)
FORCES = Vector(symbol(f"S[{i}]") for i in range(6))


def definition(y: Vector, P: Vector, dP: Vector) -> Vector:
    """e of (1)."""
    v = Vector(P[:3])
    w = P[3]
    dv = Vector(dP[:3])
    dw = dP[3]
    stretch = y * (w * w - v @ v) + v * (2.0 * (v @ y)) - cross(v, y) * (2.0 * w)
    bend = (dv * w - v * dw - cross(v, dv)) * 2.0
    return Vector((*stretch, *bend)) / (P @ P)


@cache
def derived() -> dict[str, list[Expression]]:
    """Expressions of e (6), de/dz (6 x 11, row by row), and of the lower half of d^2 (S . e)/dz^2 (66, row by row)."""
    e = definition(PLACE_RATE, QUATERNION, QUATERNION_RATE)
    slopes = gradient(e @ FORCES, Z)
    return {
        "value": list(e),
        "slope": [x for one in e for x in gradient(one, Z)],
        "curve": [x for i, slope in enumerate(slopes) for x in gradient(slope, Z[: i + 1])],
    }


def strains(y: Array, P: Array, dP: Array) -> Array:
    """e of (1), (..., 6)."""
    return strain_jacobian(y, P, dP)[0]


def strain_jacobian(y: Array, P: Array, dP: Array) -> tuple[Array, Array]:
    """e and de/dz, (..., 6) and (..., 6, 11)."""
    z = np.concatenate((y, P, dP), axis=-1)
    found = _evaluated("rod_strains", z, z, 72)
    return found[..., :6], found[..., 6:].reshape(*y.shape[:-1], 6, 11)


def strain_hessian(z: tuple[Array, Array, Array], S: Array) -> Array:
    """d^2 (S . e) / dz^2 for constant section forces S (..., 6); (..., 11, 11)."""
    # the lower triangle is computed: the second derivative is symmetric
    lower = _evaluated("rod_curvature", np.concatenate(z, axis=-1), S, 66)
    i, j = np.tril_indices(11)
    H = np.zeros((*lower.shape[:-1], 11, 11))
    H[..., i, j] = H[..., j, i] = lower
    return H


# -- evaluation: compiled, or in NumPy -----------------------------------------------------------------------------------------
RESULTS = {"rod_strains": ("value", "slope"), "rod_curvature": ("curve",)}


def c_source() -> str:
    """C functions of one Gauss point: strains and then their slopes, and the curvature of S . e."""
    parts = []
    for name, which in RESULTS.items():
        results = [x for one in which for x in derived()[one]]
        lines = c_lines(results, [f"out[{i}]" for i in range(len(results))])
        parts += [f"static void {name}(const double *z, const double *S, double *restrict out)", "{", "    (void)S;"]
        parts += [*(f"    {line}" for line in lines), "}", ""]
    return "\n".join(parts)


def _c_library() -> str:
    """The same over many points."""
    loops = [
        f"void {name}s(long n, const double *z, const double *S, long of_S, double *out)\n"
        f"{{ for (long i = 0; i < n; i++) {name}(z + 11 * i, S + of_S * i, out + {size} * i); }}\n"
        for name, size in (("rod_strains", 72), ("rod_curvature", 66))
    ]
    return "\n".join([c_source(), *loops])


@cache
def _library() -> Any:
    """The compiled functions; None without a compiler."""
    from ..kinds import expressions, frames

    made_from = b"".join(Path(str(file)).read_bytes() for file in (__file__, expressions.__file__, frames.__file__))
    return kernel_cache.load("rod_strains", _c_library, made_from=made_from)


@cache
def _program(name: str) -> Program:
    return Program([x for which in RESULTS[name] for x in derived()[which]])


def _evaluated(name: str, z: Array, S: Array, size: int) -> Array:
    """Results (..., size) of one function at many points."""
    library = _library()
    if library is None:
        values = {f"z[{i}]": z[..., i] for i in range(11)} | {f"S[{i}]": S[..., i] for i in range(6)}
        return np.stack([np.broadcast_to(x, z.shape[:-1]) for x in _program(name)(values)], axis=-1)

    z = np.ascontiguousarray(z, dtype=float)
    S = np.ascontiguousarray(S, dtype=float)
    out = np.empty((*z.shape[:-1], size))
    at_z, at_S, at_out = (ctypes.c_void_p(kernel_cache.address_of(x)) for x in (z, S, out))

    count = ctypes.c_long(z.size // 11)
    getattr(library, f"{name}s")(count, at_z, at_S, ctypes.c_long(S.shape[-1]), at_out)
    return out
