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

from dataclasses import dataclass
from functools import cache

import numpy as np

from ...rotations import Array, cross3, hat

PLACE, QUATERNION, RATE = slice(0, 3), slice(3, 7), slice(7, 11)  # of z
VECTOR, SCALAR = slice(3, 6), 6  # parts of P in z
RATE_VECTOR, RATE_SCALAR = slice(7, 10), 10  # parts of dP in z


@dataclass(frozen=True)
class Shape:
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
def shape_of(degree: int) -> Shape:
    """The interpolation of one degree.

    As many Gauss points as the degree: the strains of a rigid or an inextensible rod are zero there without stiffening its
    bending (no locking), and the error of the energy falls as fast as that of the interpolation.
    """
    legendre = np.polynomial.legendre.Legendre.basis(degree)
    nodes = np.concatenate(([-1.0], np.sort(np.real(legendre.deriv().roots())), [1.0]))
    node_weights = 2.0 / (degree * (degree + 1) * legendre(nodes) ** 2)
    points, weights = np.polynomial.legendre.leggauss(degree)

    N, dN = np.empty((degree, degree + 1)), np.empty((degree, degree + 1))
    for i in range(degree + 1):
        others = np.polynomial.Polynomial.fromroots(np.delete(nodes, i))
        basis = others / others(nodes[i])
        N[:, i], dN[:, i] = basis(points), basis.deriv()(points)
    return Shape(degree, nodes, node_weights, points, weights, N, dN)


def values_at(shape: Shape, xi: float) -> Array:
    """Weights (q,) that continue numbers at the Gauss points, as a polynomial, to the place xi."""
    basis = np.array([np.prod([(xi - b) / (a - b) for b in shape.points if b != a]) for a in shape.points])
    return basis


def strains(y: Array, P: Array, dP: Array) -> Array:
    """e of (1), (..., 6)."""
    v, w = P[..., :3], P[..., 3:]
    dv, dw = dP[..., :3], dP[..., 3:]
    square = (P * P).sum(-1, keepdims=True)

    stretch = (w * w - (v * v).sum(-1, keepdims=True)) * y
    stretch += 2.0 * (v * y).sum(-1, keepdims=True) * v - 2.0 * w * cross3(v, y)
    bend = 2.0 * (w * dv - dw * v - cross3(v, dv))
    return np.concatenate((stretch, bend), axis=-1) / square


def strain_jacobian(y: Array, P: Array, dP: Array) -> tuple[Array, Array]:
    """e and de/dz, (..., 6) and (..., 6, 11)."""
    e = strains(y, P, dP)
    v, w = P[..., :3], P[..., 3, None, None]
    dv, dw = dP[..., :3], dP[..., 3, None, None]
    one = np.eye(3)
    E = np.zeros((*e.shape, 11))

    # numerators of Gamma by y, by the vector and by the scalar of P
    vv, vy = _outer(v, v), _outer(v, y)
    along = np.trace(vy, axis1=-2, axis2=-1)[..., None, None]
    length = np.trace(vv, axis1=-2, axis2=-1)[..., None, None]
    E[..., :3, PLACE] = (w * w - length) * one + 2.0 * vv - 2.0 * w * hat(v)
    E[..., :3, VECTOR] = -2.0 * np.swapaxes(vy, -1, -2) + 2.0 * along * one + 2.0 * vy + 2.0 * w * hat(y)
    E[..., :3, SCALAR] = 2.0 * w[..., 0] * y - 2.0 * cross3(v, y)

    # numerators of K
    E[..., 3:, VECTOR] = 2.0 * (hat(dv) - dw * one)
    E[..., 3:, SCALAR] = 2.0 * dv
    E[..., 3:, RATE_VECTOR] = 2.0 * (w * one - hat(v))
    E[..., 3:, RATE_SCALAR] = -2.0 * v

    # both over |P|^2
    E[..., QUATERNION] -= 2.0 * _outer(e, P)
    return e, E / (P * P).sum(-1)[..., None, None]


def strain_hessian(z: tuple[Array, Array, Array], e: Array, E: Array, S: Array) -> Array:
    """d^2 (S . e) / dz^2 for constant section forces S (..., 6), with e and E of :func:`strain_jacobian`; (..., 11, 11)."""
    y, P, _ = z
    v, w = P[..., :3], P[..., 3, None, None]
    force, moment = S[..., :3], S[..., 3:]
    one = np.eye(3)
    H = np.zeros((*e.shape[:-1], 11, 11))

    # S . numerators: Gamma by y and P
    fy, fv = _outer(force, y), _outer(force, v)
    on_y = np.trace(fy, axis1=-2, axis2=-1)[..., None, None]
    on_v = np.trace(fv, axis1=-2, axis2=-1)[..., None, None]
    H[..., PLACE, VECTOR] = -2.0 * fv + 2.0 * on_v * one + 2.0 * np.swapaxes(fv, -1, -2) - 2.0 * w * hat(force)
    H[..., PLACE, SCALAR] = 2.0 * w[..., 0] * force - 2.0 * cross3(force, v)
    half = 0.5 * (2.0 * (fy + np.swapaxes(fy, -1, -2)) - 2.0 * on_y * one)
    H[..., VECTOR, VECTOR] = half
    H[..., VECTOR, SCALAR] = -2.0 * cross3(y, force)
    H[..., SCALAR, SCALAR] = on_y[..., 0, 0]

    # K by P and dP
    H[..., VECTOR, RATE_VECTOR] = 2.0 * hat(moment)
    H[..., VECTOR, RATE_SCALAR] = -2.0 * moment
    H[..., SCALAR, RATE_VECTOR] = 2.0 * moment

    # the quotient by |P|^2, of which the second derivative is twice the unit matrix
    slope = (S[..., None, :] @ E)[..., 0, :]
    value = (S * e).sum(-1)[..., None, None]
    H[..., :, QUATERNION] -= 2.0 * _outer(slope, P)
    H[..., QUATERNION, QUATERNION] -= value * np.eye(4)
    return (H + np.swapaxes(H, -1, -2)) / (P * P).sum(-1)[..., None, None]


def _outer(a: Array, b: Array) -> Array:
    """a b^T over the last axes."""
    product: Array = a[..., :, None] * b[..., None, :]
    return product
