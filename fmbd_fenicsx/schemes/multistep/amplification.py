"""Orders of backward differentiation that amplify vibrations of a scene: three and more, where h omega is near one.

A vibration y' = lambda y becomes y_n+1 = zeta y_n with

    sum_j  (1 - 1/zeta)^j / j  =  h lambda,      j = 1 .. k                                                    (1)

Orders one and two damp all vibrations at any step. Those from three on amplify undamped ones of h omega between about 0.3 and
10 by up to 1.4 a step: where a stiff spring is not resolved, and need not be, roundoff becomes a vibration of the size of the
tolerance, which the error test then has to follow in small steps for ever. Such an order is not taken.

Source: Hairer and Wanner, Solving ODEs II, section V.1, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from ...linear.condensation import StepSolver, Weights
from ...linear.core import dense
from ...linear.core_matrix import core_matrix
from ...rotations import Array
from ...system.evaluation import Evaluation
from ...system.serialisation import Remembering, plain
from ...system.system import State
from ...system.tangents.force_tangent import force_tangent

GROWTH = 5e-3  # in a step, that an order may have
RENEWAL = 50  # steps after which the vibrations are looked at again
LARGEST = 200  # unknowns of the core, up to which eigenvalues are solved for
RESOLVED = 0.3  # h omega below which any order follows a vibration
RANK = 1e-9  # singular values of the constraints below this share of the largest are none


class Amplification(Remembering):
    """Which orders follow the vibrations of a scene; ``count`` of uses since these were looked at."""

    keeps: ClassVar = {"rates": plain(), "count": plain()}

    def __init__(self, solver: StepSolver) -> None:
        self.solver, self.count = solver, RENEWAL
        self.rates: Array = np.zeros(0)

    def permits(self, order: int, h: float, state: State) -> bool:
        """Whether steps of size h (s) of this order amplify no vibration about a state; collective."""
        if order <= 2:
            return True
        self.count += 1
        if self.count > RENEWAL:
            self.rates, self.count = vibrations(self.solver, state), 0
        z = h * self.rates
        return bool(growth(order, z[np.abs(z) > RESOLVED]).max(initial=0.0) <= 1.0 + GROWTH)

    def forget(self) -> None:
        """Look again at the next use."""
        self.count = RENEWAL


def vibrations(solver: StepSolver, state: State) -> Array:
    """lambda (1/s) of the vibrations by springs and other elements that the constraints leave, with none that grows; collective.

    Of large systems one: the fastest of a coordinate on its springs, undamped.
    """
    s = solver.system
    ev = s.at(state.t, state.q, state.v)
    mass = solver.masses(ev)
    stiffness = _applied(ev, Weights(0.0, 0.0, 1.0))
    damping = _applied(ev, Weights(0.0, 1.0, 0.0))
    if stiffness is None or not s.n_core:
        return np.zeros(0)

    # all unknowns of one size
    size = 1.0 / np.sqrt(np.maximum(np.asarray(mass.diagonal()), 1e-300))
    fastest = float(np.sqrt(np.max(np.asarray(stiffness.diagonal()) * size**2, initial=0.0)))
    if not fastest > 0:
        return np.zeros(0)
    if s.n_core > LARGEST:
        return np.array([1j * fastest])

    # on motions that the constraints permit
    free = _free(size * dense(ev.jacobian.core))
    M, C, K = (
        free.T @ (size[:, None] * dense(x) * size) @ free if x is not None else np.zeros((free.shape[1],) * 2)
        for x in (mass, damping, stiffness)
    )
    n = len(M)
    rates = np.zeros((2 * n, 2 * n))
    rates[:n, n:] = np.eye(n)
    rates[n:, :n], rates[n:, n:] = -np.linalg.solve(M, K) / fastest**2, -np.linalg.solve(M, C) / fastest
    found = fastest * np.linalg.eigvals(rates)
    return np.asarray(np.minimum(found.real, 0.0) + 1j * found.imag)


def _applied(ev: Evaluation, w: Weights) -> Any:
    """cd C + ck K of replicated parts and of force elements on the core; None without any."""
    parts = core_matrix(ev, w)
    applied = force_tangent(ev, w.cd, w.ck)
    if applied is None or applied.core is None:
        return parts if abs(parts).max() > 0 else None
    return parts + applied.core


def _free(G: Array) -> Array:
    """Orthonormal motions that rows G leave, (n, n - rank)."""
    if not len(G):
        return np.eye(G.shape[1])
    norms = np.sqrt((G * G).sum(axis=1))
    _, stretch, V = np.linalg.svd(G / np.where(norms > 0, norms, 1.0)[:, None])
    return np.asarray(V[int((stretch > RANK * stretch[0]).sum()) :].T)


def growth(order: int, z: Array) -> Array:
    """Largest |zeta| of (1) for values z = h lambda, as z."""
    # coefficients of powers of 1 / zeta
    powers = np.zeros(order + 1)
    term: Array = np.ones(1)
    for j in range(1, order + 1):
        term = np.convolve(term, [1.0, -1.0])
        powers[: j + 1] += term / j

    companion = np.zeros((len(z), order, order), dtype=complex)
    companion[:, 1:, :-1] = np.eye(order - 1)
    companion[:, 0, :] = -powers[1:] / (powers[0] - z)[:, None]
    return np.asarray(np.abs(np.linalg.eigvals(companion)).max(axis=1, initial=0.0))
