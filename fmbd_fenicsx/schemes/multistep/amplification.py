"""Orders of backward differentiation that amplify vibrations of a scene: three and more, where h omega is near one.

A vibration y' = lambda y becomes y_n+1 = zeta y_n with

    sum_j  (1 - 1/zeta)^j / j  =  h lambda,      j = 1 .. k                                                    (1)

Orders one and two damp all vibrations at any step. Those from three on amplify undamped ones of h omega between about 0.3 and
10 by up to 1.4 a step: where a stiff spring is not resolved, and need not be, roundoff becomes a vibration of the size of the
tolerance, which the error test then has to follow in small steps for ever. Such an order is not taken.

With |zeta| = 1 + :data:`GROWTH` the left of (1) is a closed curve around all h lambda of faster growth: where it crosses the ray
along lambda the sizes begin and end with which the order amplifies that vibration.

Source: Hairer and Wanner, Solving ODEs II, section V.1, doi:10.1007/978-3-642-05221-7.
"""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

import numpy as np

from ...linear.blocks.field_blocks import Weights
from ...linear.condensation import StepSolver
from ...linear.core_matrix import core_matrix
from ...matrices import dense, left_free
from ...rotations import Array
from ...system.compiled.declarations import enumeration
from ...system.evaluation import Evaluation
from ...system.layout import State
from ...system.serialisation import Remembering, plain
from ...system.tangents.force_tangent import force_tangent

GROWTH = 5e-3  # in a step, that an order may have
RENEWAL = 50  # uses after which the vibrations are looked at again, up to
RARER = 4  # times as many where the fastest stays as it was, up to
ALIKE = 0.1  # of itself
# orders: the highest of all, and of those that damp undamped vibrations at any step
HIGHEST, STABLE = enumeration("ORDERS", "implicit/bdf.c").values()
POINTS = 8192  # of the curve
LARGEST = 200  # unknowns of the core, up to which eigenvalues are solved for
RESOLVED = 0.3  # h omega below which any order follows a vibration


class Amplification(Remembering):
    """Which orders follow the vibrations of a scene.

    ``spans``: of sizes (s) with which each order amplifies one, (k, 2); ``uses`` of these since vibrations were looked at, which
    is due after ``most``.
    """

    keeps: ClassVar = dict.fromkeys(("spans", "uses", "most"), plain())

    def __init__(self, solver: StepSolver) -> None:
        self.solver, self.uses, self.most = solver, RENEWAL, RENEWAL
        self.spans: dict[int, Array] = {}

    def look(self, order: int, state: State) -> None:
        """Take notice of the vibrations about a state where a step of at most this order begins, if they are due, and about the
        first one; those of the latter are kept with the system, as runs with other tolerances begin there; collective.
        """
        if self.spans and (order <= STABLE or self.uses < self.most):
            return
        cache = self.solver.system.cache
        begin, rates = cache.get("vibrations", (None, None))
        if begin is not state:
            rates = vibrations(self.solver, state)
            if not self.spans:
                cache.setdefault("vibrations", (state, rates))
        spans = {k: spans_of(k, rates) for k in range(STABLE + 1, HIGHEST + 1)}
        stay = bool(self.spans) and all(_alike(x, self.spans[k]) for k, x in spans.items())
        self.most = min(2 * self.most, RARER * RENEWAL) if stay else RENEWAL
        self.spans, self.uses = spans, 0

    def permits(self, order: int, h: float) -> bool:
        """Whether steps of size h (s) of this order amplify no vibration."""
        if order <= STABLE:
            return True
        self.uses += 1
        return not any(begin < h < end for begin, end in self.spans[order])

    def forget(self) -> None:
        """Look again at the next use."""
        self.spans, self.uses, self.most = {}, RENEWAL, RENEWAL


def _alike(spans: Array, before: Array) -> bool:
    """Whether the least of the sizes, that of the fastest vibration, is nearly that before."""
    if not (len(spans) and len(before)):
        return len(spans) == len(before)
    return bool(abs(spans[0, 0] - before[0, 0]) <= ALIKE * before[0, 0])


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
    free = left_free(size * dense(ev.jacobian.core)).T
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


@cache
def _curve(order: int) -> tuple[Array, Array]:
    """Ends of the pieces of the curve of (1) where rays of vibrations that do not grow may cross it."""
    share = 1.0 - np.exp(2j * np.pi * np.arange(POINTS) / POINTS) / (1.0 + GROWTH)
    begin = np.add.reduce([share**j / j for j in range(1, order + 1)])
    end = np.roll(begin, -1)
    met = ((begin.real <= 0.0) | (end.real <= 0.0)) & ((begin.imag >= 0.0) | (end.imag >= 0.0))
    return begin[met], end[met]


def spans_of(order: int, rates: Array) -> Array:
    """Sizes (s) between which steps of an order amplify vibrations of these rates lambda (1/s), none of which grows, (k, 2)."""
    # the curve is the same on both sides of the real axis
    ahead = np.unique(rates.real + 1j * np.abs(rates.imag))
    found = [np.zeros((0, 2))]
    for one in ahead[np.abs(ahead) > 0.0]:
        # where the ray is the real axis
        begin, end = (x * (one.conj() / np.abs(one)) for x in _curve(order))
        crosses = (begin.imag > 0.0) != (end.imag > 0.0)
        a, b = begin[crosses], end[crosses]
        ends = (a.real * b.imag - b.real * a.imag) / (b.imag - a.imag)
        # closed: as often in as out
        ends = np.sort(ends[ends > 0.0]).reshape(-1, 2)
        found.append(np.maximum(ends[ends[:, 1] > RESOLVED], RESOLVED) / np.abs(one))
    every = np.concatenate(found)
    return every[np.argsort(every[:, 0])]
