"""Coefficients of Radau IIA: collocation at the zeros of P_s - P_s-1, right end included."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...polynomials import lagrange_values
from ...rotations import Array


@dataclass(frozen=True)
class Tableau:
    """Nodes c, inverse W of the coefficients, eigenvalues and vectors of W, weights of the error estimate."""

    c: Array
    W: Array
    values: Array  # one of each complex pair
    vectors: Array  # (s, p), those of complex pairs doubled: y = Re(vectors z)
    inverse: Array  # (p, s)
    gamma: float  # of the real matrix in the error estimate
    error: Array  # e_i, with error ~ y'_n + sum_i e_i (y_i - y_n) / h
    basis: Array  # (s + 1, s + 1): powers of t / h to Lagrange polynomials of 0, c
    stage_basis: Array  # (s, s): the same of c
    middle: Array  # (s,): Lagrange polynomials of 0, c in the middle of a step, that of 0 left out
    between: Array  # (2 + 3 s,): see _between()

    def frequencies(self, h: float) -> Array:
        """Eigenvalues over h, (p,) in 1/s; each part divided by itself, as in radau.c: complex division rounds otherwise."""
        found: Array = (self.values.view(float) / h).view(complex)
        return found


@lru_cache
def tableau(stages: int) -> Tableau:
    """Radau IIA: collocation at the zeros of P_s - P_s-1, so the coefficients integrate the Lagrange polynomials."""
    c = _nodes(stages)
    x, w = np.polynomial.legendre.leggauss(stages)
    A = np.array([0.5 * ci * (w @ lagrange_values(c, 0.5 * ci * (1 + x))) for ci in c])
    W = np.linalg.inv(A)

    # of each complex pair of eigenvalues one, behind the real one
    values, vectors = np.linalg.eig(W)
    real = np.abs(values.imag) < 1e-9 * np.abs(values)
    values = np.where(real, values.real, values)
    keep = np.flatnonzero(values.imag >= 0)
    keep = keep[np.argsort(values[keep].imag)]
    values, inverse = values[keep], np.linalg.inv(vectors)[keep]
    doubled = vectors[:, keep] * np.where(values.imag == 0, 1.0, 2.0)

    gamma = float(values[0].real) if values[0].imag == 0 else 3.0
    error = gamma * (_embedded_weights(c, 1 / gamma) - A[-1]) @ W

    # polynomials through the start of a step and its stages
    nodes = np.append(0.0, c)
    basis, stage_basis = (np.linalg.inv(z[:, None] ** np.arange(len(z))) for z in (nodes, c))
    middle = lagrange_values(nodes, np.array([0.5]))[0, 1:]
    between = _between(c, A, error, basis)
    return Tableau(c, W, values.astype(complex), doubled, inverse, gamma, error, basis, stage_basis, middle, between)


def _nodes(stages: int) -> Array:
    """The zeros of P_s - P_s-1 on (0, 1], the last one at its end."""
    series = np.polynomial.Legendre([*np.zeros(stages - 1), -1.0, 1.0])
    roots = np.sort(series.roots().real)
    roots -= series(roots) / series.deriv()(roots)  # to the last digit
    return np.append(0.5 * (1 + roots[:-1]), 1.0)


def _between(c: Array, A: Array, error: Array, basis: Array) -> Array:
    """Where the motion through the stages is looked at once more: the middle of the widest gap between them, as a share of the
    step; what makes the defect there as large as that of ``error`` where forces are t^s; weights of the stages there, of places,
    of rates times h, and of what stages alone tell.
    """
    nodes, powers = np.append(0.0, c), np.arange(len(c) + 1)
    at = float(0.5 * (nodes[:-1] + nodes[1:])[np.diff(nodes).argmax()])
    places = at**powers @ basis[:, 1:]
    rates = powers * at ** np.maximum(powers - 1, 0) @ basis[:, 1:]
    reached = A @ c ** len(c)
    alike = abs(error @ reached / (at ** len(c) - rates @ reached))
    return np.concatenate(([at, alike], places, rates, lagrange_values(c, np.array([at]))[0]))


def _embedded_weights(c: Array, at_start: float) -> Array:
    """Weights of the nodes in the quadrature of order s with 0 as a further node of weight ``at_start``."""
    powers = np.arange(1, len(c) + 1)
    moments = 1 / powers - np.where(powers == 1, at_start, 0.0)
    return np.linalg.solve((c[:, None] ** (powers - 1)).T, moments)


@lru_cache
def controlled(stages: int) -> Tableau:
    """The tableau with gamma first of all frequencies, which filters errors. Of an even number of stages it is none of their own:
    no stage has a share in it.
    """
    tab = tableau(stages)
    if tab.values[0].imag == 0:
        return tab
    values = np.append(complex(tab.gamma), tab.values)
    inverse = np.concatenate((np.zeros((1, stages)), tab.inverse))
    return replace(tab, values=values, vectors=np.pad(tab.vectors, ((0, 0), (1, 0))), inverse=inverse)
