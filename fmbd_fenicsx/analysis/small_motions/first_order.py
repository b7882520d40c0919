"""Small motions as a system of first order: x = (z, u), coordinates and the velocities that rows on velocities leave free.

    z' = N u + D z,       N^T (M z'' + C z' + K z + H w) = N^T f                                              (1)

With rows G_s z' + P z = 0 (rolling) the columns of N span the null space of G_s, and D = -G_s^+ P. Without such rows N = 1, D = 0
and u = z'. Memories w, where there are any, follow w' = P z + Q z' + R w (:mod:`.small_memory`).

With rows, directions of z that nothing depends on (a place on the road, the angle of a wheel) have eigenvalues of exactly zero;
they are taken out before the others are computed, so that these keep their digits:

    A e = 0, e = (z, 0):     eigenvalues of A are zero and those of A on the rest, again and again               (2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sl

from ...errors import InputError
from ...rotations import Array
from .basis import ProjectedSystem

ALMOST = 1e-7  # share of the fastest eigenvalue below which a slow one is real
UNCHANGED = 1e-9  # strain of dashpots beside a motion of 1 m that is roundoff
NOTHING = 1e-10  # share of the largest singular value below which a direction changes nothing


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """x' = A x + B f of (1): ``n`` coordinates z, then the velocities u, then memories w; ``N``, ``D`` of (1)."""

    A: Array
    n: int
    N: Array
    D: Array
    push: Array  # u' caused by forces on z

    def motion(self, x: Array, u_rate: Array) -> tuple[Array, Array, Array]:
        """z, z', z'' for a state and the rate of its velocities u."""
        z = x[: self.n]
        u = x[self.n : self.n + self.N.shape[1]]
        rate = self.N @ u + self.D @ z
        return z, rate, self.N @ u_rate + self.D @ rate


def first_order(small: ProjectedSystem) -> FirstOrder:
    """(1) from the projected matrices."""
    M = small.M
    C = small.C
    K = small.K
    n = len(small.M)
    # without rows on velocities every z' is free
    N: Array = np.eye(n)
    D: Array = np.zeros((n, n))
    if len(small.speeds[0]):
        G, P = small.speeds
        N = sl.null_space(G)
        D = -np.linalg.pinv(G) @ P

    try:
        inverse = np.linalg.solve(N.T @ M @ N, N.T) if N.shape[1] else N.T
    except np.linalg.LinAlgError:
        raise InputError(
            "Motions without mass are left, or bodies whose masses are nothing beside those of others: give them masses of no "
            f"less than {np.finfo(float).eps:.0e} of these, or leave them out."
        ) from None
    by_z = K + (C + M @ D) @ D
    by_u = (C + M @ D) @ N
    A = np.block([[D, N], [-inverse @ by_z, -inverse @ by_u]])
    if small.memory is None:
        return FirstOrder(A, n, N, D, inverse)

    m = small.memory
    aside = np.concatenate((np.zeros_like(m.H), -inverse @ m.H))
    A = np.block([[A, aside], [m.P + m.Q @ D, m.Q @ N, m.R]])
    return FirstOrder(A, n, N, D, inverse)


def slowest(system: FirstOrder, *, relaxing: bool = False) -> tuple[Array, Array]:
    """Eigenvalues, the slowest first and one of each conjugate pair, (m,), and the z of their vectors (k, m).

    ``relaxing``: motions that decay without vibration come last, of which viscoelastic bodies have one for each dashpot.
    """
    rolls = system.N.shape[1] < system.n
    rest, zeros = _without_zeros(system) if rolls else (np.eye(len(system.A)), np.zeros((len(system.A), 0)))

    values, vectors = np.linalg.eig(rest.T @ system.A @ rest) if rest.shape[1] else (np.zeros(0), np.zeros((0, 0)))
    if rolls and len(values):  # a double zero may come out as a pair with an imaginary part of roundoff
        values = np.where(np.abs(values) <= ALMOST * np.abs(values).max(), values.real, values)

    once = np.flatnonzero(values.imag >= 0)
    order: np.ndarray = once[np.argsort(np.abs(values[once]))]
    if relaxing:
        order = _decays_last(system, order, values[order], (rest @ vectors)[:, order])

    found = [_vector(system.A, values[i], rest @ vectors[:, i]) if rolls else vectors[:, i] for i in order]
    every = np.concatenate((np.zeros(zeros.shape[1]), values[order]))
    shapes = np.column_stack((zeros.astype(complex), *found))[: system.n]
    return every, shapes


def _decays_last(system: FirstOrder, order: np.ndarray, values: Array, vectors: Array) -> np.ndarray:
    """The numbers ``order`` with those last whose memories decay; rigid motions, of eigenvalue zero, change no memory."""
    z = vectors[: system.n]
    w = vectors[system.n + system.N.shape[1] :]
    moves = np.abs(w).max(axis=0, initial=0.0) > UNCHANGED * np.abs(z).max(axis=0, initial=0.0)
    # equal dashpots may come out as a pair with an imaginary part of roundoff
    still = np.abs(values.imag) <= ALMOST * np.abs(values)
    decays = still & (values.real < 0.0) & moves
    return np.concatenate((order[~decays], order[decays]))


def _without_zeros(system: FirstOrder) -> tuple[Array, Array]:
    """Orthonormal bases (of x) of what is left after (2), and of what was taken out."""
    size = len(system.A)
    kept = np.eye(system.n)
    out = np.zeros((size, 0))
    # rates and accelerations, each against the largest there is: z are lengths, all of them
    scales = [max(float(np.abs(x).max(initial=0.0)), 1e-300) for x in (system.D, system.A[system.n :, : system.n])]
    while kept.shape[1]:
        # directions of z that change neither rates nor accelerations, taken out again and again
        rest = sl.block_diag(kept, np.eye(size - system.n))
        image = rest.T @ system.A[:, : system.n] @ kept
        for rows, size_of_rows in zip((image[: kept.shape[1]], image[kept.shape[1] :]), scales, strict=True):
            rows /= size_of_rows

        _, s, Vt = np.linalg.svd(image)
        sizes = np.concatenate((s, np.zeros(len(Vt) - len(s))))
        free = Vt[sizes <= NOTHING]
        if not len(free):
            break

        gone = np.concatenate((kept @ free.T, np.zeros((size - system.n, len(free)))))
        out = np.concatenate((out, gone), axis=1)
        kept = kept @ sl.null_space(free)
    return sl.block_diag(kept, np.eye(size - system.n)), out


def _vector(A: Array, value: complex, guess: Array) -> Array:
    """The eigenvector of A for an eigenvalue of its rest, by inverse iteration."""
    near = value * (1.0 + 1e-9) + 1e-12 * max(float(np.abs(A).max()), 1e-300)
    x = guess.astype(complex)
    # two iterations from so near leave roundoff
    for _ in range(2):
        x = np.linalg.solve(A - near * np.eye(len(A)), x)
        x = x / np.abs(x).max()
    return x
